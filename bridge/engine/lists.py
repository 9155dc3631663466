"""Start and close several engines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol, TypeVar

from zenostat.bridge.engine.spec import EngineSpec


class Engine(Protocol):
    """Interface of an `EngineClient` to end its engine."""

    @property
    def spec(self) -> EngineSpec:
        """Settings of its simulation."""

    def order_close(self) -> bool:
        """Order the engine to end; return whether it has something to finish."""

    def interrupt(self, reason: str = ...) -> None:
        """End it at once."""

    def close(self) -> None:
        """Wait until it has ended; idempotent."""


T = TypeVar("T")
E = TypeVar("E", bound=Engine)


def start_all(items: Iterable[T], start: Callable[[T], E]) -> list[E]:
    """Start an engine for each item; if one cannot be started, close those started so far."""
    started: list[E] = []
    try:
        for item in items:
            started.append(start(item))  # noqa: PERF401  # a comprehension would lose those started so far
    except BaseException:
        close_all(started)
        raise
    return started


def close_all(clients: Sequence[Engine]) -> None:
    """Kill engines that have nothing to finish, then close all of them: processes take a while to end."""
    for client in clients:
        if not client.spec.keep_output and not client.order_close():
            client.interrupt()
    for client in clients:
        client.close()
