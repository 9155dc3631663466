"""Gateway for FMUs of a node: each connection is a controller of the node, in lockstep with it."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import isnan
from socketserver import BaseRequestHandler, ThreadingTCPServer
from typing import Any

import numpy as np
from typing_extensions import override

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.client.sample import SampleView
from zenostat.gateways.addresses import keep_alive
from zenostat.gateways.clients import EVERYTHING, UNRESTRICTED, Clients
from zenostat.gateways.fmi.description import Interface
from zenostat.gateways.fmi.messages import Flags, Kind, MalformedRequest, encode, encode_failure, read_request
from zenostat.gateways.notices import Notices
from zenostat.topics.addresses import join_address
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import AddressInUse, RequestRejected, ZenostatError
from zenostat.topics.messages import Aggregation

MAX_CONNECTIONS = 32
_MAX_WAITING = 4 * MAX_CONNECTIONS
_FIRST_REQUEST_S = 30.0
_LOOK_S = 0.5  # how often the connection is looked at while the node simulates
_WORKING_S = 5.0
_MAX_REQUEST = 1 << 20


@dataclass(slots=True)
class Counts:
    """Counts of what FMUs have asked for."""

    connections: int = 0
    timesteps: int = 0
    failures: int = 0


class FmiGateway:
    """Serves one node, in threads of its own, for as long as its context lasts.

    Args:
        bus: an open bus, which the caller closes.
        node: name of the node; it need not be on the bus before an FMU connects.
        host, port: address to listen on; port 0 is any free one.
        priority: priority of all commands, 1 (highest) to 16.
        clients: which addresses may run FMUs: those that are allowed everything.
        notify: called with a line for the operator about each failed request, once.

    Raises:
        AddressInUse: another program listens there.

    Attributes:
        counts: what FMUs have asked for.
        address: `HOST:PORT` on which it listens.
    """

    def __init__(
        self,
        bus: Bus,
        node: str,
        host: str,
        port: int,
        *,
        priority: int = 10,
        clients: Clients = UNRESTRICTED,
        notify: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.bus, self.node, self.priority, self.clients = bus, node, priority, clients
        self.counts, self.notices = Counts(), Notices(notify)
        try:
            self._server = _Server((host, port), self)
        except OSError as error:
            raise AddressInUse(f"{join_address(host, port)}: {error.strerror}") from None
        self.address = join_address(host, self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, name="fmi-gateway", daemon=True)

    def __enter__(self) -> FmiGateway:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.close_connections()
        self._server.server_close()

    @property
    def description(self) -> str:
        """Node and address, for the first line."""
        safety = f"without encryption or password; {self.clients.description}"
        return f"node {self.node} for its FMUs on {self.address}, {safety}"


class _Server(ThreadingTCPServer):
    allow_reuse_address, daemon_threads = True, True

    def __init__(self, address: tuple[str, int], gateway: FmiGateway) -> None:
        self.address_family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self.gateway = gateway
        self.connections = set[_Connection]()
        super().__init__(address, _Connection)

    def close_connections(self) -> None:
        """End all connections."""
        for connection in [*self.connections]:
            connection.close()

    @override
    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Return whether a connection may wait for its first request; those beyond are closed at once."""
        return len(self.connections) < _MAX_WAITING


