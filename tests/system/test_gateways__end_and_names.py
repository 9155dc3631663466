"""Common behavior of gateways of all protocols: their end, and names that only one of them may have."""

import asyncio
import os
import signal
import socket
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from subprocess import PIPE
from typing import IO

import pytest
from pymodbus.client import ModbusTcpClient
from support.bacnet import client as bacnet_client
from support.bacnet import free_udp_port
from support.gateways import RunningGateway
from support.mqtt_broker import Broker, needs_broker
from support.nodes import NodeProgram, node_on_bus, until
from support.run_cli import ZENOSTAT, error_of, run_in_process

import zenostat
from zenostat import Bus
from zenostat.topics.messages import Reset

PLANT = f"{Path(__file__).parents[2]}/examples/own_plant.py:HeatPumpRoom"
ENDS = pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])


@pytest.fixture(scope="module")
def room(module_folder: Path) -> Iterator[NodeProgram]:
    """A node with two slots whose plant is a Python class: it starts within a second."""
    with NodeProgram(module_folder / "room", plant=PLANT, name="room", slots=2) as program:
        yield program


@pytest.fixture
def bus(room: NodeProgram) -> Iterator[Bus]:
    """The bus of the node, on which somebody else commands the compressor."""
    with zenostat.connect(room.endpoint, affinity="off") as connected:
        connected.write("room", "compressor", 900.0, priority=12, source="operator")
        yield connected
        for priority in range(1, 17):
            connected.write("room", "compressor", None, priority=priority)


def commands(bus: Bus) -> list[dict[int, tuple[float, str]]]:
    """The commands of the compressor by priority, in each slot."""
    arrays = [bus.priorities("room", slot=slot)["compressor"] for slot in range(2)]
    return [{n: tuple(entry) for n, entry in enumerate(array, 1) if entry.value is not None} for array in arrays]


OTHERS = [{12: (900.0, "operator")}] * 2


@pytest.mark.slow
@pytest.mark.variants
@ENDS
def test_modbus__relinquishes_what_it_commanded_although_a_client_is_connected(
    room: NodeProgram, bus: Bus, end: signal.Signals
) -> None:
    with (
        RunningGateway("modbus", "room", "--connect", room.endpoint, "--address", "127.0.0.1:0") as gateway,
        ModbusTcpClient("127.0.0.1", port=gateway.port, timeout=20) as client,
    ):
        registers = list(struct.unpack(">HH", struct.pack(">f", 500.0)))
        assert not client.write_registers(0, registers, device_id=1).isError()
        assert commands(bus) == [{8: (500.0, "modbus"), 12: (900.0, "operator")}] * 2  # in all slots
        assert client.read_coils(0, count=2, device_id=1).bits[:2] == [True, False]
        code, out, err = gateway.end(end)
    assert (code, err) == (0, "")
    assert "relinquished 1 command" in out
    assert commands(bus) == OTHERS


@pytest.mark.slow
@needs_broker
@pytest.mark.parametrize("protocol", ["modbus", "mqtt", "bacnet"])
def test_gateways__one_that_is_started_again_after_a_kill_relinquishes_what_the_former_left(
    room: NodeProgram, bus: Bus, tmp_path: Path, protocol: str
) -> None:
    port = free_udp_port()
    with Broker(tmp_path) as broker:
        options = {
            "modbus": ["--address", "127.0.0.1:0"],
            "mqtt": ["--broker", f"127.0.0.1:{broker.port}"],
            "bacnet": ["--address", f"127.0.0.1:{port}"],
        }[protocol]
        words = (protocol, "room", "--connect", room.endpoint, *options)
        with RunningGateway(*words) as gateway:
            if protocol == "modbus":
                with ModbusTcpClient("127.0.0.1", port=gateway.port, timeout=20) as client:
                    registers = list(struct.unpack(">HH", struct.pack(">f", 500.0)))
                    assert not client.write_registers(0, registers, device_id=1).isError()
            elif protocol == "mqtt":
                until(lambda: broker.retained("zenostat/room/status") == "online", "it is online")
                broker.publish("zenostat/room/actuator/compressor/set", '{"value": 500, "source": "node-red"}')
                until(lambda: commands(bus) != OTHERS, "it is commanded")
            else:
                asyncio.run(_command_by_bacnet(port, 500.0, priority=8))
            sources = [array[8][1].split(".")[0] for array in commands(bus)]
            assert sources == [protocol] * 2
            gateway.program.kill()
            gateway.program.wait()
        with RunningGateway(*words) as gateway:
            code, out, _ = gateway.end()
    assert code == 0
    assert "relinquished 1 command of this gateway" in out
    assert commands(bus) == OTHERS


