"""The command `zenostat gateway bacnet`, and BACnet clients that others have written."""

import asyncio
import importlib.util
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.bacnet import INSTANCE, free_udp_port, served
from support.csv_files import csv_rows
from support.nodes import NodeProgram, Program
from support.run_cli import ZENOSTAT, run_in_process

from zenostat import Bus
from zenostat.topics.device_addresses import instance_numbers
from zenostat.topics.messages import Reset

COOLING = "core_zn_cooling_setpoint"
EXAMPLE = Path(__file__).parents[2] / "examples/bacnet_client.py"

BAC0_PROGRAM = """
import asyncio, json, sys, BAC0
BAC0.log_level("silence")

async def main(address, instance, port):
    async with BAC0.start(ip="127.0.0.1/32", port=port, ping=False) as client:
        seen = {}
        (answer,) = await client.who_is(address)
        seen["who-is"] = answer.iAmDeviceIdentifier[1]
        device = await BAC0.device(address, instance, client, poll=0)
        seen["points"] = {point.properties.name: str(point.properties.units_state) for point in device.points}
        output = f"{address} analogOutput {device['core_zn_cooling_setpoint'].properties.address}"
        seen["before"] = await client.read(f"{output} presentValue")
        await client._write(f"{output} presentValue 26.5 - 8")
        seen["after"] = await client.read(f"{output} presentValue")
        array = await client.read(f"{output} priorityArray")
        seen["array"] = [getattr(entry, entry._choice) or None for entry in array]
        print(json.dumps(seen), flush=True)
        sys.stdin.readline()
        array = await client.read(f"{output} priorityArray")
        seen["array"] = [getattr(entry, entry._choice) or None for entry in array]
        try:
            await client._write(f"{output} presentValue 99 - 8")
        except Exception as error:
            seen["rejected"] = str(error)
        await client._write(f"{output} presentValue null - 8")
        seen["relinquished"] = await client.read(f"{output} presentValue")
        print(json.dumps(seen), flush=True)

asyncio.run(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
"""


@contextmanager
def gateway(node: NodeProgram, port: int) -> Iterator[subprocess.Popen]:
    """The command, once it is ready; Ctrl-C ends it."""
    command = [*ZENOSTAT, "gateway", "bacnet", "office", "--connect", node.endpoint]
    command += ["--address", f"127.0.0.1:{port}", "--instance", str(INSTANCE)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, text=True, **pipes)
    try:
        line = process.stdout.readline()
        assert line.startswith("ready: node office is BACnet device 4711 on 127.0.0.1:"), (line, process.stderr.read())
        yield process
        process.send_signal(signal.SIGINT)
        rest, errors = process.communicate(timeout=60)
        assert process.returncode == 0
        assert "writes" in rest
        assert "no authentication" in errors
        assert "Traceback" not in errors
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("BAC0") is None, reason="BAC0 is not installed: pip install BAC0")
def test_bacnet_gateway__bac0_finds_the_device_reads_commands_and_relinquishes(
    episode_bus: Bus, shared_node: NodeProgram
) -> None:
    episode_bus.pause("office")
    episode_bus.reset("office", Reset())
    port = free_udp_port()
    arguments = (f"127.0.0.1:{port}", str(INSTANCE), str(free_udp_port()))
    with gateway(shared_node, port), Program(BAC0_PROGRAM, *arguments, options=("-W", "ignore")) as program:
        seen = program.json()
        episode_bus.write("office", COOLING, 24.0, priority=3, source="operator")
        program.tell()
        last = program.json()
    manifest = episode_bus.manifest("office")
    assert seen["who-is"] == INSTANCE
    analog = {"node/advance", "node/step", "node/episode", "node/paused"}
    assert {*manifest.names, *(a.name for a in manifest.actuators)} <= {*seen["points"], *analog}
    assert seen["points"]["core_zn_air_temperature"] == "degrees-celsius"
    assert all(seen["points"][meter.name] == "watts" for meter in manifest.meters if meter.unit == "J")
    assert seen["after"] == 26.5 != seen["before"]
    assert [number for number, value in enumerate(seen["array"], 1) if value] == [8]
    assert {number: value for number, value in enumerate(last["array"], 1) if value} == {3: 24.0, 8: 26.5}
    assert "value-out-of-range" in last["rejected"]
    assert last["relinquished"] == 24.0


