"""The registers and coils of one node."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from datetime import datetime

from zenostat.gateways.clients import UNRESTRICTED, Clients
from zenostat.gateways.modbus.register_map import FIRST_VALUE, HEADER, MAP_VERSION, STATES, RegisterMap, Table
from zenostat.gateways.modbus.server import ExceptionCode, ModbusException, ModbusServer, Peer
from zenostat.gateways.node_client import NodeClient
from zenostat.gateways.notices import Notices
from zenostat.gateways.points import effective_value, is_effective, readings
from zenostat.gateways.single_precision import intended, single
from zenostat.topics.addresses import join_address
from zenostat.topics.errors import AccessDenied, InvalidAction, RequestRejected, UnknownName, ZenostatError
from zenostat.topics.keys import is_own
from zenostat.topics.messages import Actuator, Manifest
from zenostat.topics.points import contains

_EPOCH = datetime(1970, 1, 1)
_MAX_UINT32 = 2**32 - 1


class ModbusGateway:
    """Serves one node: `async with ModbusGateway(node, "127.0.0.1", 1502) as gateway: await gateway.run()`.

    Args:
        node: the node.
        host, port: address to listen on.
        priority: priority of all commands, 1 (highest) to 16.
        is_little_endian: whether the low word of a value comes first.
        clients: names of clients, and what they may write.
        notify: called with a text when the map changes, and with the reasons of rejected writes, for which Modbus has
            only a number.
    """

    def __init__(
        self,
        node: NodeClient,
        host: str,
        port: int,
        *,
        priority: int = 8,
        is_little_endian: bool = False,
        clients: Clients = UNRESTRICTED,
        notify: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._node, self._priority, self._clients = node, priority, clients
        self._denied = 0
        self._is_little_endian = is_little_endian
        identity = {0: "Zenostat", 1: "zenostat-gateway-modbus", 2: node.manifest.versions.zenostat, 4: node.name}
        self.server = ModbusServer(self, host, port, identity)
        self._writing = asyncio.Lock()  # one request's values and their check are not mixed with another one's
        self._close = AsyncExitStack()
        self._notify, self._rejections = notify, Notices(notify)
        self._set_manifest(node.manifest)

    def _set_manifest(self, manifest: Manifest) -> None:
        self.map = RegisterMap(manifest)
        self._readings = readings(manifest)
        self._actuators: tuple[Actuator, ...] = manifest.actuators

    def _on_manifest(self, manifest: Manifest) -> None:
        """Use a new manifest; with another map, no client may go on as if its addresses were the same."""
        former = self.map.checksum
        self._set_manifest(manifest)
        if self.map.checksum != former:
            self.server.close_connections()
            self._notify(
                f"{manifest.node} has other points: the map and its checksum ({self.map.checksum}) have changed, and "
                "all connections are closed; write the new map with --map"
            )

    async def __aenter__(self) -> ModbusGateway:
        self._node.listeners.manifests.append(self._on_manifest)
        await self._close.enter_async_context(self.server)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close.aclose()
        self._node.listeners.manifests.remove(self._on_manifest)

    @property
    def description(self) -> str:
        """Node and address, for the first line."""
        address = join_address(self.server.host, self.server.port)
        safety = f"without encryption or password; {self._clients.description}"
        return f"node {self._node.name} as Modbus TCP on {address}, {safety}"

    async def run(self) -> None:
        """Serve until cancelled."""
        await asyncio.get_running_loop().create_future()

    def summary(self) -> str:
        """Return counts for the last line."""
        counts = self.server.counts
        return (
            f"{counts.requests} requests, {counts.exceptions} answered with an exception, "
            f"{self._denied} of them for writes that were denied, {counts.malformed} connections closed for malformed "
            f"frames, {counts.displaced} idle ones for new ones"
        )

    # Reading

    async def read_bits(self, table: Table, address: int, count: int) -> Sequence[bool]:
        """Return coils or discrete inputs; see `RegisterMap`."""
        if table is Table.COIL:
            _check_range(address, count, len(self._actuators))
            bits = [not math.isnan(value) for value in await self._commands()]
        else:
            bits = self._discrete_inputs()
            _check_range(address, count, len(bits))
        return bits[address : address + count]

    def _discrete_inputs(self) -> list[bool]:
        node, sample = self._node, self._node.sample
        is_up = node.is_online and sample is not None
        is_running = sample is not None and is_up and not sample.truncated and not node.has_failed
        states = [is_up, is_running, sample is not None and is_up and sample.fallback]
        states += [False] * (FIRST_VALUE - len(states))
        effective = [
            is_up and sample is not None and is_effective(sample, actuator, node.source) for actuator in self._actuators
        ]
        return states + effective

    async def read_registers(self, table: Table, address: int, count: int) -> Sequence[int]:
        """Return input or holding registers; see `RegisterMap`."""
        width = 2 * len(self._actuators)
        if table is Table.HOLDING_REGISTER:
            _check_range(address, count, width)
            values = await self._commands()
            return self._float_registers(values)[address : address + count]
        _check_range(address, count, FIRST_VALUE + 2 * len(self._readings) + width)
        return self._input_registers()[address : address + count]

    def _input_registers(self) -> list[int]:
        node, sample = self._node, self._node.sample
        if sample is None or not node.is_online:
            raise ModbusException(ExceptionCode.GATEWAY_TARGET_DEVICE_FAILED_TO_RESPOND)
        fields = {
            "map_version": MAP_VERSION,
            "readings": len(self._readings),
            "actuators": len(self._actuators),
            "map_checksum": self.map.checksum,
            "episode": sample.episode,
            "step": sample.step,
            "time": min(max(int((sample.time - _EPOCH).total_seconds()), 0), _MAX_UINT32),
            "timestep": node.manifest.step_s,
        }
        header: list[int] = []
        for name, kind, _ in HEADER:
            header += self._registers(kind, fields[name])
        header += [0] * (FIRST_VALUE - len(header))
        values = [reading.of(sample) for reading in self._readings]
        values += [effective_value(sample, index) for index in range(len(self._actuators))]
        return header + self._float_registers(values)

    async def _commands(self, slot: int = 0) -> list[float]:
        """Return the gateway's command for each actuator, of any client, as the node has it; NaN while relinquished."""
        try:
            arrays = await self._node.priorities(slot)
        except ZenostatError as error:
            raise _exception(error) from None
        entries = [arrays[actuator.name][self._priority - 1] for actuator in self._actuators]
        return [
            entry.value if entry.value is not None and is_own(self._node.source, entry.source or "") else math.nan
            for entry in entries
        ]

    def _float_registers(self, values: Sequence[float | None]) -> list[int]:
        return [word for value in values for word in self._registers("float32", math.nan if value is None else value)]

    def _registers(self, kind: str, value: float) -> list[int]:
        """Return the registers of one value, in the order of words of this gateway."""
        if kind == "uint16":
            return [int(value)]
        raw = struct.pack(">f", single(value)) if kind == "float32" else struct.pack(">I", int(value))
        words = list(struct.unpack(">HH", raw))
        return words[::-1] if self._is_little_endian else words

    # Writing

    async def write_registers(self, peer: Peer, address: int, values: Sequence[int]) -> None:
        """Command actuators; whole values only, all of them or, where one is invalid, none."""
        _check_range(address, len(values), 2 * len(self._actuators))
        if address % 2 or len(values) % 2:
            raise ModbusException(ExceptionCode.ILLEGAL_DATA_VALUE)
        numbers = [self._float_of(values[i : i + 2]) for i in range(0, len(values), 2)]
        targets = self._actuators[address // 2 : address // 2 + len(numbers)]
        self._check(peer, targets)
        numbers = [intended(actuator, number) for actuator, number in zip(targets, numbers, strict=True)]
        if not all(contains(actuator, number) for actuator, number in zip(targets, numbers, strict=True)):
            raise ModbusException(ExceptionCode.ILLEGAL_DATA_VALUE)
        await self._write(peer, dict(zip((a.name for a in targets), numbers, strict=True)))

    async def write_coils(self, peer: Peer, address: int, values: Sequence[bool]) -> None:
        """Relinquish with 0 what the gateway commands; 1 is valid only for that, and 0 changes nothing elsewhere."""
        _check_range(address, len(values), len(self._actuators))
        targets = self._actuators[address : address + len(values)]
        self._check(peer, targets)
        slots = [await self._commands(slot) for slot in range(self._node.manifest.slots)]
        is_commanded = [not all(map(math.isnan, commands)) for commands in zip(*slots, strict=True)]
        states = [*zip(targets, values, is_commanded[address : address + len(values)], strict=True)]
        if any(bit and not commanded for _, bit, commanded in states):
            raise ModbusException(ExceptionCode.ILLEGAL_DATA_VALUE)  # there is no value to command
        await self._write(peer, {actuator.name: None for actuator, bit, commanded in states if commanded and not bit})

    def _check(self, peer: Peer, actuators: Sequence[Actuator]) -> None:
        """Raise the exception of an illegal function unless a client may write all of some actuators."""
        try:
            self._clients.check(self._clients.of_modbus(*peer), (actuator.name for actuator in actuators))
        except AccessDenied as error:
            self._denied += 1
            self._rejections.add(f"a write of {peer.host}, unit {peer.unit}, was denied: {error}")
            raise ModbusException(ExceptionCode.ILLEGAL_FUNCTION) from None

    async def _write(self, peer: Peer, values: dict[str, float | None]) -> None:
        source = self._node.source_of(self._clients.of_modbus(*peer))
        async with self._writing:
            try:
                for name, value in values.items():
                    await self._node.write(name, value, priority=self._priority, source=source)
            except ZenostatError as error:
                if isinstance(error, RequestRejected):
                    self._rejections.add(f"a write was rejected: {error}")
                raise _exception(error) from None

    def _float_of(self, words: Sequence[int]) -> float:
        ordered = words[::-1] if self._is_little_endian else words
        return float(struct.unpack(">f", struct.pack(">HH", *ordered))[0])


def _check_range(address: int, count: int, size: int) -> None:
    """Raise the exception of an illegal address unless all addresses exist."""
    if address + count > size:
        raise ModbusException(ExceptionCode.ILLEGAL_DATA_ADDRESS)


def _exception(error: ZenostatError) -> ModbusException:
    if isinstance(error, RequestRejected | UnknownName | InvalidAction):
        return ModbusException(ExceptionCode.SERVER_DEVICE_FAILURE)
    return ModbusException(ExceptionCode.GATEWAY_TARGET_DEVICE_FAILED_TO_RESPOND)


assert len(STATES) <= FIRST_VALUE
