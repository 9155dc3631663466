"""The intake of the step exchange: commands and writes that are accepted or rejected."""

from __future__ import annotations

from collections.abc import Sequence

from zenostat.bridge.exchange.claims import ClaimHolder
from zenostat.bridge.exchange.priority_array import MAX_SOURCES
from zenostat.bridge.exchange.state import ExchangeState
from zenostat.bridge.exchange.transitions import ControllerTrigger
from zenostat.topics import codec
from zenostat.topics.errors import BadMessage
from zenostat.topics.messages import ANONYMOUS, Command, ControllerState, Event, EventKind, State, Write

MAX_MESSAGES_PER_STEP = 100
"""Largest number of messages of one controller that are processed in one step. Further ones are only accepted if the
step waits for them."""

RATE_LIMITED = f"more than {MAX_MESSAGES_PER_STEP} messages in one step; this one was not processed"
"""Text of the rejection of each further one."""

_MAX_AWAITED_BYTES = 1 << 10
"""Size of a command that is read beyond that number, apart from its values."""

_UNKNOWN_CONTROLLERS = ""  # no controller can have this name

_COMMAND_ENCODING = codec.encoding(Command)

# Access to an enum's member raises and catches an error in Python 3.11.
_WAITING, _CONNECTED = State.WAITING, ControllerState.CONNECTED


