"""A node that is killed is a fault in each protocol, and one that returns is served again."""

import asyncio
import struct
from contextlib import ExitStack
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient
from support.bacnet import DEVICE, served
from support.gateways import RunningGateway
from support.mqtt_broker import Broker, needs_broker
from support.nodes import SMALL, NodeProgram, until

from zenostat.bridge.transport.session import Mode, open_session
from zenostat.gateways.node_client import NodeClient
from zenostat.topics.errors import NodeLost, NodeNotFound

COOLING, INPUT = "core_zn_cooling_setpoint", "core_zn_air_temperature"
PLANT = f"{Path(__file__).parents[2]}/examples/own_plant.py:HeatPumpRoom"
UNIT = 1


async def online(node: NodeClient, *, is_online: bool) -> None:
    """Wait until a node has come or is gone."""
    async with asyncio.timeout(60):
        while node.is_online is not is_online:
            await asyncio.sleep(0.01)


@pytest.mark.slow
async def test_gateways__node_that_is_gone_is_a_fault_and_one_that_returns_is_served_again(tmp_path: Path) -> None:
    endpoint = f"unixsock-stream/{tmp_path}/router"
    settings = {**SMALL, "listen": [], "name": "office", "connect": [endpoint]}
    address = ("--connect", endpoint, "--address", "127.0.0.1:0")
    registers = list(struct.unpack(">HH", struct.pack(">f", 21.0)))
    with (
        open_session(listen=[endpoint], mode=Mode.ROUTER),
        ExitStack() as nodes,
        NodeProgram(tmp_path / "first", **settings) as first,
        RunningGateway("modbus", "office", *address) as modbus,
        ModbusTcpClient("127.0.0.1", port=modbus.port, timeout=40) as plc,
        open_session(connect=[endpoint]) as session,
    ):
        async with NodeClient(session, "office") as node, served(endpoint) as (gateway, reader, _):
            presence: list[bool] = []
            node.listeners.presence.append(presence.append)
            instance = node.manifest.instance
            waiting = asyncio.create_task(node.wait_for(lambda: False, timeout_s=60.0, what="never"))
            objects, temperature = dict(reader.objects), await reader.read(INPUT)
            first.kill()

            with pytest.raises(NodeLost):
                await waiting
            assert not node.is_online
            with pytest.raises(NodeLost):
                await node.write(COOLING, 26.0)

            await online(gateway._node, is_online=False)
            assert await reader.read(INPUT, "reliability") == "communication-failure"
            assert [int(flag) for flag in await reader.read(INPUT, "status-flags")] == [0, 1, 0, 0]
            assert await reader.read(INPUT) == temperature
            assert await reader.read(DEVICE, "system-status") == "non-operational"
            assert await reader.write(COOLING, 26.0) == "device operational-problem"
            assert await reader.read(COOLING, "reliability") == "communication-failure"

            until(lambda: plc.read_input_registers(0, count=1, device_id=UNIT).isError(), "the loss is noticed")
            assert plc.read_input_registers(0, count=1, device_id=UNIT).exception_code == 11
            assert plc.write_registers(0, registers, device_id=UNIT).exception_code == 11
            assert not any(plc.read_discrete_inputs(0, count=3, device_id=UNIT).bits[:3])

            nodes.enter_context(await asyncio.to_thread(NodeProgram, tmp_path / "second", **settings))

            await online(node, is_online=True)
            assert node.manifest.instance != instance
            assert presence == [False, True]
            await node.write(COOLING, 26.0)

            await online(gateway._node, is_online=True)
            assert await reader.write(COOLING, 26.0) == "ok"
            assert await reader.read(COOLING) == 26.0
            assert await reader.read(INPUT, "reliability") == "no-fault-detected"
            assert [int(flag) for flag in await reader.read(INPUT, "status-flags")] == [0, 0, 0, 0]
            await reader.learn()
            assert reader.objects == objects

            until(lambda: plc.read_discrete_inputs(0, count=1, device_id=UNIT).bits[0], "the node is back")
            assert not plc.write_registers(0, registers, device_id=UNIT).isError()
        with pytest.raises(NodeNotFound, match="nobody"):
            async with NodeClient(session, "nobody"):
                pass
        code, _, err = modbus.end()
        assert code == 0, err


@pytest.mark.slow
@needs_broker
def test_mqtt__status_is_offline_while_the_node_is_gone(tmp_path: Path) -> None:
    endpoint = f"unixsock-stream/{tmp_path}/router"
    with open_session(listen=[endpoint], mode=Mode.ROUTER), Broker(tmp_path) as broker:
        address = ("--connect", endpoint, "--broker", f"127.0.0.1:{broker.port}")
        with (
            NodeProgram(tmp_path / "first", plant=PLANT, name="room", listen=[], connect=[endpoint]) as first,
            RunningGateway("mqtt", "room", *address),
        ):
            until(lambda: broker.retained("zenostat/room/status") == "online", "it is online")
            first.kill()
            until(lambda: broker.retained("zenostat/room/status") == "offline", "the loss is noticed")
            with NodeProgram(tmp_path / "second", plant=PLANT, name="room", listen=[], connect=[endpoint]):
                until(lambda: broker.retained("zenostat/room/status") == "online", "the node is back")