async def _command_by_bacnet(port: int, value: float, priority: int) -> None:
    async with bacnet_client(port) as client:
        await client.learn()
        assert await client.write("compressor", value, priority=priority) == "ok"


@pytest.mark.slow
def test_modbus__coil_relinquishes_a_command_that_another_slot_alone_has(room: NodeProgram, bus: Bus) -> None:
    with (
        RunningGateway("modbus", "room", "--connect", room.endpoint, "--address", "127.0.0.1:0") as gateway,
        ModbusTcpClient("127.0.0.1", port=gateway.port, timeout=20) as client,
    ):
        registers = list(struct.unpack(">HH", struct.pack(">f", 500.3)))
        assert not client.write_registers(0, registers, device_id=1).isError()
        bus.reset("room", Reset(slots=[0]))
        assert commands(bus) == [{}, {8: (500.3, "modbus"), 12: (900.0, "operator")}]
        assert not client.write_coil(0, False, device_id=1).isError()
        assert commands(bus) == [{}, OTHERS[1]]


@pytest.mark.slow
@pytest.mark.variants
@needs_broker
@ENDS
def test_mqtt__relinquishes_each_priority_and_source_and_is_offline(
    room: NodeProgram, bus: Bus, tmp_path: Path, end: signal.Signals
) -> None:
    broker_options = ["--connect", room.endpoint]
    with (
        Broker(tmp_path) as broker,
        RunningGateway("mqtt", "room", *broker_options, "--broker", f"127.0.0.1:{broker.port}") as gateway,
    ):
        topic = "zenostat/room/actuator/compressor/set"
        until(lambda: broker.retained("zenostat/room/status") == "online", "it is online")
        with broker.subscribed("zenostat/room/actuator/+/result") as results:
            broker.publish(topic, '{"value": 700, "priority": 3, "source": "node-red"}')
            broker.publish(topic, '{"value": 600, "source": ""}')
            broker.publish(topic, '{"value": 500, "priority": 12}')
            bus_has = {3: (700.0, "mqtt.node-red"), 8: (600.0, "mqtt"), 12: (500.0, "mqtt")}
            until(lambda: commands(bus) == [bus_has] * 2, "all are commanded")
            bus.write("room", "compressor", 900.0, priority=12, source="operator")  # it is not the gateway's any more
            broker.publish(topic, '{"value": 99999, "priority": 3, "source": "panel"}')  # rejected: the other one stays
            until(lambda: len(results) == 4, "all are answered")
        code, out, err = gateway.end(end)
        assert (code, err) == (0, "")
        assert "relinquished 2 commands" in out
        assert broker.retained("zenostat/room/status") == "offline"
    assert commands(bus) == OTHERS


@pytest.mark.slow
@pytest.mark.variants
@ENDS
def test_bacnet__relinquishes_what_its_clients_commanded(room: NodeProgram, bus: Bus, end: signal.Signals) -> None:
    port = free_udp_port()

    async def command() -> None:
        async with bacnet_client(port) as client:
            await client.learn()
            assert await client.write("compressor", 500.0, priority=5) == "ok"
            assert await client.write("compressor", 400.0) == "ok"

    address = ["--address", f"127.0.0.1:{port}"]
    with RunningGateway("bacnet", "room", "--connect", room.endpoint, *address) as gateway:
        asyncio.run(command())
        assert [set(array) for array in commands(bus)] == [{5, 12, 16}] * 2
        code, out, err = gateway.end(end)
    assert (code, len(err.splitlines())) == (0, 1)  # the warning of its beginning
    assert "relinquished 2 commands" in out
    assert commands(bus) == OTHERS


