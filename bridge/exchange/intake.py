"""Intake of the step exchange: which commands and writes are accepted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bridge.exchange.claims import ClaimHolder
from bridge.exchange.priority_array import MAX_SOURCES
from bridge.exchange.state import ExchangeState
from topics import codec
from topics.errors import BadMessage
from topics.messages import ANONYMOUS, Command, Event, EventKind, State, Write

MAX_MESSAGES_PER_STEP = 100
"""Messages of one controller in one step that are looked at, besides its usual commands."""

_UNKNOWN_CONTROLLERS = ""  # no controller can have this name

_COMMAND_ENCODING = codec.encoding(Command)

# Python 3.11 looks at an enum's member by raising and catching an error.
_WAITING = State.WAITING


@dataclass(slots=True)
class Intake(ExchangeState):
    """Accepts and rejects commands and writes."""

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
