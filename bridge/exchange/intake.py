"""The intake of the step exchange: commands and writes that are accepted or rejected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zenostat.bridge.exchange.claims import ClaimHolder
from zenostat.bridge.exchange.priority_array import MAX_SOURCES
from zenostat.bridge.exchange.state import ExchangeState
from zenostat.bridge.exchange.transitions import ControllerTrigger
from zenostat.topics import codec
from zenostat.topics.errors import BadMessage
from zenostat.topics.messages import ANONYMOUS, Command, ControllerState, Event, EventKind, State, Write

MAX_MESSAGES_PER_STEP = 100
"""Largest number of messages of one controller that are processed in one step, apart from fast-path commands."""

_UNKNOWN_CONTROLLERS = ""  # no controller can have this name

_COMMAND_ENCODING = codec.encoding(Command)

# Access to an enum's member raises and catches an error in Python 3.11.
_WAITING, _CONNECTED = State.WAITING, ControllerState.CONNECTED


@dataclass(slots=True)
class Intake(ExchangeState):
    """Accepts or rejects commands and writes."""

    def accept_fast(self, controller: str, payload: bytes, now_s: float, encoding: str = "") -> bool:
        """Accept a command on the fast path: of a connected controller, all actuators, the current step of all slots.

        Such a command is recognized by its first bytes and not decoded. For any other command, including one whose
        encoding names another class or version, return False; nothing is changed.
        """
        if encoding != _COMMAND_ENCODING and not codec.encoding_matches(Command, encoding):
            return False
        head, size = self._head, self.commands.size
        if head and controller in self._pending and len(payload) == len(head) + size and payload.startswith(head):
            claimant, raw = self.claims.by_name[controller], payload[len(head) :]
            is_eligible = claimant.covers_all and claimant.state is _CONNECTED and self.state is _WAITING
            if is_eligible and self.commands.put_fast(claimant, raw):
                self._record_answer(claimant, self._all_slots, now_s)
                return True
        return False

    def receive_command(self, controller: str, payload: bytes, now_s: float, encoding: str = "") -> Event | None:
        """Accept or reject the payload of any command; return an event unless it is a normal answer.

        Of each controller, only the first hundred such messages in a step are processed; the rest are counted as rate
        limited and ignored. All controllers without a claim count as one.
        """
        if self.is_rate_limited(controller):
            return None
        try:
            return self.command(controller, codec.decode(Command, payload, encoding), now_s)
        except BadMessage as error:
            return self.rejected(str(error), controller)

    def is_rate_limited(self, controller: str) -> bool:
        """Count a message of a controller; return whether there are too many in this step to process it."""
        sender = controller if controller in self.claims.by_name else _UNKNOWN_CONTROLLERS
        count = self._message_counts[sender] = self._message_counts.get(sender, 0) + 1
        if count <= MAX_MESSAGES_PER_STEP:
            return False
        self.counts.rate_limited += 1
        return True

    def _record_answer(self, claimant: ClaimHolder, answered: Sequence[int], now_s: float) -> None:
        if claimant.required:
            self._answered_slots.update(answered)
        stats = claimant.stats
        stats.accepted += 1
        began_s = self._opened_s if self._opened_s > claimant.connected_at_s else claimant.connected_at_s
        stats.response.add(now_s - began_s)
        self.counts.accepted += 1
        self._pending.discard(claimant.name)
        self._answered.add(claimant.name)

    def command(self, controller: str, command: Command, now_s: float) -> Event | None:
        """Accept or reject a command; return an event unless it is a normal answer."""
        claimant = self.claims.by_name.get(controller)
        if claimant is None:
            return self.rejected(f"{controller!r} has claimed nothing; claim first", controller)
        answered = [slot for slot, step in enumerate(command.step) if step is not None]
        if not self._answers_current_step(command, answered):
            return self._wrong_step(controller, command, answered, now_s)
        if self.state in (State.FAILED, State.STARTING):
            return self.rejected(f"the node is {self.state}", controller)
        if self.state is not State.WAITING or controller in self._answered:
            self.counts.duplicate += 1
            claimant.stats.duplicate += 1
            text = f"step {self.step} is already answered" if self.state is not State.ENDED else "the episode is over"
            return self.event(EventKind.DUPLICATE, text, controller)
        over = next((slot for slot in answered if self.done[slot]), None)
        if over is not None:
            text = f"the episode of slot {over} is over; reset it, or send None as its step"
            return self.rejected(text, controller)
        if not answered:
            return self.rejected("no slot is answered; send None as the step only of slots that pause", controller)
        try:
            self.commands.put(claimant, command, answered)
        except BadMessage as error:
            return self.rejected(str(error), controller)
        self._record_answer(claimant, answered, now_s)
        return self._delay_event(claimant, now_s)

    def _delay_event(self, claimant: ClaimHolder, now_s: float) -> Event | None:
        """Return the event of an accepted command that came after the deadline, or is the first after a missed one."""
        if claimant.transition(ControllerTrigger.ANSWER):
            return self.event(EventKind.CONNECTED, f"{claimant.name} answers again", claimant.name)
        if self._deadline_passed_s is not None and claimant.connected_at_s <= self._deadline_passed_s:
            self.counts.accepted_late += 1
            claimant.stats.accepted_late += 1
            text = f"accepted after the deadline of {self.deadline_s:g} s"
            return self._late_event(EventKind.ACCEPTED_LATE, text, claimant.name, now_s - self._deadline_passed_s)
        return None

    def _late(self, text: str, source: str, late_s: float | None) -> Event:
        self.counts.late += 1
        claimant = self.claims.by_name.get(source)
        if claimant is not None:
            claimant.stats.late += 1
        return self._late_event(EventKind.LATE, text, source, late_s)

    def _late_event(self, kind: EventKind, text: str, source: str, late_s: float | None) -> Event:
        event = self.event(kind, text, source)
        return event if late_s is None else event.model_copy(update={"late_s": late_s})

    def _answers_current_step(self, command: Command, answered: Sequence[int]) -> bool:
        if command.step == self.step and command.episode == self.episode:
            return True
        return len(command.step) == len(command.episode) == self.slots and all(
            (command.episode[slot], command.step[slot]) == (self.episode[slot], self.step[slot]) for slot in answered
        )

    def _wrong_step(self, controller: str, command: Command, answered: Sequence[int], now_s: float) -> Event:
        text = f"it answers episode {command.episode} step {command.step}; "
        text += f"the current ones are episode {self.episode} step {self.step}"
        if len(command.step) == len(command.episode) == self.slots:
            received = [(command.episode[slot], command.step[slot] or 0) for slot in answered]
            current = [(self.episode[slot], self.step[slot]) for slot in answered]
            if all(old <= new for old, new in zip(received, current, strict=True)):
                start_s = self._step_start(answered[0], received[0]) if received else None
                return self._late(text, controller, None if start_s is None else now_s - start_s)
        return self.rejected(text, controller)

    def _step_start(self, slot: int, at: tuple[int, int]) -> float | None:
        """Return when a slot stepped on from (episode, step); None if it never did or that is no longer recorded."""
        starts = (now for episode, step, now in reversed(self._step_starts) if (episode[slot], step[slot]) == at)
        return next(starts, None)

    def write(self, name: str, write: Write, elapsed_s: float) -> Event:
        """Accept or reject a write of one actuator, which takes effect in the next timestep."""
        if self.state in (State.ENDED, State.FAILED):
            return self.rejected(
                f"{name}: the episode is over, and a write has no effect; reset it first", write.source
            )
        try:
            index = self.commands.find(name, write)
        except BadMessage as error:
            return self.rejected(str(error), write.source)
        holder = self.claims.holder(write.priority, index)
        if holder is not None:
            return self.rejected(f"priority {write.priority} of {name!r} is claimed by {holder.name!r}", write.source)
        array, source_name = self.commands.array, write.source or ANONYMOUS
        if write.value is not None and not array.has_room(source_name, self.claims.sources):
            text = (
                f"{name}: {MAX_SOURCES} sources command actuators, which is the maximum; relinquish some values first"
            )
            return self.rejected(text, write.source)
        self.modified = self._all_modified
        source = array.source(source_name, self.claims.sources)
        return self.event(EventKind.WRITTEN, self.commands.write(index, write, source, elapsed_s), write.source)

    def expire(self, elapsed_s: float) -> list[Event]:
        """Relinquish written values that have expired."""
        expired = self.commands.expire(elapsed_s)
        if expired:
            self.modified = self._all_modified
        return [self.event(EventKind.EXPIRED, text, source) for text, source in expired]
