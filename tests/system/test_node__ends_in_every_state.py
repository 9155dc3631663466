"""A node ends soon after it was told to, whatever it is doing, and leaves nothing."""

import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import gymnasium as gym
import psutil
import pytest
from support.nodes import SMALL, NodeProgram, Program, engines_of, programs_of, remains, runs, until

import zenostat
from zenostat.bridge.runtime.scratch import Scratch, sweep
from zenostat.topics.errors import ZenostatError
from zenostat.topics.messages import CreateBranch, Reset, State

pytestmark = pytest.mark.usefixtures("scratch")

ENDS_WITHIN_S = 15.0
"""Seven times as long as it may take on a quiet machine, and less than an engine's start or a timeout on the way."""

NOISE: dict[str, Any] = {
    "scenario": "ref-small-office-USA_CO_Denver-continuous-stochastic-v1",
    **{key: SMALL[key] for key in ("begin", "end", "steps_per_hour")},
}
NEVER: dict[str, Any] = {"unresponsive_s": 1e6}
Shutdown = Callable[[NodeProgram, zenostat.Bus], None]
SHUTDOWNS: dict[str, Shutdown] = {
    "SIGTERM": lambda node, _: os.kill(node.pid, signal.SIGTERM),
    "SIGINT": lambda node, _: os.kill(node.pid, signal.SIGINT),
    "stop": lambda node, bus: quietly(lambda: bus.stop("office")),
    "twice": lambda node, _: [os.kill(node.pid, signal.SIGTERM) for _ in range(2)],
    "stop and SIGTERM": lambda node, bus: (quietly(lambda: bus.stop("office")), os.kill(node.pid, signal.SIGTERM)),
}


def quietly(do: Callable[[], Any]) -> None:
    """Call a function that may well be cut short."""
    with suppress(ZenostatError):
        do()


@contextmanager
def beside(do: Callable[[], Any]) -> Iterator[None]:
    """Call a function in another thread; it may be cut short as well."""
    thread = threading.Thread(target=quietly, args=(do,))
    thread.start()
    try:
        yield
    finally:
        thread.join()


@contextmanager
def office(folder: Path, **settings: Any) -> Iterator[tuple[NodeProgram, zenostat.Bus]]:
    """A node that would wait for ever for an engine that stands still."""
    with NodeProgram(folder / "node", **(NEVER | settings)) as node:
        try:
            with zenostat.connect(node.endpoint, affinity="off") as bus:
                yield node, bus
        finally:
            node.process.kill()


def freeze(node: NodeProgram) -> list[psutil.Process]:
    engines = engines_of(node.pid)
    for engine in engines:
        engine.suspend()
    return engines


def ends(node: NodeProgram, engines: list[psutil.Process]) -> None:
    assert node.process.wait(timeout=ENDS_WITHIN_S) == 0
    until(lambda: not any(map(runs, engines)), "its engines have ended")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("shutdown", SHUTDOWNS)
def test_node__while_a_reset_forks_an_engine_that_does_not_answer(folder: Path, shutdown: str) -> None:
    with office(folder, **SMALL) as (node, bus):
        bus.reset("office", Reset(controller=""))
        with bus.controller("office", name="mine") as link:
            link.reset().send()
            link.receive()
            engines = freeze(node)
            with beside(lambda: bus.reset("office", Reset(controller=""))):
                until(lambda: bus.status("office").state is State.STARTING, "the node forks an engine")
                with beside(lambda: SHUTDOWNS[shutdown](node, bus)):
                    ends(node, engines)


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("shutdown", ["SIGTERM", "stop"])
def test_node__while_an_engine_starts_that_does_not_answer(folder: Path, shutdown: str) -> None:
    """Another seed, and so another weather: the engine is started anew, and the one of the next episode after it."""
    with office(folder, **NOISE) as (node, bus):
        before = {engine.pid for engine in engines_of(node.pid)}
        bus.reset("office", Reset(controller="", seed=9))
        new = until(lambda: [e for e in engines_of(node.pid) if e.pid not in before], "an engine starts")
        for engine in new:
            engine.suspend()
        assert bus.status("office").state is State.STARTING
        with beside(lambda: SHUTDOWNS[shutdown](node, bus)):
            ends(node, new)


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("settings", [{}, {"slots": 2}, {"baseline": True}, {"keep": True}], ids=str)
def test_node__in_mid_step_of_engines_that_hang(folder: Path, settings: dict[str, Any]) -> None:
    if "keep" in settings:
        settings = {"output_dir": str(folder / "kept")}
    with office(folder, **SMALL, **settings) as (node, bus), bus.controller("office", name="mine") as link:
        sample = link.reset()
        engines = freeze(node)
        sample.send()
        until(lambda: bus.status("office").state is State.RUNNING, "the node waits for its engines")
        os.kill(node.pid, signal.SIGTERM)
        ends(node, engines)


