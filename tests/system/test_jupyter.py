"""A real Jupyter kernel: an environment in its cells, also in an event loop; interrupted amid a step, and restarted."""

from collections.abc import Iterator
from typing import Any

import psutil
import pytest
from support.nodes import SMALL, until

jupyter_client = pytest.importorskip("jupyter_client")
pytest.importorskip("ipykernel")

MAKE = f"""
import asyncio, gymnasium as gym, zenostat
env = gym.make("zenostat/Building-v1", **{SMALL | {"begin": "07-03", "end": "07-30"}!r}, affinity="off")
env.reset(seed=0)
async def some():
    for _ in range(5):
        env.step(env.action_space.sample())
        await asyncio.sleep(0)
await some()
"""
FOREVER = """
while True:
    if any(env.step(env.action_space.sample())[2:4]):
        env.reset()
"""


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch, scratch: Any) -> Iterator[tuple[Any, Any]]:
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(scratch))
    manager = jupyter_client.KernelManager(kernel_name="python3")
    manager.start_kernel()
    client = manager.client()
    client.start_channels()
    try:
        client.wait_for_ready(timeout=60)
        yield manager, client
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)


def outcome(client: Any, request: str) -> str:
    """Return the outcome of a cell: `ok`, or the name of its exception."""
    while True:
        reply = client.get_shell_msg(timeout=90)
        if reply["parent_header"].get("msg_id") == request:
            return str(reply["content"].get("ename", reply["content"]["status"]))


@pytest.mark.slow
def test_jupyter__kernel_is_interrupted_and_restarted(kernel: tuple[Any, Any]) -> None:
    manager, client = kernel
    assert outcome(client, client.execute(MAKE)) == "ok"
    forever = client.execute("print('begun')\n" + FOREVER)
    while client.get_iopub_msg(timeout=60)["content"].get("text") != "begun\n":
        pass
    manager.interrupt_kernel()
    assert outcome(client, forever) == "KeyboardInterrupt"
    # For a moment after an error, a kernel aborts the cells that were asked for with `stop_on_error`.
    until(lambda: outcome(client, client.execute("0")) == "ok", "the kernel runs cells again")
    assert outcome(client, client.execute("env.reset(seed=1); await some()")) == "ok"
    theirs = psutil.Process(manager.provisioner.pid).children(recursive=True)
    assert theirs
    manager.restart_kernel(now=True)
    client.wait_for_ready(timeout=60)
    until(lambda: not any(p.is_running() for p in theirs), "node and engines have ended")
    assert outcome(client, client.execute(MAKE)) == "ok"
