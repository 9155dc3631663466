"""What the gateway knows of a node and of those who control it through it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from topics.messages import Command, ControllerStatus, Event, EventKind, Manifest, Mode, Status

REFUSALS = (EventKind.REJECTED, EventKind.LATE, EventKind.DUPLICATE)
_CHANGES = (EventKind.CONNECTED, EventKind.DISCONNECTED, EventKind.STARTED, EventKind.PACE)


@dataclass(slots=True, eq=False)
class Owner:
    """A controller that claimed through the gateway.

    Attributes:
        route, fd: its connection.
        required: as it claimed.
        leave: drops its token of presence.
        accepted: how many of its commands the node took, as its status said and counted on from there.
        answered: (slot, episode, step) that its latest command answered.
    """

    name: str
    route: bytes
    fd: int
    required: bool
    leave: Callable[[], None]
    accepted: int | None = None
    answered: frozenset[tuple[int, int, int]] = frozenset()


@dataclass(slots=True, eq=False)
class NodeView:
    """A node.

    Attributes:
        waits: whether it goes on only once all required controllers have answered: lockstep without a deadline.
        instances: its tokens of presence that are there.
        latest: topic to frames, of its manifest and its latest sample.
        owners: the controllers of this gateway.
        required: names of the controllers that it waits for; None when that may have changed, or it is paused.
        heard: samples and events that came from it.
        told: refusals among the events.
        silent: refusals that it counted and told nobody of (it tells only so many a step); None when unsure.
        refusing: whether it told of a refusal since its latest sample.
        failure: the event of its failure.
        stopped: whether it said that it ends.
        episode, step: of its latest event or sample.
    """

    name: str
    waits: bool = False
    instances: set[str] = field(default_factory=set)
    latest: dict[bytes, list[bytes]] = field(default_factory=dict)
    owners: dict[str, Owner] = field(default_factory=dict)
    required: set[str] | None = None
    heard: int = 0
    told: int = 0
    silent: int | None = None
    refusing: bool = False
    failure: Event | None = None
    stopped: bool = False

    def note_manifest(self, manifest: Manifest) -> None:
        """A manifest came."""
        self.waits = manifest.mode is Mode.LOCKSTEP and manifest.deadline_s is None

    def note_sample(self) -> None:
        """A sample came."""
        self.heard += 1
        if self.refusing:
            self.refusing, self.silent = False, None

    def note_event(self, event: Event) -> None:
        """An event came."""
        self.heard += 1
        if event.kind in REFUSALS:
            self.told += 1
            self.refusing = True
        elif event.kind in _CHANGES:
            self.required = None
            if event.kind is EventKind.STARTED:
                self.failure = None
        elif event.kind is EventKind.FAILED:
            self.failure = event
        elif event.kind is EventKind.STOPPED:
            self.stopped = True

    def note_status(self, status: Status, owner: Owner) -> ControllerStatus | None:
        """Who is waited for; returns what the status says of one controller."""
        self.required = None if status.paused else {c.controller for c in status.controllers if c.required}
        return next((c for c in status.controllers if c.controller == owner.name), None)

    def waits_only_for(self, owner: Owner) -> bool:
        """Whether the next sample comes as soon as this controller's command is taken."""
        return self.waits and self.required == {owner.name}


def refusals(status: Status) -> int:
    """How many messages a node has refused."""
    return status.rejected + status.late + status.duplicate


def answers(command: Command) -> frozenset[tuple[int, int, int]]:
    """(slot, episode, step) of all slots that a command answers."""
    pairs = zip(command.episode, command.step, strict=False)
    return frozenset((slot, e, s) for slot, (e, s) in enumerate(pairs) if s is not None)


def leads_to(answered: frozenset[tuple[int, int, int]], episode: list[int], step: list[int]) -> bool:
    """Whether a sample at `episode` and `step` is the one that follows what was answered."""
    following = {(slot, e, s - 1) for slot, (e, s) in enumerate(zip(episode, step, strict=True))}
    return bool(answered) and answered <= following
