"""Commands of a gateway, which it relinquishes when it ends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, TypeVar

from zenostat.bridge.client.priorities import PriorityValue, decode_priorities
from zenostat.topics import keys
from zenostat.topics.errors import RequestRejected, UsageError
from zenostat.topics.keys import is_own
from zenostat.topics.messages import Ack, Manifest, Message, PriorityArrays, Query, State, Status, Write
from zenostat.topics.messages.base import ANONYMOUS

M = TypeVar("M", bound=Message)

MAX_SOURCES = 1000
"""Largest number of sources that are noted for an actuator at a priority."""


class Ask(Protocol):
    """Sends a request to a node; see `NodeClient.ask`."""

    async def __call__(self, topic: keys.Topic, request: Message, reply_type: type[M], *, name: str = "") -> M:
        """Return the node's reply."""


class WrittenCommand(NamedTuple):
    """A command of one actuator at one priority, and its source."""

    actuator: str
    priority: int
    source: str


@dataclass(slots=True)
class Relinquished:
    """Outcome of relinquishing the commands of a gateway.

    Attributes:
        count: number of commands that are relinquished.
        rejected: the commands that remain in force, with the node's reasons.
    """

    count: int = 0
    rejected: dict[WrittenCommand, str] = field(default_factory=dict)


class WrittenCommands:
    """The commands of a gateway: those of its source and of sources below it, and those that it sent under other names.

    The former include what an earlier process of the gateway has left, since only one gateway of a node has a source.
    Of the latter, the latest `MAX_SOURCES` sources of each actuator and priority are known. A command that has been
    relinquished or replaced stays among them, since a return to a snapshot brings it back.

    Args:
        source: the gateway's name among the sources.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._others: dict[tuple[str, int], dict[str, None]] = {}

    @contextmanager
    def sending(self, actuator: str, priority: int, source: str) -> Iterator[None]:
        """Note a command that the context sends under another name, unless the node rejects it."""
        name = source or ANONYMOUS
        if is_own(self._source, name):
            yield
            return
        sources = self._others.setdefault((actuator, priority), {})
        is_new = name not in sources
        sources[name] = sources.pop(name, None)  # the latest is the last
        try:
            yield
        except (UsageError, RequestRejected):
            if is_new:
                sources.pop(name, None)
            raise
        if len(sources) > MAX_SOURCES:
            del sources[next(iter(sources))]

    async def relinquish(self, ask: Ask, manifest: Manifest) -> Relinquished:
        """Relinquish the commands that are still in force; see `NodeClient.relinquish_written`.

        A command whose relinquishment the node rejects does not keep the others in force. Once the episode is over,
        there is nothing to relinquish: no command has an effect, and the next episode begins without commands.
        """
        done = Relinquished()
        arrays = await ask(keys.PRIORITIES, Query(), PriorityArrays)
        decoded = [decode_priorities(arrays, manifest, slot) for slot in range(manifest.slots)]
        for command in sorted({command for array in decoded for command in self.remaining(array)}):
            actuator, priority, source = command
            try:
                await ask(keys.WRITE_REQUEST, Write(value=None, priority=priority, source=source), Ack, name=actuator)
            except RequestRejected as error:
                done.rejected[command] = str(error)
            else:
                done.count += 1
        if done.rejected and (await ask(keys.STATUS, Query(), Status)).state in (State.ENDED, State.FAILED):
            done.rejected.clear()
        return done

    def remaining(self, arrays: Mapping[str, Sequence[PriorityValue]]) -> list[WrittenCommand]:
        """Return the commands that are in priority arrays, with the source by which they were written."""
        return [
            WrittenCommand(actuator, priority, entry.source)
            for actuator, entries in arrays.items()
            for priority, entry in enumerate(entries, 1)
            if entry.source
            and (is_own(self._source, entry.source) or entry.source in self._others.get((actuator, priority), ()))
        ]
