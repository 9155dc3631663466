"""A BACnet device whose node is frozen, or the replay of a recording."""

import asyncio
import os
import signal
import subprocess
from pathlib import Path

import pytest
from support.bacnet import served
from support.nodes import NodeProgram, node_on_bus, until
from support.run_cli import ZENOSTAT

from zenostat.topics.messages import Mode, State


@pytest.mark.slow
async def test_bacnet_gateway__replayed_recording_is_reliable_and_takes_no_writes(tmp_path: Path) -> None:
    plant = f"{Path(__file__).parents[2]}/examples/own_plant.py:HeatPumpRoom"
    record, bus = tmp_path / "room.mcap", f"unixsock-stream/{tmp_path}/bus"
    with node_on_bus(tmp_path / "room", plant=plant, name="room", record=str(record)) as (node, recorded):
        recorded.write("room", "compressor", 500.0)
        recorded.pace("room", mode=Mode.FREE)
        until(lambda: recorded.status("room").state is State.ENDED, "the episode is over")
        node.interrupt()

    with subprocess.Popen([*ZENOSTAT, "replay", str(record), "--speed", "3600", "--listen", bus]) as replay:
        try:
            until(lambda: Path(f"{tmp_path}/bus").exists(), "the replay listens")
            async with served(bus, "room") as (_, reader, _):
                assert await reader.write("compressor", 500.0) == "property write-access-denied"
                while await reader.read("compressor") != 500.0:  # as soon as the sample with the command is replayed
                    await asyncio.sleep(0.02)
                assert await reader.read("compressor", "reliability") == "no-fault-detected"
                assert await reader.read("compressor", "property-list")
                for unknown in ("priority-array", "current-command-priority"):
                    assert await reader.read("compressor", unknown) == "property value-not-initialized"
                assert await reader.read("room_temperature", "reliability") == "no-fault-detected"
        finally:
            replay.terminate()


@pytest.mark.slow
async def test_bacnet_gateway__frozen_node_is_an_operational_problem_of_each_write(tmp_path: Path) -> None:
    plant = f"{Path(__file__).parents[2]}/examples/own_plant.py:HeatPumpRoom"

    with NodeProgram(tmp_path / "room", plant=plant, name="room") as node:
        try:
            async with served(node.endpoint, "room") as (_, reader, _):
                os.kill(node.pid, signal.SIGSTOP)
                assert await reader.write("compressor", 500.0) == "device operational-problem"
        finally:
            os.kill(node.pid, signal.SIGCONT)
