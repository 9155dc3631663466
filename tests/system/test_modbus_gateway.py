"""The Modbus gateway of a real node, with clients that are not ours: pymodbus, and mbpoll where it is installed."""

import asyncio
import math
import random
import shutil
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient
from support.csv_files import csv_rows
from support.gateways import RunningGateway
from support.nodes import NodeProgram, begin_new_episode, until
from support.run_cli import run_in_process, run_program

from zenostat import Bus
from zenostat.bridge.transport.session import open_session
from zenostat.gateways.modbus import server
from zenostat.gateways.modbus.gateway import ModbusGateway
from zenostat.gateways.node_client import NodeClient
from zenostat.topics.errors import AddressInUse

COOLING = "core_zn_cooling_setpoint"
UNIT = 1


@contextmanager
def gateway(endpoint: str, *options: str) -> Iterator[int]:
    """A running gateway of the node `office`; yields its port. It must end without an error but rejected writes."""
    options = ("--connect", endpoint, "--address", "127.0.0.1:0", *options)
    with RunningGateway("modbus", "office", *options) as running:
        assert "without encryption or password" in running.description
        yield running.port
        code, out, err = running.end()
    assert code == 0, err
    assert all(line.startswith("a write was rejected: ") for line in err.splitlines()), err
    assert "requests" in out


@pytest.fixture(scope="module")
def port(shared_node: NodeProgram) -> Iterator[int]:
    with gateway(shared_node.endpoint) as running:
        yield running


@pytest.fixture
def client(port: int, bus: Bus) -> Iterator[ModbusTcpClient]:
    with ModbusTcpClient("127.0.0.1", port=port, timeout=20) as connected:
        yield connected


@pytest.fixture
def bus(stepping_bus: Bus) -> Bus:
    return stepping_bus


def _floats(registers: list[int], *, little: bool = False) -> list[float]:
    pairs = [registers[i : i + 2] for i in range(0, len(registers), 2)]
    return [struct.unpack(">f", struct.pack(">HH", *(pair[::-1] if little else pair)))[0] for pair in pairs]