class _Connection(BaseRequestHandler):
    """An FMU that is connected."""

    server: _Server
    request: socket.socket

    @override
    def setup(self) -> None:
        self.gateway = self.server.gateway
        self._sending = threading.Lock()
        self._ended, self._is_busy = threading.Event(), False
        self._link: ControllerLink | None = None
        self._snapshots: dict[int, str] = {}
        self._answers: Mapping[Kind, Callable[[bytes], bytes]] = {
            Kind.STEP: self._step, Kind.SAVE: self._save, Kind.RESTORE: self._restore, Kind.DROP: self._drop,
        }  # fmt: skip
        connection = self.request
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        keep_alive(connection, idle_s=5, interval_s=5, probes=9)
        connection.settimeout(_FIRST_REQUEST_S)

    @override
    def handle(self) -> None:
        connections = self.server.connections
        connections.add(self)
        try:
            with suppress(OSError):  # the FMU has gone
                self._serve(is_one_too_many=len(connections) > MAX_CONNECTIONS)
        finally:
            connections.discard(self)
            self._ended.set()
            self._disconnect()

    def close(self) -> None:
        """End the connection; any thread may call it."""
        self._ended.set()
        with suppress(OSError):
            self.request.shutdown(socket.SHUT_RDWR)
        if self._link is not None:
            self._link.close()

    def _serve(self, *, is_one_too_many: bool) -> None:
        """Answer requests until the connection ends, or one has failed."""
        while not self._ended.is_set():
            try:
                request = read_request(self.request, _MAX_REQUEST)
                if request is None:
                    return
                if is_one_too_many:
                    raise RequestRejected(f"{MAX_CONNECTIONS} FMUs are connected already")
                answer = self._answer(*request)
            except (ZenostatError, MalformedRequest) as error:
                self.gateway.counts.failures += 1
                self.gateway.notices.add(f"{self.client_address[0]}: {error}")
                self._send(encode_failure(str(error)))
                return
            self._send(answer)

    def _answer(self, kind: Kind, content: bytes) -> bytes:
        if self._link is not None and kind in self._answers:
            self._is_busy = True
            return self._answers[kind](content)
        if self._link is not None or kind is not Kind.OPEN:
            raise MalformedRequest(f"a request {kind.name} at the wrong time")
        return self._open(content)

    def _send(self, message: bytes) -> None:
        with self._sending:
            self._is_busy = False
            self.request.sendall(message)

    def _watch(self) -> None:
        """Look at the connection while the node simulates: say that it does, and end with the FMU."""
        waited = 0.0
        while not self._ended.wait(_LOOK_S):
            waited = waited + _LOOK_S if self._is_busy else 0.0
            if not self._is_busy:
                continue
            try:
                with suppress(BlockingIOError):
                    if not self.request.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT):
                        raise ConnectionError
                if waited >= _WORKING_S:
                    waited = 0.0
                    with self._sending:
                        if self._is_busy:
                            self.request.sendall(encode(Kind.WORKING))
            except OSError:
                self.close()

    # Requests

    def _open(self, content: bytes) -> bytes:
        """Begin an episode."""
        gateway = self.gateway
        client = gateway.clients.of_fmi(self.client_address[0])
        gateway.clients.check(client, [EVERYTHING])
        self.request.settimeout(None)
        self._is_busy = True
        threading.Thread(target=self._watch, name="fmi-connection", daemon=True).start()
        interface = Interface(gateway.bus.manifest(gateway.node))
        _check(interface, content[4:].decode("ascii", "replace"))
        (seed,) = struct.unpack_from("<i", content)
        self._interface = interface
        self._divisors = np.array([output.divisor for output in interface.outputs])
        name = f"fmi.{client}" if client else "fmi"
        self._link = gateway.bus.controller(gateway.node, name=name, priority=gateway.priority)
        sample = self._link.reset(seed=None if seed < 0 else seed)
        gateway.counts.connections += 1
        return self._sample(sample, self._outputs(sample))

    def _step(self, content: bytes) -> bytes:
        """Simulate timesteps with the same commands; outputs are last values, means or sums of all of them."""
        link = self._linked
        actuators = self._interface.actuators
        if len(content) != 4 + 8 * len(actuators):
            raise MalformedRequest("a step with another number of actuators")
        (count,) = struct.unpack_from("<I", content)
        if not count:
            raise MalformedRequest("a step of no timesteps")
        values = np.frombuffer(content, "<f8", offset=4).tolist()
        commands = zip(actuators, values, strict=True)
        link.send({actuator.name: None if isnan(value) else value for actuator, value in commands})
        samples = [link.receive()]
        while len(samples) < count:
            if samples[-1].truncated:
                raise RequestRejected("the episode has ended")
            link.send()
            samples.append(link.receive())
        self.gateway.counts.timesteps += count
        rows = np.array([self._outputs(sample) for sample in samples])
        outputs = rows[-1]
        for index, output in enumerate(self._interface.outputs):
            if output.aggregation is not Aggregation.INSTANT:
                values = rows[:, index]
                outputs[index] = values.sum() if output.aggregation is Aggregation.SUM else values.mean()
        return self._sample(samples[-1], outputs)

    def _save(self, _: bytes) -> bytes:
        number = max(self._snapshots, default=0) + 1
        self._snapshots[number] = self.gateway.bus.snapshot(self.gateway.node, self._linked.name).snapshot
        return encode(Kind.SAVED, struct.pack("<I", number))

    def _restore(self, content: bytes) -> bytes:
        snapshot = self._snapshots.get(_number(content))
        if snapshot is None:
            raise MalformedRequest("a state that does not exist")
        sample = self._linked.reset(snapshot=snapshot)
        return self._sample(sample, self._outputs(sample))

    def _drop(self, content: bytes) -> bytes:
        if (snapshot := self._snapshots.pop(_number(content), None)) is not None:
            self.gateway.bus.drop(self.gateway.node, snapshot, self._linked.name)
        return encode(Kind.DROPPED)

    @property
    def _linked(self) -> ControllerLink:
        assert self._link is not None
        return self._link

    def _outputs(self, sample: SampleView) -> Floats:
        outputs: Floats = sample.values / self._divisors
        return outputs

    def _sample(self, sample: SampleView, outputs: Floats) -> bytes:
        flags = Flags.TRUNCATED if sample.truncated else 0
        return encode(Kind.SAMPLE, struct.pack("<II", flags, sample.step) + outputs.astype("<f8").tobytes())

    def _disconnect(self) -> None:
        link = self._link
        if link is None:
            return
        with suppress(ZenostatError):  # the node has ended
            for snapshot in self._snapshots.values():
                self.gateway.bus.drop(self.gateway.node, snapshot, link.name)
        link.close()


def _number(content: bytes) -> int:
    if len(content) != 4:
        raise MalformedRequest("a request without the number of a state")
    (number,) = struct.unpack("<I", content)
    return int(number)


def _check(interface: Interface, guid: str) -> None:
    """Raise `RequestRejected` unless an FMU fits a node."""
    manifest = interface.manifest
    if manifest.slots > 1:
        raise RequestRejected(f"node {manifest.node!r} has {manifest.slots} slots; an FMU is one building")
    if guid != interface.guid:
        raise RequestRejected(
            f"the points or timesteps of node {manifest.node!r} are others than those of this FMU; write it again: "
            f"zenostat gateway fmi {manifest.node} --fmu {manifest.node}.fmu"
        )
