"""Clients of gateways, an episode that has failed, and the next one."""

import asyncio
from pathlib import Path

import pytest
from support.bacnet import DEVICE, served
from support.nodes import node_on_bus, until

from zenostat.bridge.transport.session import open_session
from zenostat.gateways.modbus.gateway import ModbusGateway
from zenostat.gateways.modbus.register_map import STATES, Table
from zenostat.gateways.node_client import NodeClient
from zenostat.topics.messages import Reset, State

TANK = """
class Tank:
    step_s = 60.0
    sensors = {"temperature": ("degC", 0.0, 100.0)}
    actuators = {"heater": ("W", 0.0, 3000.0, 0.0)}

    def reset(self, seed):
        return {"temperature": 20.0}

    def step(self, commands):
        if commands["heater"] > 2000.0:
            raise RuntimeError("the tank boils")
        return {"temperature": 21.0}
"""


async def _running(gateway: ModbusGateway) -> bool:
    return dict(zip((name for name, _ in STATES), await gateway.read_bits(Table.DISCRETE_INPUT, 0, 3), strict=True))[
        "episode_running"
    ]


async def _until_running(gateway: ModbusGateway, expected: bool) -> None:
    async with asyncio.timeout(60):
        while await _running(gateway) is not expected:
            await asyncio.sleep(0.01)


@pytest.mark.slow
async def test_gateways__failed_episode_is_not_running_and_the_next_one_is(tmp_path: Path) -> None:
    (tmp_path / "tank.py").write_text(TANK)
    plant = f"{tmp_path}/tank.py:Tank"
    with (
        node_on_bus(tmp_path / "tank", plant=plant, name="tank") as (node, bus),
        open_session(connect=[node.endpoint]) as session,
    ):
        bus.pause("tank")
        bus.pace("tank", mode="free")
        async with (
            NodeClient(session, "tank") as client,
            ModbusGateway(client, "127.0.0.1", 0) as modbus,
            served(node.endpoint, "tank") as (_, reader, _),
        ):
            assert await _running(modbus)
            assert await reader.read(DEVICE, "system-status") == "operational"
            await client.write("heater", 2500.0)
            await asyncio.to_thread(bus.step, "tank")
            await _until_running(modbus, False)
            assert await reader.read("temperature", "reliability") == "process-error"
            assert await reader.read(DEVICE, "system-status") == "non-operational"
            until(lambda: bus.status("tank").state is State.FAILED, "it has failed")
            async with NodeClient(session, "tank") as later, ModbusGateway(later, "127.0.0.1", 0) as second:
                assert not await _running(second)  # although it has heard no event
            await asyncio.to_thread(bus.reset, "tank", Reset())
            await _until_running(modbus, True)
            assert await reader.read("temperature", "reliability") == "no-fault-detected"
