"""HTTP servers, by default for this machine: their sockets, and uvicorn in a process that handles signals itself."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Self

import uvicorn

from zenostat.bridge.http.connections import BoundedH11
from zenostat.bridge.runtime import service_manager
from zenostat.topics.addresses import is_loopback
from zenostat.topics.errors import AddressInUse, InvalidConfig

_BACKLOG = 256
_MAX_CONNECTIONS = 512
_SHUTDOWN_S = 3


def listen(address: str, default: str, program: str, *, is_exposed: bool = False, remedy: str = "") -> socket.socket:
    """Return a socket that listens on the loopback interface; on any other one if it is exposed.

    Args:
        address: `HOST:PORT`; port 0 chooses a free one.
        default: the address that errors name.
        program: name of the program that listens, for errors.
        is_exposed: whether other machines may reach the address.
        remedy: what the error of an address that they reach also recommends.

    Raises:
        InvalidConfig: a malformed address, or one that other machines can reach, unless it is exposed.
        AddressInUse: another program listens there.
    """
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise InvalidConfig(f"address {address!r}: HOST:PORT expected, such as {default}")
    try:
        family, _, _, _, target = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no valid host name"
        raise InvalidConfig(f"address {address!r}: {reason}") from None
    if not is_exposed and not is_loopback(str(target[0])):
        raise InvalidConfig(
            f"{address} can be reached from other machines, and {program} serves this machine only; listen on "
            f"{default} and forward the port: ssh -L {default.rpartition(':')[2]}:{default} HOST"
            f"{remedy and f'; {remedy}'}"
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


def host_and_port(listening: socket.socket) -> tuple[str, int]:
    """Return the host of a socket as URLs have it, and its port."""
    host, port = listening.getsockname()[:2]
    return f"[{host}]" if ":" in host else host, port


class LoopbackServer(uvicorn.Server):
    """A server of an ASGI application in a process that handles signals itself.

    Args:
        app: the application.
        end_streams: called before the server waits for requests to end; what it returns is awaited.
        settings: further settings of uvicorn, such as those of TLS.
    """

    def __init__(
        self, app: Any, end_streams: Callable[[], Awaitable[None] | None] = lambda: None, **settings: Any
    ) -> None:
        defaults = {
            "http": BoundedH11,
            "ws": "none",
            "lifespan": "on",
            "log_level": "error",
            "access_log": False,
            "proxy_headers": False,
            "server_header": False,
            "backlog": _BACKLOG,
            "limit_concurrency": _MAX_CONNECTIONS,
            "timeout_graceful_shutdown": _SHUTDOWN_S,
        }
        super().__init__(uvicorn.Config(app, **{**defaults, **settings}))
        self._end_streams = end_streams
        self._reported = ExitStack()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and report to the service manager."""
        await super().startup(sockets)
        loop = asyncio.get_running_loop()
        self._reported.enter_context(service_manager.reported(loop.call_soon_threadsafe))

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams, then wait for requests to end."""
        self._reported.close()
        if (pending := self._end_streams()) is not None:
            await pending
        await super().shutdown(sockets)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals to the process."""
        yield


class HttpServer:
    """A listening socket, and the server that runs on it.

    Args:
        listening: the socket; the end of the context closes it.
        url: of what is served.
        server: the server.

    Attributes:
        url: of what is served.
    """

    def __init__(self, listening: socket.socket, url: str, server: LoopbackServer) -> None:
        self.url = url
        self._socket, self._server = listening, server

    def run(self) -> None:
        """Serve until `stop` is called."""
        self._server.run(sockets=[self._socket])

    def stop(self) -> None:
        """End `run`; from any thread or signal handler."""
        self._server.should_exit = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