def _registers(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


def _index(bus: Bus) -> int:
    """Return the position of the cooling setpoint among the actuators."""
    return [a.name for a in bus.manifest("office").actuators].index(COOLING)


def _step(bus: Bus, client: ModbusTcpClient) -> None:
    """Simulate a timestep, and wait until the gateway has its sample."""
    before = bus.latest("office").step[0]
    bus.step("office")
    until(lambda: client.read_input_registers(7, count=1, device_id=UNIT).registers == [before + 1], "the sample came")


def _float32(value: float) -> float:
    return float(struct.unpack(">f", struct.pack(">f", value))[0])


@pytest.mark.slow
def test_modbus_gateway__input_registers_are_the_sample_by_the_written_map(
    bus: Bus, client: ModbusTcpClient, tmp_path: Path
) -> None:
    file = tmp_path / "map.csv"
    done = run_in_process("gateway", "modbus", "office", "--map", str(file), "--connect", bus.endpoint)
    assert done.returncode == 0, done.stderr
    rows = [row for row in csv_rows(file) if row["table"] == "input register"]
    _step(bus, client)
    sample = bus.read("office")
    expected = sample.as_dict()
    units = {point.name: point.unit for point in sample.manifest.points}
    commanded = dict(zip([a.name for a in sample.manifest.actuators], sample.effective.tolist(), strict=True))
    seen = {}
    for row in rows:
        address, count = int(row["address"]), int(row["count"])
        registers = client.read_input_registers(address, count=count, device_id=UNIT).registers
        raw = struct.pack(f">{count}H", *registers)
        seen[row["name"]] = struct.unpack({"uint16": ">H", "uint32": ">I", "float32": ">f"}[row["type"]], raw)[0]
        if row["unit"] == "W" and units.get(row["name"]) == "J":
            expected[row["name"]] /= sample.manifest.step_s  # mean power
    assert (seen.pop("episode"), seen.pop("step")) == (sample.episode, sample.step)
    assert seen.pop("time") == (sample.time - datetime(1970, 1, 1)).total_seconds()
    assert seen.pop("timestep") == sample.manifest.step_s
    assert seen.pop("map_version") == 1
    assert seen.pop("readings") == len(sample.manifest.points)
    assert seen.pop("actuators") == len(sample.manifest.actuators)
    seen.pop("map_checksum")
    assert seen == {name: _float32(value) for name, value in {**expected, **commanded}.items()}


def test_modbus_gateway__write_is_a_command_until_its_coil_is_cleared(bus: Bus, client: ModbusTcpClient) -> None:
    index = _index(bus)
    assert not any(client.read_coils(0, count=index + 1, device_id=UNIT).bits[: index + 1])
    assert math.isnan(_floats(client.read_holding_registers(2 * index, count=2, device_id=UNIT).registers)[0])
    assert not client.write_registers(2 * index, _registers(26.5), device_id=UNIT).isError()
    assert bus.priorities("office")[COOLING][7] == (26.5, "modbus")
    assert client.read_coils(index, count=1, device_id=UNIT).bits[0]
    assert _floats(client.read_holding_registers(2 * index, count=2, device_id=UNIT).registers) == [26.5]
    assert not client.read_discrete_inputs(16 + index, count=1, device_id=UNIT).bits[0]  # from the next timestep on
    _step(bus, client)
    sample = bus.read("office")
    assert sample.effective[index] == 26.5
    assert sample.value_source[COOLING] == "modbus"
    assert client.read_discrete_inputs(16 + index, count=1, device_id=UNIT).bits[0]
    bus.write("office", COOLING, 24.0, priority=3, source="fire_panel")
    _step(bus, client)
    assert not client.read_discrete_inputs(16 + index, count=1, device_id=UNIT).bits[0]  # a higher priority is
    assert client.read_coils(index, count=1, device_id=UNIT).bits[0]
    assert not client.write_coil(index, False, device_id=UNIT).isError()
    assert bus.priorities("office")[COOLING][7] == (None, None)
    assert client.write_coil(index, True, device_id=UNIT).exception_code == 3  # there is no value to command


def test_modbus_gateway__coils_written_0_relinquish_what_the_gateway_commands_alone(
    bus: Bus, client: ModbusTcpClient
) -> None:
    count, index, heating = len(bus.manifest("office").actuators), _index(bus), "core_zn_heating_setpoint"
    bus.write("office", heating, 19.0, priority=8, source="operator")
    assert not client.write_registers(2 * index, _registers(26.0), device_id=UNIT).isError()
    for _ in range(2):  # as a PLC that writes all its coils in each cycle
        assert not client.write_coils(0, [False] * count, device_id=UNIT).isError()
        assert bus.priorities("office")[heating][7] == (19.0, "operator")
        assert bus.priorities("office")[COOLING][7] == (None, None)


def test_modbus_gateway__bounds_are_reached_in_spite_of_the_rounding_to_float32(
    bus: Bus, client: ModbusTcpClient
) -> None:
    for index, actuator in enumerate(bus.manifest("office").actuators):
        for bound in (actuator.low, actuator.high):
            if bound is not None:
                assert not client.write_registers(2 * index, _registers(bound), device_id=UNIT).isError()
                assert bus.priorities("office")[actuator.name][7].value == bound


def test_modbus_gateway__invalid_requests_have_modbus_exceptions_and_move_nothing(
    bus: Bus, client: ModbusTcpClient
) -> None:
    manifest = bus.manifest("office")
    width, size = 2 * len(manifest.actuators), 16 + 2 * len(manifest.points) + 2 * len(manifest.actuators)
    index = [a.name for a in manifest.actuators].index(COOLING)
    at, good = 2 * index, _registers(25.0)
    for expected, reply in {
        "half a value": (3, client.write_register(at, good[0], device_id=UNIT)),
        "half of two values": (3, client.write_registers(at + 1, good, device_id=UNIT)),
        "NaN": (3, client.write_registers(at, _registers(math.nan), device_id=UNIT)),
        "infinity": (3, client.write_registers(at, _registers(math.inf), device_id=UNIT)),
        "beyond the bounds": (3, client.write_registers(at, _registers(99.0), device_id=UNIT)),
        "one of two beyond": (3, client.write_registers(0, [*_registers(21.0), *_registers(99.0)], device_id=UNIT)),
        "no such register": (2, client.write_registers(width, good, device_id=UNIT)),
        "across the end": (2, client.write_registers(width - 2, good + good, device_id=UNIT)),
        "no such input": (2, client.read_input_registers(size, count=1, device_id=UNIT)),
        "no such coil": (2, client.read_coils(len(manifest.actuators), count=1, device_id=UNIT)),
        "no such discrete input": (2, client.read_discrete_inputs(16 + width // 2, count=1, device_id=UNIT)),
        "written, but cannot be read": (
            2,
            client.readwrite_registers(
                read_address=width, read_count=1, write_address=at, values=_registers(25.0), device_id=UNIT
            ),
        ),
        "no such function": (1, client.mask_write_register(address=at, and_mask=0, or_mask=0, device_id=UNIT)),
    }.items():
        code, answer = reply
        assert answer.exception_code == code, expected
    assert all(entry.value is None for array in bus.priorities("office").values() for entry in array)
    assert not client.read_input_registers(size - 1, count=1, device_id=UNIT).isError()


def test_modbus_gateway__nodes_own_refusal_is_a_device_failure(bus: Bus, client: ModbusTcpClient) -> None:
    index = _index(bus)
    with bus.controller("office", name="mine", priority=8, actuators=[COOLING], required=False):
        answer = client.write_registers(2 * index, _registers(25.0), device_id=UNIT)
        assert answer.exception_code == 4
    assert bus.priorities("office")[COOLING][7].value is None


def test_modbus_gateway__new_episode_has_relinquished_everything(bus: Bus, client: ModbusTcpClient) -> None:
    index = _index(bus)
    assert not client.write_registers(2 * index, _registers(26.0), device_id=UNIT).isError()
    begin_new_episode(bus)
    assert not client.read_coils(index, count=1, device_id=UNIT).bits[0]
    assert math.isnan(_floats(client.read_holding_registers(2 * index, count=2, device_id=UNIT).registers)[0])


def test_modbus_gateway__requests_sent_at_once_are_all_answered_in_order(bus: Bus, port: int) -> None:
    frames = [struct.pack(">HHHBBHH", number, 0, 6, UNIT, 4, number % 8, 1) for number in range(200)]
    with socket.create_connection(("127.0.0.1", port), timeout=30) as connection:
        connection.sendall(b"".join(frames))
        answers = b""
        while len(answers) < 200 * 11:
            chunk = connection.recv(65536)
            assert chunk
            answers += chunk
    transactions = [struct.unpack(">H", answers[i : i + 2])[0] for i in range(0, len(answers), 11)]
    assert transactions == list(range(200))


def test_modbus_gateway__noise_half_frames_and_dying_clients_harm_nobody(
    bus: Bus, client: ModbusTcpClient, port: int
) -> None:
    chance = random.Random(7)
    for number in range(300):
        with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
            kind = number % 4
            pdu = bytes([chance.choice([1, 2, 3, 4, 7, 8, 17, 20, 43, 90])]) + chance.randbytes(chance.randrange(12))
            frame = struct.pack(">HHHB", number, 0, len(pdu) + 1, UNIT) + pdu
            if kind == 0:
                connection.sendall(chance.randbytes(chance.randrange(1, 300)))
            elif kind == 1:
                connection.sendall(frame[: chance.randrange(1, len(frame))])  # and then it is gone
            elif kind == 2:
                connection.sendall(frame * 5)  # and the replies are not read
            else:
                connection.sendall(frame)
                answer = connection.recv(300)
                assert answer[:2] == frame[:2]
                assert answer[7] in (pdu[0], pdu[0] | 0x80)
    assert all(entry.value is None for array in bus.priorities("office").values() for entry in array)
    assert not client.read_input_registers(0, count=16, device_id=UNIT).isError()


def test_modbus_gateway__33rd_client_takes_the_place_of_the_longest_idle_one(bus: Bus, port: int) -> None:
    request = struct.pack(">HHHBBHH", 1, 0, 6, UNIT, 4, 0, 1)

    def is_served(connection: socket.socket) -> bool:
        try:
            connection.sendall(request)
            return len(connection.recv(100)) == 11
        except ConnectionError:
            return False

    with ExitStack() as opened:

        def connect() -> socket.socket:
            return opened.enter_context(socket.create_connection(("127.0.0.1", port), timeout=20))

        connections = [connect() for _ in range(32)]
        assert all(map(is_served, connections))
        assert is_served(connections[0])  # now the second is the longest idle one
        silent = connect()
        newest = connect()
        assert is_served(newest)
        assert [is_served(connection) for connection in connections] == [True, False, False] + [True] * 29
        assert is_served(silent)


async def test_modbus_gateway__connection_whose_request_is_carried_out_keeps_its_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(server, "MAX_CONNECTIONS", 1)
    request = struct.pack(">HHHBBHH", 1, 0, 6, UNIT, 1, 0, 1)

    class Slow:
        """A model whose reply comes when the test allows it."""

        is_reading, may_reply = asyncio.Event(), asyncio.Event()

        async def read_bits(self, *_: object) -> list[bool]:
            self.is_reading.set()
            await self.may_reply.wait()
            return [True]

    async with server.ModbusServer(Slow(), "127.0.0.1", 0) as running:
        reader, writer = await asyncio.open_connection("127.0.0.1", running.port)
        writer.write(request)
        await Slow.is_reading.wait()
        other, other_writer = await asyncio.open_connection("127.0.0.1", running.port)
        assert await other.read() == b""  # it is turned away
        Slow.may_reply.set()
        assert (await reader.readexactly(10))[-1] == 1
        writer.close()
        other_writer.close()


async def test_modbus_gateway__ipv6_address_has_brackets(bus: Bus) -> None:
    with open_session(connect=[bus.endpoint]) as session:
        async with NodeClient(session, "office") as node, ModbusGateway(node, "::1", 0) as gateway:
            assert f" on [::1]:{gateway.server.port}, " in gateway.description
            with pytest.raises(AddressInUse, match=rf"^\[::1\]:{gateway.server.port}: another program listens there"):
                async with ModbusGateway(node, "::1", gateway.server.port):
                    pass


async def test_modbus_gateway__clients_that_do_not_receive_or_have_lost_their_power_do_not_keep_connections(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "FRAME_TIMEOUT_S", 0.2)
    read = struct.pack(">HHHBBHH", 1, 0, 6, UNIT, 4, 0, 90)
    with open_session(connect=[bus.endpoint]) as session, socket.socket() as client:
        async with NodeClient(session, "office") as node, ModbusGateway(node, "127.0.0.1", 0) as gateway:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            client.connect(("127.0.0.1", gateway.server.port))
            client.setblocking(False)
            async with asyncio.timeout(60):
                while not gateway.server._connections:
                    await asyncio.sleep(0.01)
                (writer,) = gateway.server._connections
                connection = writer.get_extra_info("socket")
                assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
                while gateway.server._connections:
                    with suppress(BlockingIOError, ConnectionError):
                        client.send(read * 1000)
                    await asyncio.sleep(0.01)


def test_modbus_gateway__example_raises_the_setpoint_while_nobody_is_there(bus: Bus, port: int, tmp_path: Path) -> None:
    file = tmp_path / "map.csv"
    run_in_process("gateway", "modbus", "office", "--map", str(file), "--connect", bus.endpoint)
    example = Path(__file__).parents[2] / "examples" / "modbus_client.py"
    command = [sys.executable, str(example), str(file), "--port", str(port), "--cycles", "1", "--pause", "0"]

    def cycle() -> str:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        return done.stdout

    people = "core_zn_occupants"
    assert bus.read("office")[people] == 0  # at midnight
    assert "setpoint raised" in cycle()
    assert bus.priorities("office")[COOLING][7] == (28.0, "modbus")
    until(lambda: bus.step("office") or bus.read("office")[people] > 0, "people have come")
    until(lambda: "of the building" in cycle(), "the gateway has that sample")
    assert bus.priorities("office")[COOLING][7].value is None


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed; on Debian: apt install mbpoll")
def test_modbus_gateway__mbpoll_reads_and_writes(bus: Bus, port: int) -> None:
    actuators = [a.name for a in bus.manifest("office").actuators]
    manifest = bus.manifest("office")

    def mbpoll(*options: str) -> subprocess.CompletedProcess[str]:
        command = ["mbpoll", "-p", str(port), "-a", str(UNIT), "-1", "-0", *options]
        return subprocess.run(command, capture_output=True, text=True, timeout=60)

    sample = bus.read("office")
    done = mbpoll("-t", "3:float", "-B", "-r", "16", "-c", "3", "127.0.0.1")
    shown = [float(line.split()[-1]) for line in done.stdout.splitlines() if line.startswith("[")]
    scale = [1 / manifest.step_s if point.unit == "J" else 1.0 for point in manifest.points[:3]]
    assert shown == pytest.approx((sample.values[:3] * scale).tolist(), rel=1e-5)
    register = str(2 * actuators.index(COOLING))
    done = mbpoll("-t", "4:float", "-B", "-r", register, "127.0.0.1", "26.5")
    assert "Written 1 references" in done.stdout, done.stdout + done.stderr
    assert bus.priorities("office")[COOLING][7] == (26.5, "modbus")
    done = mbpoll("-t", "4:float", "-B", "-r", register, "127.0.0.1", "99")
    assert "Illegal data value" in done.stdout + done.stderr
    mbpoll("-t", "0", "-r", str(actuators.index(COOLING)), "127.0.0.1", "0")
    assert bus.priorities("office")[COOLING][7] == (None, None)


def test_word_order__low_word_first_if_configured(bus: Bus) -> None:
    with (
        gateway(bus.endpoint, "--word-order", "little", "--source", "plc", "--priority", "5") as port,
        ModbusTcpClient("127.0.0.1", port=port, timeout=20) as client,
    ):
        sample = bus.read("office")
        assert _floats(client.read_input_registers(16, count=2, device_id=UNIT).registers, little=True) == [
            _float32(float(sample.values[0]))
        ]
        index = [a.name for a in sample.manifest.actuators].index(COOLING)
        assert not client.write_registers(2 * index, _registers(25.5)[::-1], device_id=UNIT).isError()
        assert bus.priorities("office")[COOLING][4] == (25.5, "plc")


@pytest.mark.slow
def test_modbus_gateway__port_in_use_is_named(shared_node: NodeProgram, port: int) -> None:
    address = ["--address", f"127.0.0.1:{port}", "--connect", shared_node.endpoint, "--source", "another"]
    done = run_program("gateway", "modbus", "office", *address)
    assert done.returncode != 0
    assert f"127.0.0.1:{port}: another program listens there" in done.stderr
