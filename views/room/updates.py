"""Changes for all open pages: the latest message of each topic, as server-sent events."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable, Iterable
from contextlib import suppress

_KEEP_ALIVE_S = 5.0
"""Time after which an event `alive` is sent if nothing else was: a page that receives nothing is not connected."""
_ALIVE = "alive"

MAX_STREAMS = 200
"""Largest number of pages that follow at a time."""


class Updates:
    """The latest message of each topic; `publish` and `remove` are thread-safe, all else is for the loop's thread.

    A page that is slow misses messages, since a newer one replaces one that is not sent yet: neither memory nor other
    pages depend on it.

    Args:
        clock: time in seconds, which is the id of each event; see `Access.outdated`.
    """

    def __init__(self, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self._latest: dict[str, bytes] = {}
        self._streams: set[_Stream] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_closed = False

    @property
    def followers(self) -> int:
        """Number of pages that follow."""
        return len(self._streams)

    def start(self) -> None:
        """Belong to the running loop from now on."""
        self._loop = asyncio.get_running_loop()

    def publish(self, topic: str, message: bytes) -> None:
        """Replace the latest message of a topic, JSON without line breaks."""
        self._in_loop(self._set, topic, message)

    def remove(self, topics: Iterable[str]) -> None:
        """Forget the latest messages of some topics; thread-safe."""
        for topic in topics:
            self._in_loop(self._latest.pop, topic, None)

    def _in_loop(self, function: Callable[..., object], *arguments: object) -> None:
        """Call a function in the loop's thread, or at once before there is a loop."""
        if self._loop is None:
            function(*arguments)
            return
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function, *arguments)

    def _set(self, topic: str, message: bytes) -> None:
        self._latest[topic] = message
        for stream in self._streams:
            stream.add(topic, message)

    def close(self) -> None:
        """End all streams."""
        self._is_closed = True
        for stream in self._streams:
            stream.wake.set()

    async def follow(self, topics: Iterable[str]) -> AsyncGenerator[bytes, None]:
        """Yield server-sent events of some topics: first their latest messages, then each change.

        There is one at once and then at least every 5 s: `alive` if there is nothing else.
        """
        stream = _Stream(frozenset(topics))
        for topic in sorted(stream.topics & self._latest.keys()):
            stream.add(topic, self._latest[topic])
        self._streams.add(stream)
        try:
            yield b"retry: 1000\n\n"
            while not self._is_closed:
                stream.wake.clear()
                pending, stream.pending = stream.pending, {}
                for topic, message in (pending or {_ALIVE: b"{}"}).items():
                    kind = topic.partition(":")[0]
                    yield b"id: %.3f\nevent: %s\ndata: %s\n\n" % (self._clock(), kind.encode(), message)
                with suppress(TimeoutError):
                    async with asyncio.timeout(_KEEP_ALIVE_S):
                        await stream.wake.wait()
        finally:
            self._streams.discard(stream)


class _Stream:
    """Messages that one page has not received yet, at most one of each topic."""

    def __init__(self, topics: frozenset[str]) -> None:
        self.topics = topics
        self.pending: dict[str, bytes] = {}
        self.wake = asyncio.Event()

    def add(self, topic: str, message: bytes) -> None:
        if topic in self.topics:
            self.pending[topic] = message
            self.wake.set()
