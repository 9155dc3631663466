"""BACnet/IP on one network interface: its address, its sockets, and the way of datagrams to bacpypes3."""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import socket
from typing import Any, NamedTuple

import psutil
from bacpypes3.comm import Server, bind
from bacpypes3.ipv4.bvll import BVLLCodec
from bacpypes3.ipv4.service import BIPNormal, UDPMultiplexer
from bacpypes3.pdu import PDU, Address, IPv4Address, LocalBroadcast

from zenostat.gateways.bacnet.counts import BacnetCounts
from zenostat.topics.errors import AddressInUse, InvalidConfig

DEFAULT_PORT = 47808
"""UDP port of BACnet/IP, 0xBAC0."""

_RECEIVE_BUFFER = 1 << 20  # bytes; many clients may ask at once

_LOOPBACK_MASK = "255.0.0.0"


class Interface(NamedTuple):
    """An address of a network interface of this machine; `name` is empty for further addresses of the loopback."""

    name: str
    address: ipaddress.IPv4Interface
    port: int

    @property
    def broadcast(self) -> str | None:
        """Broadcast address of its network; None for a network of one address."""
        network = self.address.network
        return None if network.prefixlen >= 31 else str(network.broadcast_address)

    @property
    def bacnet_address(self) -> IPv4Address:
        """The address with netmask and port."""
        return IPv4Address(f"{self.address.with_prefixlen}:{self.port}")


def find_interface(host: str, port: int) -> Interface:
    """Return the interface that has an IPv4 address.

    Raises:
        InvalidConfig: no interface has it, or it stands for all interfaces; port 0.
    """
    address = ipaddress.ip_address(host)
    if address.version != 4:
        raise InvalidConfig(f"{host} is an IPv6 address; BACnet/IP needs an IPv4 address, for example 127.0.0.1")
    if port == 0:
        raise InvalidConfig(f"port 0 is not possible: BACnet clients need to know the port, for example {DEFAULT_PORT}")
    available = {
        entry.address: (name, entry.netmask or "255.255.255.255")
        for name, entries in sorted(psutil.net_if_addrs().items())
        for entry in entries
        if entry.family == socket.AF_INET
    }
    name, mask = available.get(host, ("", _LOOPBACK_MASK if address.is_loopback else ""))
    if not mask:
        known = ", ".join(f"{address} ({name})" for address, (name, _) in available.items())
        raise InvalidConfig(f"{host} is not the address of one network interface of this machine; it has: {known}")
    return Interface(name, ipaddress.IPv4Interface(f"{host}/{mask}"), port)


def host_and_port(address: Address) -> tuple[str, int]:
    """Return IPv4 address and UDP port of a BACnet address of six octets."""
    octets = address.addrAddr
    return socket.inet_ntoa(octets[:4]), int.from_bytes(octets[4:6], "big")


class _Receiver(asyncio.DatagramProtocol):
    """Hands received datagrams on, each in a task of its own."""

    def __init__(self, server: DatagramServer, destination: Any) -> None:
        self._server, self._destination = server, destination

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._server.receive(PDU(data, source=IPv4Address(addr), destination=self._destination))


class DatagramServer(Server):
    """The lowest layer of bacpypes3's stack: the sockets of one interface.

    bacpypes3's own retries for ever if an address is in use, and shares the port with other programs, so that each
    would get some of the datagrams.
    """

    def __init__(self, interface: Interface, counts: BacnetCounts) -> None:
        super().__init__()
        self._interface, self._counts = interface, counts
        self._own = (str(interface.address.ip), interface.port)
        self._transports: list[asyncio.DatagramTransport] = []
        self._tasks: set[asyncio.Task[None]] = set()

    async def open(self) -> None:
        """Open the sockets.

        Raises:
            AddressInUse: another program uses the address.
        """
        host, port = self._own
        destination = self._interface.bacnet_address
        await self._listen(_bound(host, port, shared=False), destination)
        if self._interface.broadcast is not None:
            await self._listen(_bound(self._interface.broadcast, port, shared=True), LocalBroadcast())

    async def _listen(self, bound: socket.socket, destination: Any) -> None:
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(lambda: _Receiver(self, destination), sock=bound)
        self._transports.append(transport)

    def close(self) -> None:
        """Close the sockets; idempotent."""
        for transport in self._transports:
            transport.close()
        for task in [*self._tasks]:
            task.cancel()

    def receive(self, pdu: PDU) -> None:
        """Process a datagram in a task."""
        self._counts.datagrams += 1
        if pdu.pduSource.addrTuple == self._own:
            return  # our own broadcast
        task = asyncio.get_running_loop().create_task(self._process(pdu))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _process(self, pdu: PDU) -> None:
        try:
            if pdu.pduData[:1] != b"\x81":
                raise ValueError("not a message of BACnet/IP")
            await self.response(pdu)
        except asyncio.CancelledError:
            raise
        except BaseException as error:  # bacpypes3 raises PDUs, which are no Exceptions
            if isinstance(error, (SystemExit, KeyboardInterrupt)):
                raise
            self._counts.malformed += 1

    async def indication(self, pdu: PDU) -> None:
        """Send a datagram; bacpypes3 calls it."""
        if isinstance(pdu.pduDestination, LocalBroadcast):
            if self._interface.broadcast is None:
                return
            destination = (self._interface.broadcast, self._interface.port)
        else:
            destination = host_and_port(pdu.pduDestination)
        self._transports[0].sendto(pdu.pduData, destination)


class NodeLink(BIPNormal):
    """BACnet/IP without BBMD functions, on one interface."""

    def __init__(self, interface: Interface, counts: BacnetCounts) -> None:
        super().__init__()
        self._codec, self._multiplexer = BVLLCodec(), UDPMultiplexer()
        self.server = DatagramServer(interface, counts)
        bind(self, self._codec, self._multiplexer.annexJ)
        bind(self._multiplexer, self.server)


def _bound(host: str, port: int, *, shared: bool) -> socket.socket:
    """Return a socket that can send broadcasts; a shared one lets other programs receive the same broadcasts."""
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
    if shared:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
    try:
        bound.bind((host, port))
    except OSError as error:
        bound.close()
        if error.errno == errno.EADDRINUSE:
            raise AddressInUse(
                f"another program uses UDP port {port} of {host}; stop it, or choose another port with --address"
            ) from None
        raise InvalidConfig(f"cannot listen on UDP port {port} of {host}: {error.strerror}") from None
    return bound