@pytest.mark.slow
def test_gateways__command_that_cannot_be_relinquished_is_named_at_the_end(room: NodeProgram, bus: Bus) -> None:
    options = ["--connect", room.endpoint, "--address", "127.0.0.1:0"]
    with (
        RunningGateway("modbus", "room", *options) as gateway,
        ModbusTcpClient("127.0.0.1", port=gateway.port, timeout=20) as client,
    ):
        for address in (0, 2):
            registers = list(struct.unpack(">HH", struct.pack(">f", 0.5)))
            assert not client.write_registers(address, registers, device_id=1).isError()
        with bus.controller("room", name="mine", priority=8, actuators=["circulation"], required=False):
            code, out, err = gateway.end()
    assert code == 0
    assert "relinquished 1 command of this gateway" in out
    assert err.count("\n") == 1
    assert "remains in force: circulation at priority 8, written as modbus: " in err
    assert "is claimed by 'mine" in err
    assert commands(bus) == OTHERS
    bus.reset("room", Reset())


@pytest.mark.slow
def test_gateways__end_of_the_episode_is_no_error_of_a_gateway_that_ends(tmp_path: Path) -> None:
    with (
        node_on_bus(tmp_path / "room", plant=PLANT, name="room") as (room, bus),
        RunningGateway("modbus", "room", "--connect", room.endpoint, "--address", "127.0.0.1:0") as gateway,
    ):
        with ModbusTcpClient("127.0.0.1", port=gateway.port, timeout=20) as client:
            registers = list(struct.unpack(">HH", struct.pack(">f", 500.0)))
            assert not client.write_registers(0, registers, device_id=1).isError()
            bus.pace("room", mode="free")
            until(lambda: client.read_discrete_inputs(1, count=1, device_id=1).bits[0] is False, "the episode is over")
            for _ in range(2):
                assert client.write_registers(0, registers, device_id=1).exception_code == 4
        code, _, err = gateway.end()
    assert code == 0
    reason = "a write was rejected: compressor: the episode is over, and a write has no effect; reset it first"
    assert err.splitlines() == [reason]  # once


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    ("first", "second", "name", "advice"),
    [
        (("modbus", "--address", "127.0.0.1:0"), ("modbus", "--address", "127.0.0.1:0"), "modbus", "--source"),
        (
            ("modbus", "--address", "127.0.0.1:0"),
            ("modbus", "--address", "127.0.0.1:0", "--source", "modbus.two"),  # whose commands would count as its own
            "modbus",
            "--source",
        ),
        (
            ("modbus", "--address", "127.0.0.1:0", "--source", "fire_panel"),
            ("bacnet", "--address", "127.0.0.1:47999", "--source", "fire_panel"),
            "fire_panel",
            "--source",
        ),
        (
            ("bacnet", "--address", "127.0.0.1:47997", "--instance", "7"),
            ("bacnet", "--address", "127.0.0.1:47998", "--instance", "7", "--source", "other"),
            "BACnet device 7",
            "--instance",
        ),
    ],
)
def test_gateways__second_gateway_with_the_same_name_is_refused_until_the_first_has_ended(
    room: NodeProgram, first: tuple[str, ...], second: tuple[str, ...], name: str, advice: str
) -> None:
    bus = ["room", "--connect", room.endpoint]
    with RunningGateway(first[0], *bus, *first[1:]) as running:
        error = error_of("gateway", second[0], *bus, *second[1:], code=1)
        assert f"uses {name!r} already (process {running.program.pid} on {socket.gethostname()})" in error
        assert advice in error
        running.program.kill()
        running.program.wait()
    with RunningGateway(second[0], *bus, *second[1:]) as running:
        assert running.end()[0] == 0


@pytest.mark.slow
@needs_broker
def test_gateways__one_topic_of_a_broker_has_one_gateway_of_a_node(room: NodeProgram, tmp_path: Path) -> None:
    with Broker(tmp_path) as broker:
        words = ["room", "--connect", room.endpoint, "--broker", f"127.0.0.1:{broker.port}"]
        with RunningGateway("mqtt", *words):
            for host in ("127.0.0.1", "localhost"):
                other = [*words[:-1], f"{host}:{broker.port}", "--source", "other"]
                error = error_of("gateway", "mqtt", *other, code=1)
                assert f"'zenostat/room on {socket.gethostname()}:{broker.port}' already" in error
                assert "--topic" in error
            with RunningGateway("mqtt", *words, "--source", "other", "--topic", "another") as running:
                assert running.end()[0] == 0


