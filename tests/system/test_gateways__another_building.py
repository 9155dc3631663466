"""A node that ends, and one of the same name with another plant, while gateways serve it."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient
from support.gateways import RunningGateway
from support.mqtt_broker import Broker, needs_broker
from support.nodes import NodeProgram, until

from zenostat.bridge.transport.session import Mode, open_session
from zenostat.gateways.node_client import NodeClient
from zenostat.topics.messages import Manifest

ROOM = f"{Path(__file__).parents[2]}/examples/own_plant.py:HeatPumpRoom"
TANK = """
class Tank:
    step_s = 60.0
    sensors = {"temperature": ("degC", 0.0, 100.0)}
    actuators = {"heater": ("W", 0.0, 3000.0, 0.0)}

    def reset(self, seed):
        return {"temperature": 20.0}

    def step(self, commands):
        return {"temperature": 20.0 + commands["heater"] / 100.0}
"""


@pytest.fixture
def router(tmp_path: Path) -> Iterator[str]:
    """The endpoint of a router, to which nodes connect."""
    endpoint = f"unixsock-stream/{tmp_path}/router"
    with open_session(listen=[endpoint], mode=Mode.ROUTER):
        yield endpoint


class Building:
    """A node `building` whose plant can be replaced."""

    def __init__(self, router: str, folder: Path) -> None:
        self._router, self._folder = router, folder
        (folder / "tank.py").write_text(TANK)
        self._node = self._start(ROOM)

    def _start(self, plant: str) -> NodeProgram:
        folder = self._folder / plant.rpartition(":")[2]
        return NodeProgram(folder, plant=plant, name="building", listen=[], connect=[self._router])

    def replace(self) -> None:
        """Kill the node, and start one with the tank."""
        self._node.kill()
        self._node.close()
        self._node = self._start(f"{self._folder}/tank.py:Tank")

    def __enter__(self) -> Building:
        return self

    def __exit__(self, *_: object) -> None:
        self._node.close()


@pytest.mark.slow
def test_gateways__modbus_clients_of_the_former_map_are_disconnected(router: str, tmp_path: Path) -> None:
    options = ["--connect", router, "--address", "127.0.0.1:0"]
    half = list(struct.unpack(">HH", struct.pack(">f", 0.5)))
    with Building(router, tmp_path) as building, RunningGateway("modbus", "building", *options) as gateway:
        with socket.create_connection(("127.0.0.1", gateway.port), timeout=60) as client:
            building.replace()
            with suppress(ConnectionResetError):
                assert client.recv(1) == b""
        with ModbusTcpClient("127.0.0.1", port=gateway.port, timeout=20) as client:
            until(lambda: client.read_discrete_inputs(0, count=1, device_id=1).bits[0], "the tank is served")
            assert client.read_input_registers(1, count=2, device_id=1).registers == [1, 1]
            assert client.write_registers(2, half, device_id=1).exception_code == 2
        _, _, err = gateway.end()
    assert "building has other points" in err


@pytest.mark.slow
@needs_broker
def test_gateways__mqtt_removes_the_retained_values_of_points_that_are_gone(router: str, tmp_path: Path) -> None:
    with Building(router, tmp_path) as building, Broker(tmp_path) as broker:
        options = ["--connect", router, "--broker", f"127.0.0.1:{broker.port}", "--home-assistant"]
        gone = ["zenostat/building/sensor/room_temperature", "zenostat/building/actuator/circulation",
                "homeassistant/number/zenostat_building_compressor/config"]  # fmt: skip
        with RunningGateway("mqtt", "building", *options):
            until(lambda: all(broker.retained(topic) for topic in gone), "the room is published")
            building.replace()
            until(lambda: broker.retained("zenostat/building/sensor/temperature") == "20.0", "the tank is published")
            assert broker.retained(*gone) is None
            assert broker.retained("zenostat/building/status") == "online"


@pytest.mark.slow
@needs_broker
@pytest.mark.parametrize("version", ["5", "3.1.1"])
def test_gateways__mqtt_removes_the_retained_values_that_a_former_gateway_left(
    router: str, tmp_path: Path, version: str
) -> None:
    gone = ["zenostat/building/sensor/room_temperature", "zenostat/building/actuator/circulation",
            "homeassistant/number/zenostat_building_compressor/config"]  # fmt: skip
    other = "homeassistant/number/zenostat_building_2_compressor/config"
    with Building(router, tmp_path) as building, Broker(tmp_path) as broker:
        port = broker.port if version == "5" else broker.port_v3
        options = ["--connect", router, "--broker", f"127.0.0.1:{port}", "--mqtt-version", version, "--home-assistant"]
        with RunningGateway("mqtt", "building", *options) as gateway:
            until(lambda: all(broker.retained(topic) for topic in gone), "the room is published")
            gateway.end()
        broker.publish(other, '{"availability_topic": "zenostat/building_2/status"}', retain=True)
        building.replace()
        with RunningGateway("mqtt", "building", *options):
            until(lambda: broker.retained(*gone) is None, "they are removed")
            until(lambda: broker.retained("zenostat/building/sensor/temperature") == "20.0", "the tank is published")
            assert broker.retained(other) is not None


@pytest.mark.slow
async def test_gateways__client_has_no_sample_of_the_former_building_beside_the_new_manifest(
    router: str, tmp_path: Path
) -> None:
    seen: list[tuple[str, bool]] = []
    with Building(router, tmp_path) as building, open_session(connect=[router]) as session:
        async with NodeClient(session, "building") as node, asyncio.timeout(60):

            def on_manifest(manifest: Manifest) -> None:
                seen.append((manifest.points[0].name, node.sample is None))

            node.listeners.manifests.append(on_manifest)
            await asyncio.to_thread(building.replace)
            while node.sample is None or node.sample.manifest.points[0].name != "temperature":
                await asyncio.sleep(0.01)
            assert node.sample["temperature"] == 20.0
    assert seen[0] == ("temperature", True)
