"""The exchange of a trial: timesteps from the present sample under other commands, which nobody else notices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zenostat.bridge.exchange.claims import ClaimHolder, ControllerStats
from zenostat.bridge.exchange.priority_array import MAX_SOURCES
from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.bridge.exchange.transitions import ControllerTrigger
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import Command, ControllerState

_BYPASSED = ControllerState.BYPASSED


class TrialExchange:
    """Decides the timesteps of one alternative exactly as the node's exchange would.

    Values of other controllers and of operators stay in effect. Controllers that have not answered yet count as having
    kept their values; the fallback policy has been applied to those that are bypassed.

    Args:
        origin: the node's exchange, at a sample that can be answered; it is only read.
        sender: name of who tries.
        priority: of a sender without a claim, which may command all actuators.

    Attributes:
        exchange: at the sample that the trial has reached.

    Raises:
        RequestRejected: too many sources command actuators already.
    """

    def __init__(self, origin: StepExchange, sender: str, priority: int) -> None:
        self.exchange = exchange = origin.copy()
        claims, array = exchange.claims, exchange.commands.array
        holder = claims.by_name.get(sender)
        if holder is None:
            if not array.has_room(sender, claims.sources):
                raise RequestRejected(f"{MAX_SOURCES} sources command actuators, which is the maximum")
            mask = np.ones(len(exchange.actuators), np.bool_)
            source = array.source(sender, claims.sources)
            holder = ClaimHolder(sender, priority, mask, False, source, True, ControllerStats())  # noqa: FBT003
        self._holder = holder

    def check(self, command: Command) -> None:
        """Raise `BadMessage` if `begin_step` would; nothing is changed."""
        self.exchange.commands.check(self._holder, command)

    def command(self, values: bytes, operations: bytes | None) -> Command:
        """Return the command that answers the present sample in all slots."""
        return Command(episode=self.exchange.episode, step=[*self.exchange.step], operations=operations, values=values)

    def begin_step(self, command: Command, step_s: float) -> bytes:
        """Accept a command and begin a timestep.

        Args:
            command: of the sender.
            step_s: length of a timestep, s.

        Returns:
            What the plant receives, without injected faults: float64, shape (slots, actuators), NaN: relinquished.

        Raises:
            BadMessage: the command is not valid; nothing is changed.
        """
        exchange, holder = self.exchange, self._holder
        exchange.commands.put(holder, command, exchange.all_slots)
        if holder.name in exchange.claims.by_name:
            holder.transition(ControllerTrigger.ANSWER)
        answers = exchange.answers
        answers.controllers |= {c.name: () for c in exchange.claims.required if c.state is not _BYPASSED}
        answers.controllers[holder.name] = ()
        answers.slots = set(exchange.all_slots)
        if exchange.commands.has_expiries:
            exchange.intake.expire(exchange.commands.timesteps * step_s)
        return exchange.begin_step(0.0)

    def finish_step(self, last: Sequence[bool]) -> None:
        """Finish a timestep; `last`: of each slot, whether it was its last one."""
        self.exchange.finish_step(last, 0.0)
