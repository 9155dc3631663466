"""Dates that a protocol cannot express."""

from pathlib import Path

import pytest
from support.bacnet import TIME, served
from support.nodes import NodeProgram

from zenostat.gateways.modbus.gateway import ModbusGateway

PLANT = """\
class Room:
    step_s = 60.0
    begin = "{begin}"
    sensors = {{"temperature": ("degC", None, None)}}

    actuators = {{}}

    def reset(self, seed):
        return {{"temperature": 20.0}}

    step = reset
"""


@pytest.mark.slow
@pytest.mark.parametrize(("begin", "time"), [("1850-01-01T00:00", 0), ("2200-01-01T00:00", 2**32 - 1)])
async def test_gateways__date_beyond_a_protocol_is_unspecified_or_the_nearest(
    tmp_path: Path, begin: str, time: int
) -> None:
    plant = tmp_path / "room.py"
    plant.write_text(PLANT.format(begin=begin))
    with NodeProgram(tmp_path / "room", plant=f"{plant}:Room", name="room") as node:
        async with served(node.endpoint, "room") as (gateway, reader, _):
            read = await reader.read(TIME)
            assert (*read.date, *read.time) == (255,) * 8
            registers = ModbusGateway(gateway._node, "127.0.0.1", 0)._input_registers()[8:10]
            assert registers == [time >> 16, time & 0xFFFF]
