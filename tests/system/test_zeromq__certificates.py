"""The ZeroMQ gateway on a bus with keys: its clients in three languages, and the names under which they may send."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.certificates import house_keys
from support.nodes import NodeProgram, free_port

import zenostat
from zenostat import Bus

pytest.importorskip("zmq", reason="pyzmq is not installed")

from support.zeromq import GatewayProgram, Peer

EXAMPLES = Path(__file__).parents[2] / "examples"
SETPOINT = "core_zn_cooling_setpoint"
STEPS = 24
PLANT = f"""
class Room:
    step_s = 3600.0
    begin = "2017-07-03T00:00:00"
    duration_s = {STEPS} * 3600.0
    sensors = {{"core_zn_air_temperature": ("degC", 0.0, 50.0)}}
    actuators = {{"{SETPOINT}": ("degC", 20.0, 30.0, 24.0)}}

    def reset(self, seed):
        return {{"core_zn_air_temperature": 24.0}}

    def step(self, commands):
        return {{"core_zn_air_temperature": commands["{SETPOINT}"]}}
"""


@pytest.fixture(scope="module")
def node(module_folder: Path, pki: Path) -> Iterator[NodeProgram]:
    (module_folder / "room.py").write_text(PLANT)
    listen = [f"tls/127.0.0.1:{free_port()}"]
    settings = {"plant": f"{module_folder}/room.py:Room", "listen": listen, "keys": str(pki)}
    with NodeProgram(module_folder / "node", **settings) as running:
        yield running


@pytest.fixture(scope="module")
def gateway(node: NodeProgram, pki: Path) -> Iterator[GatewayProgram]:
    with GatewayProgram(node.endpoint, "--keys", str(pki)) as running:
        yield running


def example(language: str, folder: Path, gateway: GatewayProgram, name: str) -> list[str]:
    """Return the command of an example; skip the test where its language is missing."""
    source = EXAMPLES / f"zeromq_controller.{language}"
    arguments = [gateway.publish, gateway.command, "office", name]
    if language == "py":
        options = ["--publish", "--command", "--node", "--name"]
        return [sys.executable, str(source), *(word for pair in zip(options, arguments, strict=True) for word in pair)]
    if language == "js":
        if (node := shutil.which("node")) is None:
            pytest.skip("Node.js is not installed; on Debian: apt install nodejs")
        return [node, str(source), *arguments]
    compiler, program = shutil.which("cc") or shutil.which("gcc"), folder / "controller"
    if compiler is None:
        pytest.skip("there is no C compiler; on Debian: apt install gcc libc6-dev")
    build = subprocess.run([compiler, "-o", program, source, "-lzmq"], capture_output=True, text=True)
    if "zmq.h" in build.stderr:
        pytest.skip("libzmq's header is not installed; on Debian: apt install libzmq3-dev")
    assert build.returncode == 0, build.stderr
    return [str(program), *arguments]


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("language", ["py", "c", "js"])
def test_zeromq_gateway__clients_send_under_the_name_of_its_certificate(
    gateway: GatewayProgram, bus: Bus, tmp_path: Path, language: str
) -> None:
    """Under another name they are told the right one; under it, the node has that name for what they set."""
    command = example(language, tmp_path, gateway, "gateway.mine")
    with bus.controller("office", priority=16, required=False) as link:
        link.reset()
        with Peer(gateway) as peer:
            peer.first_sample()
            for name in ("mine", "trainer", "gatewayx"):
                kind, denied = peer.ask(f"rpc/claim/{name}", controller=name)
                assert (kind, denied["error"]) == ("ErrorReply", "AccessDenied")
                assert f"send as 'gateway.{name}'" in denied["message"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=90)
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith(f"{STEPS} timesteps to 2017-07-04T00:00:00")
        sample = bus.read("office")
        assert (sample.step, sample.value_source[SETPOINT]) == (STEPS, "gateway.mine")


@pytest.mark.slow
def test_zeromq_gateway__names_revocation_as_a_reason_why_it_has_no_node(scratch: Path, tmp_path: Path) -> None:
    (scratch / "room.py").write_text(PLANT)
    folder, listen = house_keys(tmp_path / "keys"), [f"tls/127.0.0.1:{free_port()}"]
    with (
        NodeProgram(scratch / "own", plant=f"{scratch}/room.py:Room", listen=listen, keys=str(folder)) as node,
        GatewayProgram(node.endpoint, "--keys", str(folder)) as running,
        zenostat.connect(node.endpoint, keys=folder / "operator.pem", affinity="off") as operator,
    ):
        operator.revoke("office", "gateway")
        assert running.process.stderr.readline() == "office: gone, or gateway is revoked or not in the list of names\n"
