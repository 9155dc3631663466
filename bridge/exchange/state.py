"""State of the step exchange: its transitions, its fields and its message counts."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from bridge.exchange.actuator_commands import ActuatorCommands
from bridge.exchange.claims import Claims
from topics.messages import Actuator, Event, EventKind, Mode, Policy, State

MAX_EVENT_TEXT = 20_000
MAX_SOURCE_NAME = 128
"""Characters of an event's text, and of the name of who writes: samples and events repeat it."""

_STEP_TIMES_KEPT = 64
"""Timesteps of which is known when they went on, to say how late a command is."""


class Trigger(StrEnum):
    """What can happen to an episode."""

    READY = "ready"
    GO = "go"
    SAMPLED = "sampled"
    ENDED = "ended"
    RESET = "reset"
    FAIL = "fail"
    STOP = "stop"


TRANSITIONS: dict[tuple[State, Trigger], State] = {
    (State.STARTING, Trigger.READY): State.WAITING,
    (State.WAITING, Trigger.GO): State.RUNNING,
    (State.RUNNING, Trigger.SAMPLED): State.WAITING,
    (State.RUNNING, Trigger.ENDED): State.ENDED,
    (State.WAITING, Trigger.RESET): State.STARTING,
    (State.ENDED, Trigger.RESET): State.STARTING,
    (State.FAILED, Trigger.RESET): State.STARTING,
    **{(s, Trigger.FAIL): State.FAILED for s in (State.STARTING, State.WAITING, State.RUNNING)},
    **{(s, Trigger.STOP): State.STOPPED for s in State if s is not State.STOPPED},
}


class IllegalTransition(RuntimeError):
    """An input that the present state has no row for: a mistake in the program, not of a peer."""


@dataclass(slots=True)
class MessageCounts:
    """Messages of the node's life."""

    accepted: int = 0
    rejected: int = 0
    late: int = 0
    duplicate: int = 0
    missed: int = 0
    rate_limited: int = 0
    accepted_late: int = 0


@dataclass(slots=True)
class ExchangeState:
    """The state of one node's exchange.

    Attributes:
        actuators: in manifest order.
        slots: engines in the node.
        commanded: what the actuators are commanded.
        claims: by whom.
        mode: who sets the pace.
        touched: of each slot, whether it was commanded or has moved since it began.
        ended: of each slot, whether its episode is over.
        moving: the slots that the running timestep moves.
        policy: what happens without a controller that is waited for.
        deadline_s: how long a step waits; whoever drives the exchange calls `overdue` then.
        now_s: wall time, by whatever clock; set by whoever drives the exchange before it calls.
        fallback: whether the running timestep, or the latest, went on without a command of a required controller.
    """

    actuators: tuple[Actuator, ...]
    slots: int = 1
    mode: Mode = Mode.LOCKSTEP
    policy: Policy = Policy.WAIT
    deadline_s: float | None = None
    now_s: float = 0.0
    state: State = State.STARTING
    episode: list[int] = field(default_factory=list)
    step: list[int] = field(default_factory=list)
    counts: MessageCounts = field(default_factory=MessageCounts)
    commands: ActuatorCommands = field(init=False)
    claims: Claims = field(init=False)
    modified: list[bool] = field(init=False)
    done: list[bool] = field(init=False)
    active_slots: Sequence[int] = field(init=False)
    fallback_active: bool = False
    _falls: bool = False
    _told_s: float = 0.0
    _overdue_s: float | None = None
    _went: deque[tuple[list[int], list[int], float]] = field(default_factory=lambda: deque(maxlen=_STEP_TIMES_KEPT))
    _heard: dict[str, int] = field(default_factory=dict)
    _answers: set[int] = field(default_factory=set)
    _pending: set[str] = field(default_factory=set)
    _answered: set[str] = field(default_factory=set)
    _head: bytes = field(init=False, default=b"")
    _all: range = field(init=False)
    _moved: list[bool] = field(init=False)

    def __post_init__(self) -> None:
        self.episode = self.episode or [0] * self.slots
        self.step = self.step or [0] * self.slots
        self.modified = [False] * self.slots
        self.done = [False] * self.slots
        self.active_slots = self._all = range(self.slots)
        self._moved = [True] * self.slots
        self.commands = ActuatorCommands(self.actuators, self.slots)
        self.claims = Claims(self.actuators, self.commands.array)

    @property
    def shape(self) -> tuple[int, int]:
        """(slots, actuators)."""
        return self.slots, len(self.actuators)

    @property
    def source_names(self) -> list[str]:
        """Names that the indices of `go` refer to."""
        return self.commands.array.names

    def transition(self, what: Trigger) -> None:
        """Moves on by the table.

        Raises:
            IllegalTransition: there is no row for it.
        """
        try:
            self.state = TRANSITIONS[self.state, what]
        except KeyError:
            raise IllegalTransition(f"{what!r} cannot happen to a node that is {self.state!r}") from None

    def awaiting(self) -> list[str]:
        """Required controllers that have not answered the present sample."""
        return sorted(self._pending)

    def rejected(self, text: str, source: str) -> Event:
        """Counts a message that was not taken, and the event that names it."""
        self.counts.rejected += 1
        if source in self.claims.by_name:
            self.claims.by_name[source].stats.rejected += 1
        return self.event(EventKind.REJECTED, text, source)

    def event(self, kind: EventKind, text: str, source: str = "", error: str = "") -> Event:
        """An event at the present episode and step."""
        text, source = text[:MAX_EVENT_TEXT], source[:MAX_SOURCE_NAME]
        return Event(kind=kind, text=text, source=source, error=error, episode=self.episode[0], step=self.step[0])
