"""State of the step exchange: its fields and message counts."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from zenostat.bridge.exchange.actuator_commands import ActuatorCommands
from zenostat.bridge.exchange.answers import Answers
from zenostat.bridge.exchange.claims import ClaimHolder, Claims
from zenostat.bridge.exchange.transitions import TRANSITIONS, IllegalTransition, Trigger
from zenostat.topics import codec
from zenostat.topics.messages import Actuator, ControllerState, Event, EventKind, Mode, Policy, State

MAX_EVENT_TEXT = 20_000
"""Largest number of characters in an event's text."""

MAX_SOURCE_NAME = 128
"""Largest number of characters in a source's name, which samples and events repeat."""

_STEP_TIMES_KEPT = 64
"""Number of latest timesteps whose start is recorded, to report how late a command is."""


@dataclass(slots=True)
class MessageCounts:
    """Message counts since the node started."""

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

    Methods have no clock. Those that need the time have an argument `now_s`: wall time of any monotonic clock.

    Attributes:
        actuators: in manifest order.
        slots: number of engines in the node.
        mode: what determines the pace of simulated time.
        policy: the fallback policy.
        deadline_s: how long a step waits for commands; the node calls `on_deadline` then.
        connected: as in the manifest.
        commands: the commanded values of the actuators.
        claims: the controllers' claims.
        modified: of each slot, whether it was commanded or has stepped since the start of its episode.
        done: of each slot, whether its episode is over.
        active_slots: the slots that step in the running timestep.
        commanded: the command in effect for each actuator; float64, NaN: relinquished, (slots, actuators).
        source_index: of each effective value, the index of its source in `source_names`; uint16, (slots, actuators).
        fallback_active: whether the running or the latest timestep lacks a required controller's command.
        answers: the answers to the current sample.
        step_starts: episodes and steps of the latest timesteps, and the wall times at which they began.
        all_slots: the `active_slots` of a timestep of all slots.
        all_modified: `modified` after such a timestep.
    """

    actuators: tuple[Actuator, ...]
    slots: int = 1
    mode: Mode = Mode.LOCKSTEP
    policy: Policy = Policy.WAIT
    deadline_s: float | None = None
    state: State = State.STARTING
    episode: list[int] = field(default_factory=list)
    step: list[int] = field(default_factory=list)
    counts: MessageCounts = field(default_factory=MessageCounts)
    connected: Mapping[str, str] = field(default_factory=dict)
    commands: ActuatorCommands = field(init=False)
    claims: Claims = field(init=False)
    modified: list[bool] = field(init=False)
    done: list[bool] = field(init=False)
    active_slots: Sequence[int] = field(init=False)
    commanded: bytes = field(init=False)
    source_index: bytes = field(init=False)
    fallback_active: bool = False
    answers: Answers = field(default_factory=Answers)
    step_starts: deque[tuple[list[int], list[int], float]] = field(
        default_factory=lambda: deque(maxlen=_STEP_TIMES_KEPT)
    )
    all_slots: Sequence[int] = field(init=False)
    all_modified: list[bool] = field(init=False)

    def __post_init__(self) -> None:
        self.episode = self.episode or [0] * self.slots
        self.step = self.step or [0] * self.slots
        self.modified = [False] * self.slots
        self.done = [False] * self.slots
        self.active_slots = self.all_slots = range(self.slots)
        self.all_modified = [True] * self.slots
        self.clear_commanded()
        self.commands = ActuatorCommands(self.actuators, self.slots, self.connected)
        self.claims = Claims(self.actuators, self.commands.array, self.connected)

    def clear_commanded(self) -> None:
        """Report all actuators as relinquished, with baseline control as their source."""
        self.commanded = codec.RELINQUISHED * (self.slots * len(self.actuators))
        self.source_index = bytes(2 * self.slots * len(self.actuators))

    @property
    def shape(self) -> tuple[int, int]:
        """(slots, actuators)."""
        return self.slots, len(self.actuators)

    @property
    def source_names(self) -> list[str]:
        """Names to which `source_index` refers."""
        return self.commands.array.names

    def transition(self, trigger: Trigger) -> None:
        """Change the episode's state according to the table of transitions.

        Raises:
            IllegalTransition: the trigger is not allowed in the current state.
        """
        try:
            self.state = TRANSITIONS[self.state, trigger]
        except KeyError:
            raise IllegalTransition(f"{trigger!r} is not allowed in state {self.state!r}") from None

    def awaiting(self) -> list[str]:
        """Return the required controllers that have not answered the current sample."""
        return sorted(self.answers.pending)

    def await_answer(self, claimant: ClaimHolder) -> None:
        """Wait for a controller's answer to the current sample if it is required."""
        if claimant.required and self.state is State.WAITING:
            # Bypassed controllers were pending only so that the deadline set the pace.
            bypassed = {c.name for c in self.claims.by_name.values() if c.state is ControllerState.BYPASSED}
            self.answers.pending = (self.answers.pending - bypassed) | {claimant.name}

    def rejected(self, text: str, source: str) -> Event:
        """Count a rejected message and return its event."""
        self.counts.rejected += 1
        if source in self.claims.by_name:
            self.claims.by_name[source].stats.rejected += 1
        return self.event(EventKind.REJECTED, text, source)

    def event(self, kind: EventKind, text: str, source: str = "", error: str = "") -> Event:
        """Return an event at the current episode and step."""
        text, source = text[:MAX_EVENT_TEXT], source[:MAX_SOURCE_NAME]
        return Event(kind=kind, text=text, source=source, error=error, episode=self.episode[0], step=self.step[0])