class Intake:
    """Accepts or rejects commands and writes.

    Args:
        exchange: the state of the exchange.
    """

    __slots__ = ("_exchange",)

    def __init__(self, exchange: ExchangeState) -> None:
        self._exchange = exchange

    def accept_fast(self, controller: str, payload: bytes, now_s: float, encoding: str = "") -> bool:
        """Accept a command on the fast path: of a connected controller, all actuators, the current step of all slots.

        Such a command is recognized by its first bytes and not decoded. For any other command, including one whose
        encoding names another class or version, return False; nothing is changed.
        """
        if encoding != _COMMAND_ENCODING and not codec.encoding_matches(Command, encoding):
            return False
        exchange, answers = self._exchange, self._exchange.answers
        head, size = answers.head, exchange.commands.size
        if head and controller in answers.pending and len(payload) == len(head) + size and payload.startswith(head):
            claimant, raw = exchange.claims.by_name[controller], payload[len(head) :]
            is_eligible = claimant.covers_all and claimant.state is _CONNECTED and exchange.state is _WAITING
            if is_eligible and exchange.commands.put_fast(claimant, raw):
                answers.record(claimant, exchange.all_slots, now_s)
                exchange.counts.accepted += 1
                return True
        return False

    def receive_command(self, controller: str, payload: bytes, now_s: float, encoding: str = "") -> Event | None:
        """Accept or reject the payload of any command; return an event unless it is a normal answer.

        Of each controller, only the first hundred such messages in a step are processed, and of the rest the first one
        that answers the step; the others are counted as rate limited and ignored. All controllers without a claim count
        as one.
        """
        if self.is_rate_limited(controller):
            return self.accept_awaited(controller, payload, now_s, encoding)[1]
        try:
            return self.command(controller, codec.decode(Command, payload, encoding), now_s)
        except BadMessage as error:
            return self._exchange.rejected(str(error), controller)

    def is_rate_limited(self, controller: str) -> bool:
        """Count a message of a controller; return whether there are too many in this step to process it."""
        exchange, counts = self._exchange, self._exchange.answers.message_counts
        sender = controller if controller in exchange.claims.by_name else _UNKNOWN_CONTROLLERS
        count = counts[sender] = counts.get(sender, 0) + 1
        if count <= MAX_MESSAGES_PER_STEP:
            return False
        exchange.counts.rate_limited += 1
        return True

    def accept_awaited(
        self, controller: str, payload: bytes, now_s: float, encoding: str = ""
    ) -> tuple[bool, Event | None]:
        """Accept a rate-limited command if it is a valid one for which the step waits, and else change nothing.

        Without it, a controller that has sent too many invalid ones could not go on, nor could anybody.

        Returns:
            Whether it is accepted; its event, unless it is a normal answer.
        """
        exchange = self._exchange
        if controller not in exchange.answers.pending or len(payload) > _MAX_AWAITED_BYTES + 2 * exchange.commands.size:
            return False, None
        claimant = exchange.claims.by_name[controller]
        try:
            command = codec.decode(Command, payload, encoding)
            answered = [slot for slot, step in enumerate(command.step) if step is not None]
            is_current = bool(answered) and self._answers_current_step(command, answered)
            if not is_current or any(exchange.done[slot] for slot in answered):
                return False, None
            exchange.commands.put(claimant, command, answered)
        except BadMessage:
            return False, None
        exchange.counts.rate_limited -= 1
        return True, self._accept(claimant, answered, now_s)

    def command(self, controller: str, command: Command, now_s: float) -> Event | None:
        """Accept or reject a command; return an event unless it is a normal answer."""
        exchange = self._exchange
        claimant = exchange.claims.by_name.get(controller)
        if claimant is None:
            return exchange.rejected(f"{controller!r} has claimed nothing; claim first", controller)
        answered = [slot for slot, step in enumerate(command.step) if step is not None]
        if not self._answers_current_step(command, answered):
            return self._wrong_step(controller, command, answered, now_s)
        if exchange.state in (State.FAILED, State.STARTING):
            return exchange.rejected(f"the node is {exchange.state}", controller)
        if exchange.state is not State.WAITING or controller in exchange.answers.controllers:
            exchange.counts.duplicate += 1
            claimant.stats.duplicate += 1
            is_over = exchange.state is State.ENDED
            text = "the episode is over" if is_over else f"step {exchange.step} is already answered"
            return exchange.event(EventKind.DUPLICATE, text, controller)
        over = next((slot for slot in answered if exchange.done[slot]), None)
        if over is not None:
            text = f"the episode of slot {over} is over; reset it, or send None as its step"
            return exchange.rejected(text, controller)
        if not answered:
            return exchange.rejected("no slot is answered; send None as the step only of slots that pause", controller)
        try:
            exchange.commands.put(claimant, command, answered)
        except BadMessage as error:
            return exchange.rejected(str(error), controller)
        return self._accept(claimant, answered, now_s)

    def _accept(self, claimant: ClaimHolder, answered: Sequence[int], now_s: float) -> Event | None:
        self._exchange.answers.record(claimant, answered, now_s)
        self._exchange.counts.accepted += 1
        return self._delay_event(claimant, now_s)

    def _delay_event(self, claimant: ClaimHolder, now_s: float) -> Event | None:
        """Return the event of an accepted command that came after the deadline, or is the first after a missed one."""
        exchange, passed_s = self._exchange, self._exchange.answers.deadline_passed_s
        if claimant.transition(ControllerTrigger.ANSWER):
            return exchange.event(EventKind.CONNECTED, f"{claimant.name} answers again", claimant.name)
        if passed_s is not None and claimant.connected_at_s <= passed_s:
            exchange.counts.accepted_late += 1
            claimant.stats.accepted_late += 1
            text = f"accepted after the deadline of {exchange.deadline_s:g} s"
            return self._late_event(EventKind.ACCEPTED_LATE, text, claimant.name, now_s - passed_s)
        return None

    def _late(self, text: str, source: str, late_s: float | None) -> Event:
        exchange = self._exchange
        exchange.counts.late += 1
        claimant = exchange.claims.by_name.get(source)
        if claimant is not None:
            claimant.stats.late += 1
        return self._late_event(EventKind.LATE, text, source, late_s)

    def _late_event(self, kind: EventKind, text: str, source: str, late_s: float | None) -> Event:
        event = self._exchange.event(kind, text, source)
        return event if late_s is None else event.model_copy(update={"late_s": late_s})

    def _answers_current_step(self, command: Command, answered: Sequence[int]) -> bool:
        exchange = self._exchange
        if command.step == exchange.step and command.episode == exchange.episode:
            return True
        return len(command.step) == len(command.episode) == exchange.slots and all(
            (command.episode[slot], command.step[slot]) == (exchange.episode[slot], exchange.step[slot])
            for slot in answered
        )

    def _wrong_step(self, controller: str, command: Command, answered: Sequence[int], now_s: float) -> Event:
        exchange = self._exchange
        text = f"it answers episode {command.episode} step {command.step}; "
        text += f"the current ones are episode {exchange.episode} step {exchange.step}"
        if len(command.step) == len(command.episode) == exchange.slots:
            received = [(command.episode[slot], command.step[slot] or 0) for slot in answered]
            current = [(exchange.episode[slot], exchange.step[slot]) for slot in answered]
            if all(old <= new for old, new in zip(received, current, strict=True)):
                start_s = self._step_start(answered[0], received[0]) if received else None
                return self._late(text, controller, None if start_s is None else now_s - start_s)
        return exchange.rejected(text, controller)

    def _step_start(self, slot: int, at: tuple[int, int]) -> float | None:
        """Return when a slot stepped on from (episode, step); None if it never did or that is no longer recorded."""
        starts = (
            now for episode, step, now in reversed(self._exchange.step_starts) if (episode[slot], step[slot]) == at
        )
        return next(starts, None)

    def write(self, name: str, write: Write, elapsed_s: float) -> Event:
        """Accept or reject a write of one actuator, which takes effect in the next timestep."""
        exchange = self._exchange
        if exchange.state in (State.ENDED, State.FAILED):
            return exchange.rejected(
                f"{name}: the episode is over, and a write has no effect; reset it first", write.source
            )
        try:
            index = exchange.commands.find(name, write)
        except BadMessage as error:
            return exchange.rejected(str(error), write.source)
        holder = exchange.claims.holder(write.priority, index)
        if holder is not None:
            return exchange.rejected(
                f"priority {write.priority} of {name!r} is claimed by {holder.name!r}", write.source
            )
        array, source_name = exchange.commands.array, write.source or ANONYMOUS
        if write.value is not None and not array.has_room(source_name, exchange.claims.sources):
            text = (
                f"{name}: {MAX_SOURCES} sources command actuators, which is the maximum; relinquish some values first"
            )
            return exchange.rejected(text, write.source)
        exchange.modified = exchange.all_modified
        source = array.source(source_name, exchange.claims.sources)
        return exchange.event(EventKind.WRITTEN, exchange.commands.write(index, write, source, elapsed_s), write.source)

    def expire(self, elapsed_s: float) -> list[Event]:
        """Relinquish written values that have expired."""
        exchange = self._exchange
        expired = exchange.commands.expire(elapsed_s)
        if expired:
            exchange.modified = exchange.all_modified
        return [exchange.event(EventKind.EXPIRED, text, source) for text, source in expired]
