"""Start and close several engines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from zenostat.bridge.engine.client import EngineClient

T = TypeVar("T")


def start_all(items: Iterable[T], start: Callable[[T], EngineClient]) -> list[EngineClient]:
    """Start an engine for each item; if one cannot be started, close those started so far."""
    started: list[EngineClient] = []
    try:
        for item in items:
            started.append(start(item))  # noqa: PERF401  # a comprehension would lose those started so far
    except BaseException:
        for client in started:
            client.close()
        raise
    return started


def close_all(clients: Sequence[EngineClient]) -> None:
    """Kill engines that have nothing to finish, then close all of them: processes take a while to end."""
    for client in clients:
        if not client.spec.keep_output and not client.order_close():
            client.interrupt()
    for client in clients:
        client.close()
