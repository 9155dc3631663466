"""Commands of a gateway, which it relinquishes when it ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, TypeVar

from zenostat.bridge.client.priorities import PriorityValue, decode_priorities
from zenostat.topics import keys
from zenostat.topics.errors import RequestRejected
from zenostat.topics.keys import is_own
from zenostat.topics.messages import Ack, Manifest, Message, PriorityArrays, Query, State, Status, Write

M = TypeVar("M", bound=Message)


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


async def relinquish(ask: Ask, manifest: Manifest, source: str) -> Relinquished:
    """Relinquish the commands of a gateway that are in force, also those of an earlier process of it.

    A command whose relinquishment the node rejects does not keep the others in force. Once the episode is over, there
    is nothing to relinquish: no command has an effect, and the next episode begins without commands.

    Args:
        ask: sends requests to the node.
        manifest: of the node.
        source: the gateway's name among the sources, which one gateway of a node has.
    """
    done = Relinquished()
    arrays = await ask(keys.PRIORITIES, Query(), PriorityArrays)
    decoded = [decode_priorities(arrays, manifest, slot) for slot in range(manifest.slots)]
    for command in sorted({command for array in decoded for command in written_commands(array, source)}):
        write = Write(value=None, priority=command.priority, source=command.source)
        try:
            await ask(keys.WRITE_REQUEST, write, Ack, name=command.actuator)
        except RequestRejected as error:
            done.rejected[command] = str(error)
        else:
            done.count += 1
    if done.rejected and (await ask(keys.STATUS, Query(), Status)).state in (State.ENDED, State.FAILED):
        done.rejected.clear()
    return done


def written_commands(arrays: Mapping[str, Sequence[PriorityValue]], source: str) -> list[WrittenCommand]:
    """Return the commands of a source and of those below it that are in priority arrays."""
    return [
        WrittenCommand(actuator, priority, entry.source)
        for actuator, entries in arrays.items()
        for priority, entry in enumerate(entries, 1)
        if entry.source and is_own(source, entry.source)
    ]
