"""The step exchange: messages in, decisions out. No Zenoh, no EnergyPlus, no clock in here.

An episode of N timesteps has N commands and N + 1 samples. Sample 0 is the state after warm-up; command k
answers sample k and rules timestep k + 1; the last sample needs no answer.

    STARTING ──ready──▶ WAITING ──go──▶ RUNNING ──sampled──▶ WAITING … ──ended──▶ ENDED
        ▲                  │                                                       │
        └──────reset───────┴───────────────────────────────────────────────reset───┘

In lockstep the exchange goes on when each required controller has answered the present sample, and there
is at least one. In free mode it always goes on. A controller that vanished keeps its claim (policy `wait`):
the node waits until it is back or another takes its level over.

Three kinds of messages change nothing and are counted and named in an event: `late` (answers a step that is
over), `duplicate` (answers the present step again), `rejected` (everything else that is wrong).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from bridge.claims import Claimant, Claims
from bridge.priority import PriorityArray
from topics import codec
from topics.errors import BadMessage, near
from topics.messages import (
    Actuator,
    Claim,
    Command,
    ControllerStatus,
    Event,
    EventKind,
    Mask,
    Mode,
    State,
    Write,
)


class Input(StrEnum):
    """What can happen to an episode."""

    READY = "ready"
    GO = "go"
    SAMPLED = "sampled"
    ENDED = "ended"
    RESET = "reset"
    FAIL = "fail"
    STOP = "stop"


TRANSITIONS: dict[tuple[State, Input], State] = {
    (State.STARTING, Input.READY): State.WAITING,
    (State.WAITING, Input.GO): State.RUNNING,
    (State.RUNNING, Input.SAMPLED): State.WAITING,
    (State.RUNNING, Input.ENDED): State.ENDED,
    (State.WAITING, Input.RESET): State.STARTING,
    (State.ENDED, Input.RESET): State.STARTING,
    (State.FAILED, Input.RESET): State.STARTING,
    **{(s, Input.FAIL): State.FAILED for s in (State.STARTING, State.WAITING, State.RUNNING)},
    **{(s, Input.STOP): State.STOPPED for s in State if s is not State.STOPPED},
}


class IllegalInput(RuntimeError):
    """An input that the present state has no row for: a mistake in the program, not of a peer."""


@dataclass(slots=True)
class Counts:
    """Messages of the node's life."""

    accepted: int = 0
    rejected: int = 0
    late: int = 0
    duplicate: int = 0


@dataclass(slots=True)
class _Expiry:
    at_s: float
    level: int
    actuator: int
    source: str


