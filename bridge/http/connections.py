"""Connections of an HTTP server that occupy no place for longer than they need it.

uvicorn waits for requests without a limit and answers 503 once it has too many connections, so silent ones would shut
out everybody else.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol


class BoundedConnection:
    """Mixin for a protocol of uvicorn: it ends without a complete request, and gives way to others before it has one.

    Attributes:
        request_timeout_s: time in which a request has to be complete.
        opened_at: time of the connection, in seconds of the event loop.
    """

    request_timeout_s = 60.0

    # Of uvicorn's protocols:
    loop: asyncio.AbstractEventLoop
    transport: Any
    connections: set[Any]
    limit_concurrency: int | None
    cycle: Any

    _deadline: asyncio.TimerHandle | None = None
    _complete: Any = None
    opened_at = 0.0

    def connection_made(self, transport: Any) -> None:
        """Close the oldest idle connection if there are too many."""
        super().connection_made(transport)  # type: ignore[misc]
        self.opened_at = self.loop.time()
        self._expect_request()
        if self.limit_concurrency is not None and len(self.connections) >= self.limit_concurrency:
            idle = [other for other in self.connections if other is not self and other.is_idle]
            if idle:
                min(idle, key=lambda other: other.opened_at).give_way()

    def data_received(self, data: bytes) -> None:
        """Wait for the rest of the request, if this is not its end."""
        self._expect_request()
        super().data_received(data)  # type: ignore[misc]
        if self.cycle is not None and self.cycle is not self._complete and not self.cycle.more_body:
            self._complete = self.cycle
            self._cancel_deadline()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._cancel_deadline()
        super().connection_lost(exc)  # type: ignore[misc]

    @property
    def is_idle(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def give_way(self) -> None:
        """Close the connection; its place is free at once."""
        self.connections.discard(self)
        self.transport.close()

    def _expect_request(self) -> None:
        if self._deadline is None:
            self._deadline = self.loop.call_later(self.request_timeout_s, self._end_unless_answering)

    def _cancel_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _end_unless_answering(self) -> None:
        self._deadline = None
        if self.is_idle or self.cycle.more_body:
            self.transport.close()


class BoundedH11(BoundedConnection, H11Protocol):
    """Such a connection, with the parser that each installation of uvicorn has."""
