"""The gateway's state of a node and of the controllers that use the gateway."""

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
        route, fd: routing id and file descriptor of its connection.
        required: as in its claim.
        leave: undeclares its liveliness token.
        accepted: number of its accepted commands: from the node's status, and counted from there.
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
        waits: whether it steps only once all required controllers have answered: lockstep without a deadline.
        instances: its declared liveliness tokens.
        latest: frames of its manifest and its latest sample, by topic.
        owners: the controllers that use this gateway.
        required: names of the controllers that it waits for; None if they may have changed, or it is paused.
        received: number of its samples and events.
        published: number of rejections among the events.
        unpublished: rejections counted but not published (their number per step is limited); None if unknown.
        refusing: whether it published a rejection since its latest sample.
        failure: the event of its failure.
        stopped: whether it published that it stops.
    """

    name: str
    waits: bool = False
    instances: set[str] = field(default_factory=set)
    latest: dict[bytes, list[bytes]] = field(default_factory=dict)
    owners: dict[str, Owner] = field(default_factory=dict)
    required: set[str] | None = None
    received: int = 0
    published: int = 0
    unpublished: int | None = None
    refusing: bool = False
    failure: Event | None = None
    stopped: bool = False

    def note_manifest(self, manifest: Manifest) -> None:
        """Record a manifest."""
        self.waits = manifest.mode is Mode.LOCKSTEP and manifest.deadline_s is None

    def note_sample(self) -> None:
        """Record a sample."""
        self.received += 1
        if self.refusing:
            self.refusing, self.unpublished = False, None

    def note_event(self, event: Event) -> None:
        """Record an event."""
        self.received += 1
        if event.kind in REFUSALS:
            self.published += 1
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
        """Record the required controllers of a status; return the status of one controller."""
        self.required = None if status.paused else {c.controller for c in status.controllers if c.required}
        return next((c for c in status.controllers if c.controller == owner.name), None)

    def waits_only_for(self, owner: Owner) -> bool:
        """Return whether the node steps as soon as this controller's command is accepted."""
        return self.waits and self.required == {owner.name}


def refusals(status: Status) -> int:
    """Return the number of messages that a node has rejected."""
    return status.rejected + status.late + status.duplicate


def answers(command: Command) -> frozenset[tuple[int, int, int]]:
    """Return (slot, episode, step) of all slots that a command answers."""
    pairs = zip(command.episode, command.step, strict=False)
    return frozenset((slot, e, s) for slot, (e, s) in enumerate(pairs) if s is not None)


def leads_to(answered: frozenset[tuple[int, int, int]], episode: list[int], step: list[int]) -> bool:
    """Return whether a sample at `episode` and `step` follows the answered one."""
    following = {(slot, e, s - 1) for slot, (e, s) in enumerate(zip(episode, step, strict=True))}
    return bool(answered) and answered <= following