@dataclass(slots=True)
class Exchange:
    """The state of one node's exchange.

    Attributes:
        actuators: in manifest order.
        slots: engines in the node.
        mode: who sets the pace.
    """

    actuators: tuple[Actuator, ...]
    slots: int = 1
    mode: Mode = Mode.LOCKSTEP
    state: State = State.STARTING
    episode: list[int] = field(default_factory=list)
    step: list[int] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    claims: Claims = field(init=False)
    touched: bool = False
    _pending: set[str] = field(default_factory=set)
    _answered: set[str] = field(default_factory=set)
    _expiries: list[_Expiry] = field(default_factory=list)
    _limits: NDArray[np.float64] = field(init=False)
    _clipped: NDArray[np.float64] = field(init=False)
    _size: int = field(init=False)
    _array: PriorityArray = field(init=False)
    _index: dict[str, int] = field(init=False)
    _head: bytes = field(init=False, default=b"")

    def __post_init__(self) -> None:
        self.episode = self.episode or [0] * self.slots
        self.step = self.step or [0] * self.slots
        most = float(np.finfo(np.float64).max)  # an unbounded actuator takes any finite value
        low = [-most if a.low is None else a.low for a in self.actuators]
        high = [most if a.high is None else a.high for a in self.actuators]
        self._limits = np.tile(np.array([low, high]).reshape(2, -1), self.slots)
        self._clipped = np.empty(self._limits.shape[1])
        self._size = self._clipped.nbytes
        self._array = PriorityArray(self.slots, len(self.actuators))
        self._index = {a.name: i for i, a in enumerate(self.actuators)}
        self.claims = Claims(self.actuators, self._array)

    @property
    def shape(self) -> tuple[int, int]:
        """(slots, actuators)."""
        return self.slots, len(self.actuators)

    @property
    def ruler_names(self) -> list[str]:
        """Names that the indices of `go` refer to."""
        return self._array.names

    def take(self, what: Input) -> None:
        """Moves on by the table.

        Raises:
            IllegalInput: there is no row for it.
        """
        try:
            self.state = TRANSITIONS[self.state, what]
        except KeyError:
            raise IllegalInput(f"{what!r} cannot happen to a node that is {self.state!r}") from None

    # The engine's side

    def ready(self) -> None:
        """The engine waits at sample 0."""
        self.take(Input.READY)
        self.step = [0] * self.slots
        self.touched = False
        self.listen()

    def sampled(self, *, last: bool) -> None:
        """The engine has simulated a timestep. Call `listen` once the sample is published."""
        self.take(Input.ENDED if last else Input.SAMPLED)
        self.step = [step + 1 for step in self.step]

    def listen(self) -> None:
        """Gets ready for the answers to the present sample; apart from `sampled` so that the sample goes first."""
        self._pending = {c.name for c in self.claims.by_name.values() if c.required}
        self._answered = set()
        self._head = codec.command_head(self.episode, self.step, self._size)

    def reset(self) -> None:
        """A new episode begins: claims of controllers that are there stay, what was set is released."""
        self.take(Input.RESET)
        self.episode = [episode + 1 for episode in self.episode]
        self._array.clear()
        self._expiries.clear()
        self.claims.begin_episode()

    def due(self) -> bool:
        """Whether the next timestep may be simulated now."""
        if self.state is not State.WAITING:
            return False
        if self.mode is Mode.FREE:
            return True
        return not self._pending and any(c.required for c in self.claims.by_name.values())

    def missing(self) -> list[str]:
        """Required controllers that have not answered the present sample."""
        return sorted(self._pending)

    def go(self) -> tuple[bytes, bytes]:
        """Starts the timestep: the values that rule it (float64, NaN: the building's own) and who set them (uint8)."""
        self.take(Input.GO)
        self.touched = True
        return self._array.resolve()

    # The controllers' side

    def claim(self, claim: Claim) -> list[Event]:
        """Takes or renews a claim; a renewed one answers the present sample again.

        Raises:
            Refused: unknown actuators, or another present controller holds the level on one of them.
        """
        renewed = claim.controller in self.claims.by_name
        claimant, gone = self.claims.take(claim)
        self._expiries = [e for e in self._expiries if not (e.level == claim.level and claimant.allowed[e.actuator])]
        for name in (*gone, claim.controller):
            self._pending.discard(name)
            self._answered.discard(name)
        if claim.required and self.state is State.WAITING:
            self._pending.add(claim.controller)
        how = "again" if renewed else f"at level {claim.level}"
        left = [self.event(EventKind.LEFT, f"{claim.controller} takes over from {name}", name) for name in gone]
        return [*left, self.event(EventKind.JOINED, f"{claim.controller} controls {how}", claim.controller)]

    def left(self, name: str) -> list[Event]:
        """A controller has gone; its claim waits for it."""
        claimant = self.claims.by_name.get(name)
        if claimant is None or not claimant.present:
            return []
        claimant.present = False
        waits = ", the node waits for it" if claimant.required and self.mode is Mode.LOCKSTEP else ""
        return [self.event(EventKind.LEFT, f"{name} has gone{waits}", name)]

    def take_usual(self, controller: str, payload: bytes) -> bool:
        """Takes the bytes of a usual command: all actuators of one controller, for the present step.

        It is known by its head and needs no decoding; false (and nothing changed) for any other.
        """
        head = self._head
        if controller in self._pending and len(payload) == len(head) + self._size and payload.startswith(head):
            claimant, raw = self.claims.by_name[controller], payload[len(head) :]
            if claimant.whole and self.state is State.WAITING and self._within(raw):
                self._array.put_all(claimant.level, claimant.source, raw)
                self._took(claimant)
                return True
        return False

    def hear(self, controller: str, payload: bytes, said: str = "") -> Event | None:
        """Takes the bytes of any command; an event if it was not taken."""
        try:
            return self.command(controller, codec.decode(Command, payload, said))
        except BadMessage as error:
            return self.rejected(str(error), controller)

    def _took(self, claimant: Claimant) -> None:
        claimant.accepted += 1
        self.counts.accepted += 1
        self._pending.discard(claimant.name)
        self._answered.add(claimant.name)

    def command(self, controller: str, command: Command) -> Event | None:
        """Takes a command; an event if it was not taken."""
        claimant = self.claims.by_name.get(controller)
        if claimant is None:
            return self.rejected(f"{controller!r} has claimed nothing; claim first", controller)
        if command.step != self.step or command.episode != self.episode:
            return self._wrong_step(controller, command)
        if self.state in (State.FAILED, State.STARTING):
            return self.rejected(f"the node is {self.state}", controller)
        if self.state is not State.WAITING or controller in self._answered:
            self.counts.duplicate += 1
            text = f"step {self.step} was answered already" if self.state is not State.ENDED else "the episode is over"
            return self.event(EventKind.DUPLICATE, text, controller)
        try:
            self._apply(claimant, command)
        except BadMessage as error:
            return self.rejected(str(error), controller)
        self._took(claimant)
        return None

    def _wrong_step(self, controller: str, command: Command) -> Event:
        came, present = (command.episode, command.step), (self.episode, self.step)
        text = f"answers episode {came[0]} step {came[1]}; present are episode {present[0]} step {present[1]}"
        if len(command.step) == len(command.episode) == self.slots and came < present:
            self.counts.late += 1
            return self.event(EventKind.LATE, text, controller)
        return self.rejected(text, controller)

    def _apply(self, claimant: Claimant, command: Command) -> None:
        values = codec.floats(command.values, self.shape, "values")
        if command.mask is None and claimant.whole:
            self._check(values)
            self._array.put_all(claimant.level, claimant.source, command.values)
            return
        mask = self._mask(claimant, command)
        self._check(np.where(mask == Mask.SET, values, self._limits[0].reshape(self.shape)))
        self._array.put(claimant.level, claimant.source, np.where(mask == Mask.SET, values, np.nan), mask != Mask.KEEP)

    def _mask(self, claimant: Claimant, command: Command) -> NDArray[np.uint8]:
        if command.mask is None:
            mask = np.full(self.shape, Mask.SET, np.uint8)
        else:
            mask = codec.octets(command.mask, self.shape, "mask")
        if mask.size and mask.max() > Mask.RELEASE:
            raise BadMessage(f"mask has {int(mask.max())}; 0 keeps, 1 sets, 2 releases")
        if (mask[:, ~claimant.allowed] != Mask.KEEP).any():
            _, index = np.argwhere((mask != Mask.KEEP) & ~claimant.allowed)[0]
            raise BadMessage(f"{self.actuators[index].name!r} is not among the actuators it claimed")
        return mask

    def _within(self, raw: bytes) -> bool:
        """Whether clipping would change nothing; a quick yes, while a no (also for -0.0) wants `_check`."""
        low, high = self._limits
        clipped = self._clipped
        np.fmin(np.fmax(np.frombuffer(raw), low, out=clipped), high, out=clipped)
        return clipped.tobytes() == raw

    def _check(self, values: NDArray[np.float64]) -> None:
        """All values, shape (slots, actuators), finite and within bounds, or `BadMessage`."""
        low, high = self._limits.reshape(2, *self.shape)
        wrong = ~((values >= low) & (values <= high))  # true for NaN
        if wrong.any():
            slot, index = np.argwhere(wrong)[0]
            raise BadMessage(self._out_of_bounds(int(index), float(values[slot, index])))

    def _out_of_bounds(self, index: int, value: float) -> str:
        actuator = self.actuators[index]
        low, high = (str(b) if b is not None else "unbounded" for b in (actuator.low, actuator.high))
        return f"{actuator.name} = {value:g} {actuator.unit}; its bounds are {low} to {high}"

    def write(self, name: str, write: Write, elapsed_s: float) -> Event:
        """A device or a person writes one actuator; it rules from the next timestep on."""
        if name not in self._index:
            return self.rejected(f"no actuator {name!r}; {near(name, self._index)}", write.source)
        index = self._index[name]
        if write.value is not None:
            actuator = self.actuators[index]
            low, high = self._limits[:, index]
            if not low <= write.value <= high:
                return self.rejected(self._out_of_bounds(index, write.value), write.source)
            text = f"{name} = {write.value:g} {actuator.unit} at priority {write.priority}"
        else:
            text = f"{name} released at priority {write.priority}"
        holder = self.claims.holder(write.priority, index)
        if holder is not None:
            return self.rejected(f"level {write.priority} of {name!r} is claimed by {holder.name!r}", write.source)
        self._set(write.priority, write.source, index, write.value)
        self._expiries = [e for e in self._expiries if (e.level, e.actuator) != (write.priority, index)]
        if write.value is not None and write.for_s is not None:
            self._expiries.append(_Expiry(elapsed_s + write.for_s, write.priority, index, write.source))
        return self.event(EventKind.WRITTEN, text, write.source)

    def _set(self, level: int, source: str, index: int, value: float | None) -> None:
        self.touched = True
        self._array.put_one(level, self._array.source(source), index, np.nan if value is None else value)

    @property
    def expiring(self) -> bool:
        """Whether anything was written for a time."""
        return bool(self._expiries)

    def nobody(self) -> tuple[bytes, bytes]:
        """What `go` returns where nobody commands."""
        return PriorityArray(*self.shape).resolve()

    def expire(self, elapsed_s: float) -> list[Event]:
        """Releases what was written for a time that is over."""
        over = [e for e in self._expiries if e.at_s <= elapsed_s]
        self._expiries = [e for e in self._expiries if e.at_s > elapsed_s]
        for e in over:
            self._set(e.level, e.source, e.actuator, None)
        return [
            self.event(EventKind.EXPIRED, f"{self.actuators[e.actuator].name} released at priority {e.level}", e.source)
            for e in over
        ]

    # Words

    def rejected(self, text: str, source: str) -> Event:
        """Counts a message that was not taken, and the event that names it."""
        self.counts.rejected += 1
        return self.event(EventKind.REJECTED, text, source)

    def event(self, kind: EventKind, text: str, source: str = "", error: str = "") -> Event:
        """An event at the present episode and step."""
        return Event(kind=kind, text=text, source=source, error=error, episode=self.episode[0], step=self.step[0])

    def controllers(self) -> list[ControllerStatus]:
        """All claims, for the status."""
        return [
            ControllerStatus(
                controller=c.name,
                level=c.level,
                actuators=int(c.allowed.sum()),
                required=c.required,
                present=c.present,
                accepted=c.accepted,
            )
            for c in self.claims.by_name.values()
        ]
