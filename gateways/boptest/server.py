"""The HTTP server of the gateway."""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import TracebackType
from typing import Any, cast

import uvicorn
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from zenostat.bridge.runtime.service_manager import reported
from zenostat.gateways.addresses import is_loopback
from zenostat.gateways.boptest.app import Service
from zenostat.topics.errors import AddressInUse, InvalidConfig

_BACKLOG = 256
_MAX_CONNECTIONS = 512
_SHUTDOWN_S = 5

REQUEST_TIMEOUT_S = 10.0
"""Time after which a connection without a complete request is closed, since it occupies one of those permitted."""


class HttpServer:
    """A listening socket, and the server that runs on it.

    Args:
        service: what it serves.
        address: `HOST:PORT`; port 0 chooses a free one.
        expose: allow an address that other machines reach.

    Attributes:
        url: of the service.

    Raises:
        InvalidConfig: malformed address, or one beyond loopback without `expose`.
        AddressInUse: another program listens there.
    """

    def __init__(self, service: Service, address: str, *, expose: bool = False) -> None:
        self.service = service
        self._socket = _listen(address, expose=expose)
        host, port = self._socket.getsockname()[:2]
        service.is_local = is_loopback(host)
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{port}"
        config = uvicorn.Config(
            service,
            http=_Protocol,
            log_level="error",
            access_log=False,
            proxy_headers=False,
            backlog=_BACKLOG,
            limit_concurrency=_MAX_CONNECTIONS,
            timeout_graceful_shutdown=_SHUTDOWN_S,
            ws="none",
            lifespan="off",
        )
        self._server = _Server(config, service)

    def run(self) -> None:
        """Serve until `stop` is called."""
        self._server.run(sockets=[self._socket])

    def stop(self) -> None:
        """End `run`; from any thread or signal handler."""
        self._server.should_exit = True

    def __enter__(self) -> HttpServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()
        self.service.close()


class _Server(uvicorn.Server):
    """A server whose process handles signals itself, and which ends simulations before it waits for requests."""

    def __init__(self, config: uvicorn.Config, service: Service) -> None:
        super().__init__(config)
        self._service = service
        self._reported = ExitStack()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._reported.enter_context(reported(asyncio.get_running_loop().call_soon_threadsafe))

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._reported.close()
        await asyncio.to_thread(self._service.manager.interrupt)
        await super().shutdown(sockets)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


class _Protocol(HttpToolsProtocol):
    """A connection that is closed unless complete requests arrive, and whose answers are sent in one piece each.

    uvicorn waits for requests without a limit, and writes heads and bodies of answers separately.
    """

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(cast("asyncio.Transport", _JoinedWrites(transport, self.loop)))
        self._expect_request()

    def data_received(self, data: bytes) -> None:
        self._expect_request()
        super().data_received(data)

    def on_message_complete(self) -> None:
        self._cancel_deadline()
        super().on_message_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        self._cancel_deadline()
        super().connection_lost(exc)

    def _expect_request(self) -> None:
        if self._deadline is None:
            self._deadline = self.loop.call_later(REQUEST_TIMEOUT_S, self._end_unless_answering)

    def _cancel_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _end_unless_answering(self) -> None:
        self._deadline = None
        if self.cycle is None or self.cycle.response_complete or self.cycle.more_body:
            self.transport.close()


class _JoinedWrites:
    """A transport that sends what is written in one pass of the loop together; else that transport."""

    def __init__(self, transport: Any, loop: asyncio.AbstractEventLoop) -> None:
        self._transport, self._loop = transport, loop
        self._chunks: list[bytes] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        if not self._chunks:
            self._loop.call_soon(self._flush)
        self._chunks.append(data)

    def _flush(self) -> None:
        chunks, self._chunks = self._chunks, []
        if chunks:
            self._transport.write(b"".join(chunks))

    def close(self) -> None:
        self._flush()
        self._transport.close()


def _listen(address: str, *, expose: bool) -> socket.socket:
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise InvalidConfig(f"address {address!r}: HOST:PORT expected, such as 127.0.0.1:8000")
    try:
        family, _, _, _, target = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no valid host name"
        raise InvalidConfig(f"address {address!r}: {reason}") from None
    if not expose and not ipaddress.ip_address(str(target[0]).partition("%")[0]).is_loopback:
        raise InvalidConfig(
            f"{address} can be reached from other machines, and this interface has no authentication; pass --expose to "
            "allow it"
        )
    # asyncio sets TCP_NODELAY only on sockets whose protocol is named; without it, each answer takes 40 ms.
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind(target)
        listening.listen(_BACKLOG)  # clients that connect before `run` wait
    except OSError as error:
        listening.close()
        if error.errno == errno.EADDRINUSE:
            raise AddressInUse(f"another program listens on {address}; name another port") from None
        raise InvalidConfig(f"{address}: {error.strerror}; name an address of this machine and a port") from None
    return listening