@pytest.mark.skipif(
    not (shutil.which("bacrp") and shutil.which("bacwp")),
    reason="bacrp and bacwp are not installed; build them from github.com/bacnet-stack/bacnet-stack",
)
def test_bacnet_gateway__bacnet_stack_reads_and_writes(episode_bus: Bus, shared_node: NodeProgram) -> None:
    port = free_udp_port()
    output = str(instance_numbers(a.name for a in episode_bus.manifest("office").actuators)[COOLING])

    def ask(tool: str, *arguments: str) -> str:
        path = ["--mac", f"127.0.0.1:{port}", "--dnet", "0"]
        environment = {"BACNET_IFACE": "lo", "BACNET_IP_PORT": str(free_udp_port())}
        command = [shutil.which(tool), *path, str(INSTANCE), "analog-output", output, *arguments]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60).stdout

    with gateway(shared_node, port):
        ask("bacwp", "present-value", "8", "-1", "4", "26.5")  # priority 8, no index, a Real
        assert float(ask("bacrp", "present-value")) == 26.5
        assert "26.5" in ask("bacrp", "priority-array", "8")
        ask("bacwp", "present-value", "8", "-1", "0", "0")  # Null
        assert float(ask("bacrp", "present-value")) != 26.5


@pytest.mark.slow
def test_bacnet_gateway__example_steps_the_node_and_commands_it_in_the_afternoon(
    episode_bus: Bus, shared_node: NodeProgram
) -> None:
    episode_bus.pace("office", mode="free")
    episode_bus.pause("office")
    episode_bus.reset("office", Reset())
    port = free_udp_port()
    command = [sys.executable, str(EXAMPLE), "--device", f"127.0.0.1:{port}", "--own", f"127.0.0.1:{free_udp_port()}"]
    with gateway(shared_node, port):
        ended = subprocess.run([*command, "--steps", "76"], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    setpoints = {
        line.split()[0][:5]: float(line.split()[4]) for line in ended.stdout.splitlines() if "setpoint 2" in line
    }
    afternoon = {time for time, setpoint in setpoints.items() if setpoint == 28.0}
    assert afternoon == {f"{hour}:{minute:02}" for hour in range(14, 18) for minute in range(0, 60, 15)}
    assert len(setpoints) == 76


@pytest.mark.slow
def test_bacnet_gateway__objects_are_written_as_a_table(episode_bus: Bus, tmp_path: Path) -> None:
    file = tmp_path / "objects.csv"
    words = ["gateway", "bacnet", "office", "--connect", episode_bus.endpoint, "--instance", str(INSTANCE)]
    ended = run_in_process(*words, "--objects", str(file))
    assert ended.returncode == 0, ended.stderr
    rows = {(row["type"], row["name"]): row for row in csv_rows(file)}
    manifest = episode_bus.manifest("office")
    assert len(rows) == 7 + len(manifest.points) + len(manifest.actuators)
    row, actuator = rows["analog-output", COOLING], next(a for a in manifest.actuators if a.name == COOLING)
    numbers = instance_numbers(a.name for a in manifest.actuators)
    assert int(row["instance"]) == numbers[COOLING]
    assert (float(row["low"]), float(row["high"])) == (actuator.low, actuator.high)
    assert (row["unit"], row["bacnet_unit"]) == ("degC", "degreesCelsius")

    async def listed() -> set[tuple[str, int, str]]:
        async with served(episode_bus.endpoint) as (_, reader, _):
            return {(*identifier, name) for name, identifier in reader.objects.items()}

    assert {(row["type"], int(row["instance"]), row["name"]) for row in rows.values()} == asyncio.run(listed())
    missing = str(tmp_path / "none" / "objects.csv")
    refused = run_in_process("gateway", "bacnet", "office", "--connect", episode_bus.endpoint, "--objects", missing)
    assert (refused.returncode, "No such file" in refused.stderr) == (2, True)
