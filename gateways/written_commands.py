"""Commands that a gateway has written for its clients, which it relinquishes when it ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from zenostat.bridge.client.priorities import PriorityValue
from zenostat.topics.messages.base import ANONYMOUS


class WrittenCommand(NamedTuple):
    """A command of one actuator at one priority, and its source."""

    actuator: str
    priority: int
    source: str


class WrittenCommands:
    """The sources of the latest commands, by actuator and priority."""

    def __init__(self) -> None:
        self._sources: dict[tuple[str, int], str] = {}

    def __bool__(self) -> bool:
        return bool(self._sources)

    def add(self, actuator: str, priority: int, source: str) -> None:
        """Note a command, before it is sent: without a reply, it may have been accepted nevertheless."""
        self._sources[actuator, priority] = source or ANONYMOUS

    def remove(self, actuator: str, priority: int) -> None:
        """Forget a command that has been relinquished."""
        self._sources.pop((actuator, priority), None)

    def remaining(self, arrays: Mapping[str, Sequence[PriorityValue]]) -> list[WrittenCommand]:
        """Return the commands that are still in priority arrays, with the source by which they were written."""
        return [
            WrittenCommand(actuator, priority, source)
            for (actuator, priority), source in self._sources.items()
            if actuator in arrays and arrays[actuator][priority - 1].source == source
        ]
