"""The HTTP server of the gateway."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from zenostat.bridge.http.connections import BoundedConnection
from zenostat.bridge.http.server import HttpServer, LoopbackServer, host_and_port, listen
from zenostat.gateways.boptest.app import Service
from zenostat.topics.addresses import is_loopback

_DEFAULT_ADDRESS = "127.0.0.1:8000"
_SHUTDOWN_S = 5
_IDLE_S = 900
"""Time after which a connection between two requests ends: clients compute, and cannot know whether a lost request
has advanced the building."""


class BoptestServer(HttpServer):
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
        listening = listen(
            address,
            _DEFAULT_ADDRESS,
            "the gateway",
            is_exposed=expose,
            remedy="or pass --expose to allow it, without authentication",
        )
        host, port = host_and_port(listening)
        service.is_local = is_loopback(host)
        server = LoopbackServer(
            service,
            lambda: asyncio.to_thread(service.manager.interrupt),
            http=_Protocol,
            lifespan="off",
            server_header=True,
            timeout_graceful_shutdown=_SHUTDOWN_S,
            timeout_keep_alive=_IDLE_S,
        )
        super().__init__(listening, f"http://{host}:{port}", server)

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self.service.close()


class _Protocol(BoundedConnection, HttpToolsProtocol):
    """A bounded connection whose answers are sent in one piece each; uvicorn writes heads and bodies separately."""

    request_timeout_s = 10.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(_JoinedWrites(transport, self.loop))


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
