"""The step exchange: messages in, decisions out. No Zenoh, no EnergyPlus, no clock in here.

An episode of N timesteps has N commands and N + 1 samples. Sample 0 is the state after warm-up; command k
answers sample k and rules timestep k + 1; the last sample needs no answer.

    STARTING ──ready──▶ WAITING ──go──▶ RUNNING ──sampled──▶ WAITING … ──ended──▶ ENDED
        ▲                  │                                                       │
        └──────reset───────┴───────────────────────────────────────────────reset───┘

Slots are engines that step together, each in an episode of its own. A slot that no required controller answers
stands still, as does one whose episode is over; the exchange has ended when all of them have.

In lockstep the exchange goes on when each required controller has answered the present sample, and there
is at least one. In free and paced mode it goes on without them. A controller that vanished keeps its claim: by
policy the node waits until it is back or another takes its level over, or goes on without it, holding or releasing
what it commanded, or the episode is aborted. So it is with one that does not answer by the deadline.

Three kinds of messages change nothing and are counted and named in an event: `late` (answers a step that is
over), `duplicate` (answers the present step again), `rejected` (everything else that is wrong). Under the policy to
wait, a command that comes after the deadline still answers the present step: it is taken, and `accepted_late` says so.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from bridge.exchange.actuator_commands import ActuatorCommands, CommandSnapshot
from bridge.exchange.claims import ClaimHolder, Claims
from bridge.exchange.priority_array import MAX_SOURCES
from topics import codec
from topics.errors import BadMessage, EpisodeAborted
from topics.messages import (
    ANONYMOUS,
    Actuator,
    Claim,
    Command,
    ControllerStatus,
    Event,
    EventKind,
    Mode,
    Policy,
    State,
    Write,
)

MAX_MESSAGES_PER_STEP = 100
"""Messages of one controller in one step that are looked at, besides its usual commands."""

_UNKNOWN_CONTROLLERS = ""  # no controller can have this name

_COMMAND_ENCODING = codec.encoding(Command)

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


# For each timestep: Python 3.11 looks at an enum's member by raising and catching an error.
_GO, _SAMPLED, _OVER, _WAITING, _LOCKSTEP = Trigger.GO, Trigger.SAMPLED, Trigger.ENDED, State.WAITING, Mode.LOCKSTEP


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
class StepExchange:
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

    # The engine's side

    def ready(self, begun: Mapping[int, int] | None = None) -> None:
        """Note that the engines wait: those of `begun` (slot to sample; None: all, at 0) at a first sample."""
        self.transition(Trigger.READY)
        self.step, self.modified, self.done = [*self.step], [*self.modified], [*self.done]
        for slot, step in (begun if begun is not None else dict.fromkeys(self._all, 0)).items():
            self.step[slot] = step
            self.modified[slot] = step > 0
            self.done[slot] = False
        self.open_intake()

    def finish_step(self, last: Sequence[bool]) -> None:
        """The engines have simulated a timestep; `last` of each slot that moved. Call `listen` once it is published."""
        if self.active_slots is self._all:
            steps, ended = [step + 1 for step in self.step], [*last]
        else:
            steps, ended = [*self.step], [*self.done]
            for slot, over in zip(self.active_slots, last, strict=True):
                steps[slot] += 1
                ended[slot] = over
        self.transition(_OVER if all(ended) else _SAMPLED)
        self.step, self.done = steps, ended
        self.commands.timesteps += 1

    def open_intake(self) -> None:
        """Gets ready for the answers to the present sample; apart from `sampled` so that the sample goes first."""
        waived: set[str] = set()
        self._pending = set()
        for claimant in self.claims.by_name.values():
            if claimant.required:
                (waived if claimant.bypassed else self._pending).add(claimant.name)
        self._falls = bool(waived)
        if waived and not self._pending and self.deadline_s is not None:
            self._pending = waived  # nobody is there: the deadline sets the pace
        self._told_s, self._overdue_s = self.now_s, None
        if self._heard:
            self._heard = {}
        self._answered = set()
        self._answers = set()
        self._head = b"" if any(self.done) else codec.command_head(self.episode, self.step, self.commands.size)

    def reset(self, slots: Sequence[int] | None = None) -> None:
        """A new episode begins, in all slots or in some: what was set there is released.

        Claims of controllers that are there stay; those that are gone are forgotten once all slots begin anew.
        """
        self.transition(Trigger.RESET)
        if slots is None or len(set(slots)) == self.slots:
            self.episode = [episode + 1 for episode in self.episode]
            self.commands.clear()
            self.claims.begin_episode()
            return
        self.episode = [episode + (slot in slots) for slot, episode in enumerate(self.episode)]
        self.commands.array.relinquish_slots(slots)

    def capture(self) -> CommandSnapshot:
        """What holds at the present sample."""
        return self.commands.capture()

    def restore(self, held: CommandSnapshot) -> None:
        """Has that hold again; between `reset` and `ready`, or at the very beginning."""
        self.commands.restore(held)
        self.claims.begin_episode()

    def ready_to_step(self) -> bool:
        """Whether the next timestep may be simulated now."""
        if self.state is not _WAITING:
            return False
        if self.mode is not _LOCKSTEP:
            return True
        if self._pending:
            return False
        for claimant in self.claims.by_name.values():  # noqa: SIM110  # a generator costs more than the usual one
            if claimant.required:
                return True
        return False

    def awaiting(self) -> list[str]:
        """Required controllers that have not answered the present sample."""
        return sorted(self._pending)

    def begin_step(self) -> tuple[bytes, bytes]:
        """Starts the timestep: the values that rule it (float64, NaN: the building's own) and who set them (uint16)."""
        self.transition(_GO)
        self.fallback_active = self._falls and self._missed()
        self._went.append((self.episode, self.step, self.now_s))
        if not self._answers or len(self._answers) == self.slots or self.mode is not _LOCKSTEP:
            self.active_slots = self._all
        else:
            self.active_slots = sorted(self._answers)
        if any(self.done):
            self.active_slots = [slot for slot in self.active_slots if not self.done[slot]]
        if self.active_slots is self._all:
            self.modified = self._moved
        else:
            self.modified = [was or slot in self.active_slots for slot, was in enumerate(self.modified)]
        return self.commands.array.resolve()

    def _missed(self) -> bool:
        """Counts the required controllers without which the timestep goes on; whether there are any."""
        lockstep = self.mode is _LOCKSTEP
        missed = [
            c
            for c in self.claims.by_name.values()
            if c.required and (c.name not in self._answered if lockstep else c.bypassed)
        ]
        for claimant in missed:
            claimant.stats.missed += 1
        self.counts.missed += bool(missed)
        return bool(missed)

    # The controllers' side

    def claim(self, claim: Claim) -> list[Event]:
        """Takes or renews a claim; a renewed one answers the present sample again.

        Raises:
            RequestRejected: unknown actuators, or another present controller holds the level on one of them.
        """
        renewed = claim.controller in self.claims.by_name
        claimant, gone = self.claims.claim(claim, self.now_s)
        self.commands.drop_superseded_expiries(claimant)
        for name in (*gone, claim.controller):
            self._pending.discard(name)
            self._answered.discard(name)
        if claim.required and self.state is State.WAITING:
            # Who was waited for only so that the deadline sets the pace is not any more.
            self._pending -= {other.name for other in self.claims.by_name.values() if other.bypassed}
            self._pending.add(claim.controller)
        how = "again" if renewed else f"at level {claim.priority}"
        left = [self.event(EventKind.DISCONNECTED, f"{claim.controller} takes over from {name}", name) for name in gone]
        return [*left, self.event(EventKind.CONNECTED, f"{claim.controller} controls {how}", claim.controller)]

    def on_disconnect(self, name: str) -> list[Event]:
        """A controller has gone; its claim waits for it."""
        claimant = self.claims.by_name.get(name)
        if claimant is None or not claimant.connected:
            return []
        claimant.connected, claimant.disconnected_at_s = False, self.now_s
        waits = claimant.required and self.mode is Mode.LOCKSTEP and self.policy is Policy.WAIT
        return [
            self.event(EventKind.DISCONNECTED, f"{name} has gone{', the node waits for it' if waits else ''}", name)
        ]

    def bypass(self, name: str, grace_s: float = 0.0) -> list[Event]:
        """A controller has been gone for the time of grace: the policy goes on without it, unless it is back.

        One that was back and has left again has its time of grace again.

        Raises:
            EpisodeAborted: that is the policy.
        """
        claimant = self.claims.by_name.get(name)
        if claimant is None or claimant.connected or claimant.bypassed or self.policy is Policy.WAIT:
            return []
        if self.now_s - claimant.disconnected_at_s < grace_s:
            return []
        under_way = self.state in (State.WAITING, State.RUNNING)
        if self.policy is Policy.ABORT and claimant.required and under_way:
            raise EpisodeAborted(f"{name} has gone, and the policy is to abort the episode then")
        claimant.bypassed = True
        self._falls = self._falls or claimant.required
        if self.policy is Policy.RELINQUISH:
            self._answered.discard(name)  # what it answered is released as well
        if self.deadline_s is None or any(c.required and not c.bypassed for c in self.claims.by_name.values()):
            self._pending.discard(name)
        event = self._fall_back(claimant, "has gone")
        return [event] if under_way else []

    def on_deadline(self) -> list[Event]:
        """The deadline of the present step is over.

        Raises:
            EpisodeAborted: that is the policy.
        """
        if self.state is not State.WAITING or not self._pending:
            return []
        self._head = b""
        if self._overdue_s is None:
            self._overdue_s = self.now_s
        if self.policy is Policy.WAIT:
            return []
        names = ", ".join(self.awaiting())
        if self.policy is Policy.ABORT:
            raise EpisodeAborted(f"{names} gave no command within {self.deadline_s:g} s")
        events = []
        for name in self.awaiting():
            claimant = self.claims.by_name[name]
            if not claimant.unresponsive and not claimant.bypassed:
                claimant.unresponsive = True
                events.append(self._fall_back(claimant, f"gave no command within {self.deadline_s:g} s"))
        self._pending.clear()
        self._answers = set(self._all)
        self._falls = True
        return events

    def _fall_back(self, claimant: ClaimHolder, why: str) -> Event:
        if self.policy is Policy.RELINQUISH:
            self.claims.relinquish(claimant)
        what = "is released" if self.policy is Policy.RELINQUISH else "holds"
        return self.event(EventKind.FALLBACK, f"{claimant.name} {why}; what it commanded {what}", claimant.name)

    def accept_fast(self, controller: str, payload: bytes, said: str = "") -> bool:
        """Takes the bytes of a usual command: all actuators of one controller, for the present step.

        It is known by its head and needs no decoding; false (and nothing changed) for any other, as for one whose
        encoding `said` names another class or version.
        """
        if said != _COMMAND_ENCODING and not codec.encoding_matches(Command, said):
            return False
        head, size = self._head, self.commands.size
        if head and controller in self._pending and len(payload) == len(head) + size and payload.startswith(head):
            claimant, raw = self.claims.by_name[controller], payload[len(head) :]
            usual = claimant.covers_all and not claimant.unresponsive and self.state is _WAITING
            if usual and self.commands.put_fast(claimant, raw):
                self._took(claimant, self._all)
                return True
        return False

    def receive_command(self, controller: str, payload: bytes, said: str = "") -> Event | None:
        """Takes the bytes of any command; an event if there is something to say, above all if it was not taken.

        Of one controller's messages that are no usual commands, only the first hundred of a step are looked at: a
        flood is counted and passed over. All who have claimed nothing are one in this, whatever they call themselves.
        """
        who = controller if controller in self.claims.by_name else _UNKNOWN_CONTROLLERS
        heard = self._heard[who] = self._heard.get(who, 0) + 1
        if heard > MAX_MESSAGES_PER_STEP:
            self.counts.rate_limited += 1
            return None
        try:
            return self.command(controller, codec.decode(Command, payload, said))
        except BadMessage as error:
            return self.rejected(str(error), controller)

    def _took(self, claimant: ClaimHolder, answered: Sequence[int]) -> None:
        if claimant.required:
            self._answers.update(answered)
        record = claimant.stats
        record.accepted += 1
        record.response.add(self.now_s - max(self._told_s, claimant.connected_at_s))
        self.counts.accepted += 1
        self._pending.discard(claimant.name)
        self._answered.add(claimant.name)

    def command(self, controller: str, command: Command) -> Event | None:
        """Takes a command; an event if it was not taken."""
        claimant = self.claims.by_name.get(controller)
        if claimant is None:
            return self.rejected(f"{controller!r} has claimed nothing; claim first", controller)
        answered = [slot for slot, step in enumerate(command.step) if step is not None]
        if not self._for_the_present(command, answered):
            return self._wrong_step(controller, command, answered)
        if self.state in (State.FAILED, State.STARTING):
            return self.rejected(f"the node is {self.state}", controller)
        if self.state is not State.WAITING or controller in self._answered:
            self.counts.duplicate += 1
            claimant.stats.duplicate += 1
            text = f"step {self.step} was answered already" if self.state is not State.ENDED else "the episode is over"
            return self.event(EventKind.DUPLICATE, text, controller)
        over = next((slot for slot in answered if self.done[slot]), None)
        if over is not None or not answered:
            what = f"slot {over} is over; reset it, or" if answered else "no slot is answered;"
            return self.rejected(f"{what} leave out (step None) only those that are to stand still", controller)
        try:
            self.commands.put(claimant, command, answered)
        except BadMessage as error:
            return self.rejected(str(error), controller)
        self._took(claimant, answered)
        return self._back_in_time(claimant)

    def _back_in_time(self, claimant: ClaimHolder) -> Event | None:
        """What is to be said of a command that was taken, but after the deadline, or as the first one again."""
        if claimant.unresponsive:
            claimant.unresponsive = False
            return self.event(EventKind.CONNECTED, f"{claimant.name} answers again", claimant.name)
        if self._overdue_s is not None and claimant.connected_at_s <= self._overdue_s:
            self.counts.accepted_late += 1
            claimant.stats.accepted_late += 1
            text = f"was taken, though after the deadline of {self.deadline_s:g} s"
            return self._late_event(EventKind.ACCEPTED_LATE, text, claimant.name, self._overdue_s)
        return None

    def _late(self, text: str, source: str, since_s: float | None) -> Event:
        self.counts.late += 1
        claimant = self.claims.by_name.get(source)
        if claimant is not None:
            claimant.stats.late += 1
        return self._late_event(EventKind.LATE, text, source, since_s)

    def _late_event(self, kind: EventKind, text: str, source: str, since_s: float | None) -> Event:
        event = self.event(kind, text, source)
        return event if since_s is None else event.model_copy(update={"late_s": self.now_s - since_s})

    def _for_the_present(self, command: Command, answered: Sequence[int]) -> bool:
        if command.step == self.step and command.episode == self.episode:
            return True
        return len(command.step) == len(command.episode) == self.slots and all(
            (command.episode[slot], command.step[slot]) == (self.episode[slot], self.step[slot]) for slot in answered
        )

    def _wrong_step(self, controller: str, command: Command, answered: Sequence[int]) -> Event:
        text = f"answers episode {command.episode} step {command.step}; "
        text += f"present are episode {self.episode} step {self.step}"
        if len(command.step) == len(command.episode) == self.slots:
            came = [(command.episode[slot], command.step[slot] or 0) for slot in answered]
            present = [(self.episode[slot], self.step[slot]) for slot in answered]
            if all(one <= other for one, other in zip(came, present, strict=True)):
                return self._late(text, controller, self._went_on(answered[0], came[0]) if came else None)
        return self.rejected(text, controller)

    def _went_on(self, slot: int, at: tuple[int, int]) -> float | None:
        """When a slot went on from a step; None if that is forgotten, or it never did."""
        went = (now for episode, step, now in reversed(self._went) if (episode[slot], step[slot]) == at)
        return next(went, None)

    def write(self, name: str, write: Write, elapsed_s: float) -> Event:
        """A device or a person writes one actuator; it rules from the next timestep on."""
        if self.state in (State.ENDED, State.FAILED):
            return self.rejected(
                f"{name}: the episode is over, and nothing would feel it; reset it first", write.source
            )
        try:
            index = self.commands.find(name, write)
        except BadMessage as error:
            return self.rejected(str(error), write.source)
        holder = self.claims.holder(write.priority, index)
        if holder is not None:
            return self.rejected(f"level {write.priority} of {name!r} is claimed by {holder.name!r}", write.source)
        array, name_ = self.commands.array, write.source or ANONYMOUS
        if write.value is not None and not array.has_room(name_, self.claims.sources):
            text = f"{name}: {MAX_SOURCES} sources hold actuators, which is the most; release what some of them hold"
            return self.rejected(text, write.source)
        self.modified = self._moved
        who = array.source(name_, self.claims.sources)
        return self.event(EventKind.WRITTEN, self.commands.write(index, write, who, elapsed_s), write.source)

    def expire(self, elapsed_s: float) -> list[Event]:
        """Releases what was written for a time that is over."""
        over = self.commands.expire(elapsed_s)
        if over:
            self.modified = self._moved
        return [self.event(EventKind.EXPIRED, text, source) for text, source in over]

    # Words

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

    def controllers(self) -> list[ControllerStatus]:
        """All claims, for the status."""
        return [
            ControllerStatus(
                controller=c.name,
                priority=c.priority,
                actuators=int(c.mask.sum()),
                required=c.required,
                connected=c.connected,
                accepted=c.stats.accepted,
                late=c.stats.late,
                rejected=c.stats.rejected,
                duplicate=c.stats.duplicate,
                missed=c.stats.missed,
                bypassed=c.bypassed,
                unresponsive=c.unresponsive,
                accepted_late=c.stats.accepted_late,
                response=c.stats.response.summary(),
            )
            for c in [*self.claims.by_name.values()]
        ]
