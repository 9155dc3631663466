"""The HTTP server of the control room."""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import TracebackType

import uvicorn

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.runtime import service_manager
from zenostat.topics.errors import AddressInUse, InvalidConfig
from zenostat.views.room.access import Access
from zenostat.views.room.app import DEFAULTS, Room, RoomSettings

DEFAULT_ADDRESS = "127.0.0.1:8600"

_BACKLOG = 256
_MAX_CONNECTIONS = 512
_SHUTDOWN_S = 3
_REQUEST_S = 30.0


class RoomServer:
    """A listening socket on the loopback interface, and the control room on it.

    Args:
        bus: connection to the bus; the caller closes it after this.
        address: `HOST:PORT`; port 0 chooses a free one.
        operator: name of the user of the first link, the source of this user's changes.
        api_token: token of programs that read metrics and histories; None closes these.
        settings: what pages may do besides operating nodes.

    Attributes:
        url: of the page.
        link: address that signs one browser in.

    Raises:
        InvalidConfig: a malformed address, or one that other machines can reach.
        AddressInUse: another program listens there.
    """

    def __init__(
        self,
        bus: Bus,
        address: str,
        *,
        operator: str,
        api_token: str | None = None,
        settings: RoomSettings = DEFAULTS,
    ) -> None:
        bus.timeout_s = _REQUEST_S
        self._socket = _listen(address)
        host, port = self._socket.getsockname()[:2]
        host = f"[{host}]" if ":" in host else host
        self.url = f"http://{host}:{port}"
        hosts = frozenset({f"{host}:{port}", f"localhost:{port}"})
        self.room = Room(bus, Access(hosts, f"zenostat-room-{port}", api_token=api_token), self.url, settings)
        self.link = self.room.link(operator)
        config = uvicorn.Config(
            self.room.asgi,
            log_level="error",
            access_log=False,
            proxy_headers=False,
            server_header=False,
            backlog=_BACKLOG,
            limit_concurrency=_MAX_CONNECTIONS,
            timeout_graceful_shutdown=_SHUTDOWN_S,
            ws="none",
            lifespan="on",
        )
        self._server = _Server(config, self.room)

    def run(self) -> None:
        """Serve until `stop` is called."""
        self._server.run(sockets=[self._socket])

    def stop(self) -> None:
        """End `run`; from any thread or signal handler."""
        self._server.should_exit = True

    def __enter__(self) -> RoomServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()


class _Server(uvicorn.Server):
    """A server whose process handles signals itself, and which ends the streams before it waits for requests."""

    def __init__(self, config: uvicorn.Config, room: Room) -> None:
        super().__init__(config)
        self._room = room
        self._reported = ExitStack()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        loop = asyncio.get_running_loop()
        self._reported.enter_context(service_manager.reported(loop.call_soon_threadsafe))

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._reported.close()
        self._room.updates.close()
        await super().shutdown(sockets)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def _listen(address: str) -> socket.socket:
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise InvalidConfig(f"address {address!r}: HOST:PORT expected, such as {DEFAULT_ADDRESS}")
    try:
        family, _, _, _, target = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise InvalidConfig(f"address {address!r}: {error.strerror}") from None
    if not ipaddress.ip_address(str(target[0]).partition("%")[0]).is_loopback:
        raise InvalidConfig(
            f"{address} can be reached from other machines, and the control room serves this machine only; listen on "
            f"{DEFAULT_ADDRESS} and forward the port: ssh -L 8600:{DEFAULT_ADDRESS} HOST"
        )
    # asyncio sets TCP_NODELAY only on sockets whose protocol is named.
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind(target)
        listening.listen(_BACKLOG)
    except OSError as error:
        listening.close()
        if error.errno == errno.EADDRINUSE:
            raise AddressInUse(f"another program listens on {address}; name another port with --address") from None
        raise InvalidConfig(f"{address}: {error.strerror}; name an address of this machine and a port") from None
    return listening
