"""A Modbus TCP server: frames and function codes; what is behind them is a `DataModel`.

Requests of one connection are answered in the order received, also if a client sends several without waiting for
replies, which Modbus TCP permits; pymodbus's server (3.16) answers only one of them.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from time import monotonic
from typing import NamedTuple, Protocol

from zenostat.gateways.addresses import keep_alive
from zenostat.gateways.modbus.register_map import Table
from zenostat.topics.addresses import join_address
from zenostat.topics.errors import AddressInUse, InvalidConfig

MAX_CONNECTIONS = 32
"""Largest number of connections at a time; a further one takes the place of the one that has been idle longest."""

FRAME_TIMEOUT_S = 10.0
"""Time after which a connection with an incomplete frame, or whose client does not receive its replies, is closed."""

_HEADER = struct.Struct(">HHHB")  # transaction, protocol (0), length of what follows, unit
_MAX_PDU = 253
_ON, _OFF = 0xFF00, 0x0000


class ExceptionCode(IntEnum):
    """Modbus exception codes."""

    ILLEGAL_FUNCTION = 1
    ILLEGAL_DATA_ADDRESS = 2
    ILLEGAL_DATA_VALUE = 3
    SERVER_DEVICE_FAILURE = 4
    GATEWAY_TARGET_DEVICE_FAILED_TO_RESPOND = 11


class Peer(NamedTuple):
    """The sender of a request: its IP address, and the unit id that it asks for. Neither is proven."""

    host: str
    unit: int


class ModbusException(Exception):
    """A request cannot be carried out; the client gets the code."""

    def __init__(self, code: ExceptionCode) -> None:
        super().__init__(code.name.lower())
        self.code = code


class DataModel(Protocol):
    """Registers and bits behind a server; methods raise `ModbusException`."""

    async def read_bits(self, table: Table, address: int, count: int) -> Sequence[bool]:
        """Return coils or discrete inputs."""

    async def read_registers(self, table: Table, address: int, count: int) -> Sequence[int]:
        """Return input or holding registers."""

    async def write_coils(self, peer: Peer, address: int, values: Sequence[bool]) -> None:
        """Set coils."""

    async def write_registers(self, peer: Peer, address: int, values: Sequence[int]) -> None:
        """Set holding registers."""


@dataclass(slots=True)
class Counts:
    """Counts of requests and connections.

    Attributes:
        requests, exceptions: requests, and those of them that were answered with an exception.
        malformed, displaced: connections closed for a malformed frame, and idle ones closed for a new connection.
    """

    requests: int = 0
    exceptions: int = 0
    malformed: int = 0
    displaced: int = 0


@dataclass(slots=True, eq=False)
class _Connection:
    """An open connection.

    Attributes:
        task: serves it.
        idle_since_s: time of its latest reply, or of its beginning; None while a request is carried out.
        is_displaced: whether it is being closed for another one.
    """

    task: asyncio.Task[None]
    idle_since_s: float | None
    is_displaced: bool = False


class ModbusServer:
    """A server on one address: `async with ModbusServer(model, "127.0.0.1", 1502) as server`.

    Args:
        model: registers and bits.
        host, port: address to listen on; port 0 is any free one.
        identity: texts of the function Read Device Identification, by object id.

    Raises:
        AddressInUse: on entering the context, another program listens there.
        InvalidConfig: on entering the context, there is no such address on this machine, or it is not permitted.

    Attributes:
        host, port: the address as bound.
        counts: counts of requests.
    """

    def __init__(self, model: DataModel, host: str, port: int, identity: dict[int, str] | None = None) -> None:
        self.host, self.port, self.counts = host, port, Counts()
        self._model, self._identity = model, identity or {}
        self._connections: dict[asyncio.StreamWriter, _Connection] = {}
        self._functions: dict[int, Callable[[Peer, bytes], Awaitable[bytes]]] = {
            1: self._reader_of_bits(Table.COIL),
            2: self._reader_of_bits(Table.DISCRETE_INPUT),
            3: self._reader_of_registers(Table.HOLDING_REGISTER),
            4: self._reader_of_registers(Table.INPUT_REGISTER),
            5: self._write_coil,
            6: self._write_register,
            15: self._write_coils,
            16: self._write_registers,
            23: self._read_and_write_registers,
            43: self._identify,
        }

    async def __aenter__(self) -> ModbusServer:
        try:
            self._server = await asyncio.start_server(self._serve, self.host, self.port, backlog=MAX_CONNECTIONS)
        except OSError as error:
            kind = AddressInUse if error.errno == 98 else InvalidConfig
            reason = "another program listens there" if kind is AddressInUse else error.strerror
            raise kind(f"{join_address(self.host, self.port)}: {reason}") from None
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.close_connections()
        await asyncio.gather(*(connection.task for connection in self._connections.values()))
        await self._server.wait_closed()

    def close_connections(self) -> None:
        """Close all connections; their requests in progress are not answered."""
        for connection in self._connections.values():
            connection.task.cancel()

    def _make_room(self) -> bool:
        """Return whether there is room for another connection; close the longest idle one if there is none."""
        kept = [connection for connection in self._connections.values() if not connection.is_displaced]
        if len(kept) < MAX_CONNECTIONS:
            return True
        idle = [(each.idle_since_s, each) for each in kept if each.idle_since_s is not None]
        if not idle:
            return False
        _, longest = min(idle, key=lambda entry: entry[0])
        longest.is_displaced = True
        longest.task.cancel()
        self.counts.displaced += 1
        return True

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not self._make_room():
            writer.close()
            return
        task = asyncio.current_task()
        assert task is not None
        connection = self._connections[writer] = _Connection(task, monotonic())
        # A client that has lost its power or its cable would occupy a connection; it is noticed within a minute.
        keep_alive(writer.get_extra_info("socket"), idle_s=30, interval_s=10, probes=3)
        host = str((writer.get_extra_info("peername") or ("",))[0])
        try:
            while True:
                frame = await self._frame(reader)
                if frame is None:
                    break
                transaction, unit, pdu = frame
                connection.idle_since_s = None
                reply = await self.answer(pdu, Peer(host, unit))
                writer.write(_HEADER.pack(transaction, 0, len(reply) + 1, unit) + reply)
                async with asyncio.timeout(FRAME_TIMEOUT_S):
                    await writer.drain()
                connection.idle_since_s = monotonic()
        # The client is gone or stuck, or the server closes the connection.
        except (ConnectionError, asyncio.IncompleteReadError, TimeoutError, asyncio.CancelledError):
            writer.transport.abort()  # unlike `close`, it does not wait for a client that does not receive
        finally:
            del self._connections[writer]
            writer.close()

    async def _frame(self, reader: asyncio.StreamReader) -> tuple[int, int, bytes] | None:
        """Return transaction, unit and PDU of the next request; None if what came is no Modbus frame."""
        first = await reader.readexactly(1)
        async with asyncio.timeout(FRAME_TIMEOUT_S):
            header = first + await reader.readexactly(_HEADER.size - 1)
            transaction, protocol, length, unit = _HEADER.unpack(header)
            if protocol != 0 or not 2 <= length <= _MAX_PDU + 1:
                self.counts.malformed += 1
                return None
            return transaction, unit, await reader.readexactly(length - 1)

    async def answer(self, pdu: bytes, peer: Peer) -> bytes:
        """Return the reply to a request's PDU: its function code and data, or an exception."""
        self.counts.requests += 1
        function = pdu[0]
        try:
            handler = self._functions.get(function)
            if handler is None:
                raise ModbusException(ExceptionCode.ILLEGAL_FUNCTION)
            return bytes([function]) + await handler(peer, pdu[1:])
        except ModbusException as error:
            self.counts.exceptions += 1
            return bytes([function | 0x80, error.code])

    # Function codes

    def _reader_of_bits(self, table: Table) -> Callable[[Peer, bytes], Awaitable[bytes]]:
        async def read(_: Peer, data: bytes) -> bytes:
            address, count = _fields(data, ">HH")
            _check(1 <= count <= 2000)
            packed = _pack_bits(await self._model.read_bits(table, address, count))
            return bytes([len(packed)]) + packed

        return read

    def _reader_of_registers(self, table: Table) -> Callable[[Peer, bytes], Awaitable[bytes]]:
        async def read(_: Peer, data: bytes) -> bytes:
            address, count = _fields(data, ">HH")
            _check(1 <= count <= 125)
            return _pack_registers(await self._model.read_registers(table, address, count))

        return read

    async def _write_coil(self, peer: Peer, data: bytes) -> bytes:
        address, value = _fields(data, ">HH")
        _check(value in (_ON, _OFF))
        await self._model.write_coils(peer, address, [value == _ON])
        return data

    async def _write_register(self, peer: Peer, data: bytes) -> bytes:
        address, value = _fields(data, ">HH")
        await self._model.write_registers(peer, address, [value])
        return data

    async def _write_coils(self, peer: Peer, data: bytes) -> bytes:
        address, count, size = _fields(data[:5], ">HHB")
        _check(1 <= count <= 1968 and size == (count + 7) // 8 == len(data) - 5)
        bits = [bool(data[5 + i // 8] >> (i % 8) & 1) for i in range(count)]
        await self._model.write_coils(peer, address, bits)
        return data[:4]

    async def _write_registers(self, peer: Peer, data: bytes) -> bytes:
        address, values = _written_registers(data, 123)
        await self._model.write_registers(peer, address, values)
        return data[:4]

    async def _read_and_write_registers(self, peer: Peer, data: bytes) -> bytes:
        read_address, count = _fields(data[:4], ">HH")
        _check(1 <= count <= 125)
        address, values = _written_registers(data[4:], 121)
        # Nothing is written unless both parts can be carried out.
        await self._model.read_registers(Table.HOLDING_REGISTER, read_address, count)
        await self._model.write_registers(peer, address, values)
        return _pack_registers(await self._model.read_registers(Table.HOLDING_REGISTER, read_address, count))

    async def _identify(self, _: Peer, data: bytes) -> bytes:
        """Answer Read Device Identification (MEI type 14): basic and regular objects, or one of them."""
        if data[:1] != b"\x0e":
            raise ModbusException(ExceptionCode.ILLEGAL_FUNCTION)
        _check(len(data) == 3)
        category, object_id = data[1], data[2]
        _check(1 <= category <= 4)
        if category == 4 and object_id not in self._identity:
            raise ModbusException(ExceptionCode.ILLEGAL_DATA_ADDRESS)
        last = {1: 2, 2: 6, 3: 6, 4: object_id}[category]
        first = object_id if category == 4 or object_id in self._identity else 0
        body = b""
        listed = [number for number in sorted(self._identity) if first <= number <= last]
        for number in listed:
            text = self._identity[number].encode("ascii", "replace")[:60]
            body += bytes([number, len(text)]) + text
        return bytes([0x0E, category, 0x82, 0, 0, len(listed)]) + body


def _check(is_valid: bool) -> None:  # noqa: FBT001
    """Raise the exception of an illegal value unless a request is valid."""
    if not is_valid:
        raise ModbusException(ExceptionCode.ILLEGAL_DATA_VALUE)


def _fields(data: bytes, layout: str) -> tuple[int, ...]:
    _check(len(data) == struct.calcsize(layout))
    return struct.unpack(layout, data)


def _written_registers(data: bytes, most: int) -> tuple[int, list[int]]:
    """Return address and values of a request to write registers."""
    address, count, size = _fields(data[:5], ">HHB")
    _check(1 <= count <= most and size == 2 * count == len(data) - 5)
    return address, list(struct.unpack(f">{count}H", data[5:]))


def _pack_bits(bits: Sequence[bool]) -> bytes:
    packed = bytearray((len(bits) + 7) // 8)
    for index, bit in enumerate(bits):
        packed[index // 8] |= bit << index % 8
    return bytes(packed)


def _pack_registers(registers: Sequence[int]) -> bytes:
    return struct.pack(f">B{len(registers)}H", 2 * len(registers), *registers)
