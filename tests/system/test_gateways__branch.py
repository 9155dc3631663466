"""Gateways of a branch: its clients command the branch, and its parent is left alone."""

import asyncio
import struct
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient
from support.bacnet import client as bacnet_client
from support.bacnet import free_udp_port
from support.gateways import RunningGateway
from support.mqtt_broker import Broker, needs_broker
from support.nodes import until

from zenostat import Bus
from zenostat.gateways.modbus.register_map import RegisterMap, Table
from zenostat.topics.messages import CreateBranch

POINT = "core_zn_cooling_setpoint"


def commands(bus: Bus, node: str) -> dict[int, float]:
    return {n: entry.value for n, entry in enumerate(bus.priorities(node)[POINT], 1) if entry.value is not None}


@pytest.mark.slow
@needs_broker
def test_gateways__clients_of_three_protocols_command_a_branch_and_not_its_parent(bus: Bus, tmp_path: Path) -> None:
    udp = free_udp_port()
    with bus.controller("office", priority=16) as link:
        link.reset()
        link.send()
        before = link.receive()
        branch = bus.branch("office", CreateBranch(controller=link.name))
        at = [branch, "--connect", bus.endpoint]
        with (
            Broker(tmp_path) as broker,
            RunningGateway("mqtt", *at, "--broker", f"127.0.0.1:{broker.port}") as mqtt,
            RunningGateway("modbus", *at, "--address", "127.0.0.1:0", "--priority", "5") as modbus,
            RunningGateway("bacnet", *at, "--address", f"127.0.0.1:{udp}"),
        ):
            broker.publish(f"zenostat/{branch}/actuator/{POINT}/set", '{"value": 26.5, "priority": 4}')
            registers = RegisterMap(bus.manifest(branch))
            address = next(
                e.address for e in registers.entries if e.name == POINT and e.table is Table.HOLDING_REGISTER
            )
            with ModbusTcpClient("127.0.0.1", port=modbus.port, timeout=20) as client:
                words = list(struct.unpack(">HH", struct.pack(">f", 27.5)))
                assert not client.write_registers(address, words, device_id=1).isError()

            async def command() -> None:
                async with bacnet_client(udp) as device:
                    await device.learn()
                    assert await device.write(POINT, 28.5, priority=7) == "ok"

            asyncio.run(command())
            until(lambda: set(commands(bus, branch)) >= {4, 5, 7}, "all three are commanded")
            applied = commands(bus, branch)
            assert [applied[n] for n in (4, 5, 7)] == [26.5, 27.5, 28.5]
            assert not set(commands(bus, "office")) & {4, 5, 7}
            assert mqtt.end()[0] == 0
            assert 4 not in commands(bus, branch), "it relinquishes its commands in the branch"
        link.send()
        assert link.receive().step == before.step + 1