@pytest.mark.slow
@pytest.mark.variants
@ENDS
def test_gateways__signal_ends_a_gateway_that_is_not_ready_yet(room: NodeProgram, end: signal.Signals) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent_broker:
        address = f"127.0.0.1:{silent_broker.getsockname()[1]}"
        command = [*ZENOSTAT, "gateway", "mqtt", "room", "--connect", room.endpoint, "--broker", address]
        with subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True) as program, silent_broker.accept()[0]:
            program.send_signal(end)
            out, err = program.communicate(timeout=60)
    assert (program.returncode, out, err) == (128 + end, "", "")


@pytest.mark.slow
def test_gateways__frozen_node_does_not_keep_a_gateway_from_ending(tmp_path: Path) -> None:
    with (
        NodeProgram(tmp_path / "room", plant=PLANT, name="room") as room,
        RunningGateway("modbus", "room", "--connect", room.endpoint, "--address", "127.0.0.1:0") as gateway,
        socket.create_connection(("127.0.0.1", gateway.port)) as client,
    ):
        os.kill(room.pid, signal.SIGSTOP)
        try:
            read, write = struct.pack(">BHH", 4, 0, 1), struct.pack(">BHHBf", 16, 0, 2, 4, 500.0)
            client.sendall(b"".join(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu for pdu in (read, write)))
            assert client.recv(100)  # the reading is answered, so the write is in progress
            code, _, err = gateway.end()
        finally:
            os.kill(room.pid, signal.SIGCONT)
    assert code == 0
    assert err == "commands through this gateway are not relinquished: node 'room' does not answer\n"


def until_line(lines: IO[str], begin: str) -> str:
    """Return the next line that begins so; a node that is starting may first not answer."""
    return next(line for line in lines if line.startswith(begin))


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["modbus", "room", "--address", "127.0.0.1:0"], "ready: "),
        (["zeromq", "--node", "room", "--publish", "tcp://127.0.0.1:*", "--command", "tcp://127.0.0.1:*"], "ready: "),
        (["modbus", "room", "--map", "map.csv"], "map of room: "),
        (["bacnet", "room", "--objects", "objects.csv"], "objects of room: "),
    ],
    ids=["modbus", "zeromq", "map", "objects"],
)
def test_gateways__gateway_that_is_started_first_waits_for_bus_and_node(
    tmp_path: Path, options: list[str], line: str
) -> None:
    endpoint = f"unixsock-stream/{tmp_path}/other/bus"
    words = ["gateway", *options, "--connect", endpoint]
    assert "nobody listens on" in run_in_process(*words, columns=500).stderr
    with subprocess.Popen([*ZENOSTAT, *words, "--wait"], stdout=PIPE, stderr=PIPE, text=True, cwd=tmp_path) as program:
        try:
            assert program.stdout is not None
            lines = program.stdout
            assert lines.readline().startswith("nobody listens on")
            with NodeProgram(tmp_path / "other", plant=PLANT, name="other") as other:
                until_line(lines, "no node 'room' on ")
                with NodeProgram(tmp_path / "room", plant=PLANT, name="room", listen=[], connect=[other.endpoint]):
                    until_line(lines, line)
                    if line == "ready: ":
                        program.send_signal(signal.SIGTERM)
                    out, err = program.communicate(timeout=60)
        finally:
            program.kill()
    assert (program.returncode, err) == (0, ""), out


@pytest.mark.slow
def test_gateways__signal_ends_a_gateway_that_waits(tmp_path: Path) -> None:
    words = ["gateway", "mqtt", "room", "--connect", f"unixsock-stream/{tmp_path}/bus", "--wait"]
    with subprocess.Popen([*ZENOSTAT, *words], stdout=PIPE, stderr=PIPE, text=True) as program:
        assert program.stdout is not None
        assert "; waiting for it, press Ctrl-C to stop" in program.stdout.readline()
        program.send_signal(signal.SIGTERM)
        out, err = program.communicate(timeout=60)
    assert (program.returncode, out, err) == (128 + signal.SIGTERM, "", "")
