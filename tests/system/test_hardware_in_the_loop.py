"""The page on hardware in the loop: one paced building, three protocols, faults, a recording that verifies."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.nodes import free_port, until
from support.run_cli import ZENOSTAT, run_program

from agent_sdk.recording import load

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
SETPOINT, TEMPERATURE = "core_zn_cooling_setpoint", "core_zn_air_temperature"


def _start(stack: ExitStack, log: Path, *command: str, is_ready: Callable[[str], object]) -> subprocess.Popen[bytes]:
    """Start a program whose output goes to a file, and wait until it is ready; it ends with the stack."""
    with log.open("wb") as out:
        program = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT)

    def end() -> None:
        program.terminate()
        program.wait(60)

    stack.callback(end)
    until(lambda: program.poll() is not None or is_ready(log.read_text()), f"{log.name} is ready")
    assert program.poll() is None or program.returncode == 0, log.read_text()
    return program


@pytest.mark.slow
@pytest.mark.skipif(
    MOSQUITTO is None or shutil.which("mosquitto_sub") is None,
    reason="mosquitto is not installed; on Debian: apt install mosquitto mosquitto-clients",
)
def test_three_protocols_on_one_building_with_faults_recorded_and_verified(scratch: Path) -> None:
    endpoint, run = f"unixsock-stream/{scratch}/bus", scratch / "hil.mcap"
    broker, modbus, bacnet, own = (str(free_port()) for _ in range(4))
    connect = ("--connect", endpoint)

    def zenostat(name: str, *words: str) -> None:
        _start(stack, scratch / f"{name}.txt", *ZENOSTAT, *words, is_ready=lambda text: "Ctrl-C" in text)

    with ExitStack() as stack:
        configuration = scratch / "mosquitto.conf"
        configuration.write_text(f"listener {broker} 127.0.0.1\nallow_anonymous true\n")
        _start(stack, scratch / "broker.txt", MOSQUITTO or "", "-c", str(configuration), "-v",
               is_ready=lambda text: "running" in text)  # fmt: skip
        zenostat(
            "node", "node", "--building", "ref-small-office", "--weather", "USA_CO_Denver", "--begin", "07-03",
            "--end", "07-03", "--name", "office", "--mode", "paced", "--speed", "60", "--listen", endpoint,
            "--faults", str(EXAMPLES / "hil_faults.yaml"), "--record", str(run),
        )  # fmt: skip
        zenostat("modbus", "gateway", "modbus", "office", *connect, "--address", f"127.0.0.1:{modbus}",
                 "--priority", "10")  # fmt: skip
        zenostat("bacnet", "gateway", "bacnet", "office", *connect, "--address", f"127.0.0.1:{bacnet}")
        zenostat("mqtt", "gateway", "mqtt", "office", *connect, "--broker", f"127.0.0.1:{broker}")
        run_program("gateway", "modbus", "office", "--map", str(scratch / "map.csv"), *connect)
        dashboard = scratch / "dashboard.txt"
        _start(stack, dashboard, "mosquitto_sub", "-p", broker, "-v", "-t", "zenostat/office/#",
               is_ready=lambda text: f"sensor/{TEMPERATURE}" in text)  # fmt: skip
        plc = _start(
            stack, scratch / "plc.txt", sys.executable, "-u", str(EXAMPLES / "modbus_client.py"),
            str(scratch / "map.csv"), "--port", modbus, "--pause", "0.05", is_ready=lambda text: "raised" in text,
        )  # fmt: skip
        supervisor = _start(
            stack, scratch / "supervisor.txt", sys.executable, str(EXAMPLES / "bacnet_supervisor.py"), "--device",
            f"127.0.0.1:{bacnet}", "--own", f"127.0.0.1:{own}", "--pause", "0.02",
            is_ready=lambda text: "objects" in text,
        )  # fmt: skip
        paced = run_program("pace", "office", "3600", *connect)
        assert paced.returncode == 0, paced.stderr
        assert supervisor.wait(90) == 0, (scratch / "supervisor.txt").read_text()
        assert plc.wait(90) == 0, (scratch / "plc.txt").read_text()
        run_program("stop", "office", *connect)
    verified = run_program("verify", str(run))
    assert verified.returncode == 0, verified.stdout + verified.stderr
    assert "identical" in verified.stdout
    (episode,) = load(run).episodes
    setpoint, sources = episode.orders[:, episode.actuators.index(SETPOINT)], set(episode.value_source(SETPOINT))
    assert "modbus" in sources
    assert f"bacnet 127.0.0.1:{own}" in sources
    assert {27.0, 28.0} <= set(setpoint.tolist())
    shown = [line.split()[1] for line in dashboard.read_text().splitlines() if f"sensor/{TEMPERATURE} " in line]
    published = {repr(value) for value in episode[TEMPERATURE].tolist()}
    assert set(shown) <= published
    assert len(set(shown)) > 50
    column = episode.manifest.names.index(TEMPERATURE)
    disturbed = episode.values[:, column] - episode.fault_free_values[:, column]
    assert sorted(set(disturbed.round(9).tolist())) == [0.0, 1.5]