@pytest.mark.slow
def test_node__with_a_branch_and_a_snapshot_whose_engines_hang(folder: Path) -> None:
    with office(folder, **SMALL) as (node, bus), bus.controller("office", name="mine") as link:
        link.reset().send()
        link.receive()
        bus.snapshot("office", "mine")
        branch = bus.branch("office", CreateBranch(controller="mine"))
        with bus.controller(branch, name="other") as other:
            sample = other.current()
            engines = freeze(node)
            sample.send()
            until(lambda: bus.status(branch).state is State.RUNNING, "the branch waits for its engine")
            os.kill(node.pid, signal.SIGTERM)
            ends(node, engines)


@pytest.mark.slow
def test_node__while_a_model_is_surveyed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """EnergyPlus runs for that in a process of its own, which stands still here."""
    monkeypatch.setenv("ZENOSTAT_CACHE", str(folder / "cache"))
    text = f"import sys; sys.argv = ['zenostat', 'node', '--building', {SMALL['building']!r}, '--weather', "
    text += f"{SMALL['weather']!r}, '--no-listen', '--connect', 'unixsock-stream/nobody']; "
    text += "from zenostat.cli.main import main; main()"
    with Program(text) as program:

        def surveys() -> list[psutil.Process]:
            """Those that compute: the node has the handle of a process only a moment after that has started."""
            children = psutil.Process(program.pid).children()
            return [
                c
                for c in children
                if "zenostat.models.energyplus" in " ".join(c.cmdline()) and c.cpu_times().user > 0.05
            ]

        surveying = until(surveys, "a model is converted or surveyed")
        surveying[0].suspend()
        program.process.send_signal(signal.SIGTERM)
        program.process.wait(timeout=ENDS_WITHIN_S)
        until(lambda: not runs(surveying[0]), "the survey has ended")


# Killed


@pytest.mark.variants
@pytest.mark.parametrize("frozen", [False, True])
def test_node__killed_node_leaves_no_engine(folder: Path, *, frozen: bool) -> None:
    with office(folder, **SMALL, slots=2) as (node, bus), bus.controller("office", name="mine") as link:
        link.reset().send()
        link.receive()
        engines = freeze(node) if frozen else engines_of(node.pid)
        assert len(engines) == 3, "one waits to be forked"
        node.process.kill()
        node.process.wait()
        until(lambda: not any(map(runs, engines)), "its engines have ended")
        shutil.rmtree(node.folder)  # a killed node cannot clear it


@pytest.mark.slow
def test_node__what_a_killed_program_and_its_killed_node_left_is_swept_at_the_next_start(scratch: Path) -> None:
    text = f"""
import gymnasium as gym, zenostat, os, signal
env = gym.make("zenostat/Building-v1", **{SMALL!r}, affinity="off").unwrapped
os.kill(env.local_node.pid, signal.SIGKILL)
os.kill(os.getpid(), signal.SIGKILL)
"""
    with Program(text) as program:
        program.process.wait()
    until(lambda: not programs_of(scratch), "the engines have ended")
    assert remains(scratch)
    gym.make("zenostat/Building-v1", **SMALL, affinity="off").close()
    assert not remains(scratch)


def test_node__folder_of_a_live_owner_is_not_swept(scratch: Path) -> None:
    with Program(
        "from zenostat.bridge.runtime.scratch import Scratch; print(Scratch().folder, flush=True); input()"
    ) as program:
        theirs, mine = Path(program.line()), Scratch()
        joined = Scratch(theirs)
        sweep()
        assert theirs.exists()
        assert mine.folder.exists()
        program.close()
        sweep()
        assert theirs.exists(), "another owner holds it"
        joined.release()
        sweep()
    assert not theirs.exists()
    mine.remove()
    assert not mine.folder.exists()


def test_node__folder_of_a_killed_program_is_swept() -> None:
    with Program(
        "from zenostat.bridge.runtime.scratch import scratch_folder\n"
        "with scratch_folder() as folder: print(folder, flush=True); input()"
    ) as program:
        folder = Path(program.line())
        sweep()
        assert folder.exists()
        os.kill(program.pid, signal.SIGKILL)
        program.close()
    sweep()
    assert not folder.exists()


@pytest.mark.slow
def test_node__node_has_no_file_in_shared_memory(shared_node: NodeProgram) -> None:
    """It would stay there if the node is killed."""
    maps = psutil.Process(shared_node.pid).memory_maps()
    assert not [m.path for m in maps if m.path.startswith("/dev/shm")]


@pytest.mark.slow
def test_node__environment_ends_a_node_that_hangs(scratch: Path) -> None:
    env = gym.make("zenostat/Building-v1", **SMALL, affinity="off").unwrapped
    env.reset(seed=0)
    node = psutil.Process(env.local_node.pid)
    node.suspend()
    closing = threading.Thread(target=env.close)
    closing.start()
    closing.join(timeout=30.0)
    late = closing.is_alive()
    with suppress(psutil.Error):
        node.kill()
    closing.join()
    assert not late
