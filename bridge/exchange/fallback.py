"""The fallback policy of the step exchange: disconnected controllers, their return, and missed deadlines."""

from __future__ import annotations

from zenostat.bridge.exchange.claims import ClaimHolder
from zenostat.bridge.exchange.state import ExchangeState
from zenostat.bridge.exchange.transitions import ControllerTrigger
from zenostat.topics.errors import EpisodeAborted
from zenostat.topics.messages import ControllerState, Event, EventKind, Mode, Policy, State

_BYPASSED = ControllerState.BYPASSED

DISCONNECTED = "disconnected"
"""Reason in the event of a fallback after the grace period, as opposed to one after a deadline."""

RECONNECTED = "is on the bus again, with its claim"
"""What the event of a reconnection says of a controller, as opposed to those of claims and answers."""


class FallbackRules:
    """Applies the fallback policy when controllers disconnect, return or miss the deadline.

    Args:
        exchange: its state.
    """

    __slots__ = ("_exchange",)

    def __init__(self, exchange: ExchangeState) -> None:
        self._exchange = exchange

    def on_disconnect(self, name: str, now_s: float) -> list[Event]:
        """Handle a controller's disconnection; it keeps its claim."""
        exchange = self._exchange
        claimant = exchange.claims.by_name.get(name)
        if claimant is None or not claimant.state.is_connected:
            return []
        claimant.transition(ControllerTrigger.DISCONNECT)
        claimant.disconnected_at_s = now_s
        waits = claimant.required and exchange.mode is Mode.LOCKSTEP and exchange.policy is Policy.WAIT
        text = f"{name} disconnected{'; the node waits for it' if waits else ''}"
        return [exchange.event(EventKind.DISCONNECTED, text, name)]

    def on_reconnect(self, name: str, now_s: float) -> list[Event]:
        """Handle the return of a disconnected controller whose claim nobody has replaced."""
        exchange = self._exchange
        claimant = exchange.claims.by_name.get(name)
        if claimant is None or claimant.state.is_connected:
            return []
        claimant.transition(ControllerTrigger.RECONNECT)
        claimant.connected_at_s = now_s
        if name not in exchange.answers.controllers:
            exchange.await_answer(claimant)
        return [exchange.event(EventKind.CONNECTED, f"{name} {RECONNECTED}", name)]

    def bypass(self, name: str, now_s: float, grace_s: float = 0.0) -> list[Event]:
        """Apply the policy to a controller that has been disconnected for the grace period.

        Nothing happens if it has reconnected; another disconnection starts another grace period.

        Raises:
            EpisodeAborted: the policy is to abort.
        """
        exchange, answers = self._exchange, self._exchange.answers
        claimant = exchange.claims.by_name.get(name)
        if claimant is None or claimant.state.is_connected or claimant.state is _BYPASSED:
            return []
        if exchange.policy is Policy.WAIT or now_s - claimant.disconnected_at_s < grace_s:
            return []
        is_active = exchange.state in (State.WAITING, State.RUNNING)
        if exchange.policy is Policy.ABORT and claimant.required and is_active:
            raise EpisodeAborted(f"{name} disconnected, and the policy is to abort the episode")
        claimant.transition(ControllerTrigger.BYPASS)
        answers.needs_fallback = answers.needs_fallback or claimant.required
        if exchange.policy is Policy.RELINQUISH:
            answers.controllers.pop(name, None)  # its answer to the current sample is relinquished as well
        if exchange.deadline_s is None or any(c.state is not _BYPASSED for c in exchange.claims.required):
            answers.pending.discard(name)
        event = self._fall_back(claimant, DISCONNECTED)
        return [event] if is_active else []

    def on_deadline(self, now_s: float) -> list[Event]:
        """Apply the policy to the controllers that have not answered by the deadline of the current step.

        Raises:
            EpisodeAborted: the policy is to abort.
        """
        exchange, answers = self._exchange, self._exchange.answers
        if exchange.state is not State.WAITING or not answers.pending:
            return []
        answers.pass_deadline(now_s)
        if exchange.policy is Policy.WAIT:
            return []
        names = ", ".join(exchange.awaiting())
        if exchange.policy is Policy.ABORT:
            raise EpisodeAborted(f"{names} sent no command within {exchange.deadline_s:g} s")
        events = []
        for name in exchange.awaiting():
            claimant = exchange.claims.by_name[name]
            if claimant.transition(ControllerTrigger.DEADLINE):
                events.append(self._fall_back(claimant, f"sent no command within {exchange.deadline_s:g} s"))
        answers.end_wait(exchange.all_slots)
        return events

    def _fall_back(self, claimant: ClaimHolder, reason: str) -> Event:
        exchange = self._exchange
        if exchange.policy is Policy.RELINQUISH:
            exchange.claims.relinquish(claimant)
            outcome = "its commands are relinquished"
        else:
            outcome = "its last commands stay in effect"
        return exchange.event(EventKind.FALLBACK, f"{claimant.name} {reason}; {outcome}", claimant.name)
