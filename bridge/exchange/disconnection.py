"""The fallback policy of the step exchange: disconnected controllers and missed deadlines."""

from __future__ import annotations

from dataclasses import dataclass

from zenostat.bridge.exchange.claims import ClaimHolder
from zenostat.bridge.exchange.state import ExchangeState
from zenostat.bridge.exchange.transitions import ControllerTrigger
from zenostat.topics.errors import EpisodeAborted
from zenostat.topics.messages import ControllerState, Event, EventKind, Mode, Policy, State

_BYPASSED = ControllerState.BYPASSED


@dataclass(slots=True)
class FallbackRules(ExchangeState):
    """Applies the fallback policy when controllers disconnect or miss the deadline."""

    def on_disconnect(self, name: str, now_s: float) -> list[Event]:
        """Handle a controller's disconnection; it keeps its claim."""
        claimant = self.claims.by_name.get(name)
        if claimant is None or not claimant.state.is_connected:
            return []
        claimant.transition(ControllerTrigger.DISCONNECT)
        claimant.disconnected_at_s = now_s
        waits = claimant.required and self.mode is Mode.LOCKSTEP and self.policy is Policy.WAIT
        text = f"{name} disconnected{'; the node waits for it' if waits else ''}"
        return [self.event(EventKind.DISCONNECTED, text, name)]

    def bypass(self, name: str, now_s: float, grace_s: float = 0.0) -> list[Event]:
        """Apply the policy to a controller that has been disconnected for the grace period.

        Nothing happens if it has reconnected; another disconnection starts another grace period.

        Raises:
            EpisodeAborted: the policy is to abort.
        """
        claimant = self.claims.by_name.get(name)
        if claimant is None or claimant.state.is_connected or claimant.state is _BYPASSED:
            return []
        if self.policy is Policy.WAIT or now_s - claimant.disconnected_at_s < grace_s:
            return []
        is_active = self.state in (State.WAITING, State.RUNNING)
        if self.policy is Policy.ABORT and claimant.required and is_active:
            raise EpisodeAborted(f"{name} disconnected, and the policy is to abort the episode")
        claimant.transition(ControllerTrigger.BYPASS)
        self._needs_fallback = self._needs_fallback or claimant.required
        if self.policy is Policy.RELINQUISH:
            self._answered.discard(name)  # its answer to the current sample is relinquished as well
        if self.deadline_s is None or any(c.state is not _BYPASSED for c in self.claims.required):
            self._pending.discard(name)
        event = self._fall_back(claimant, "disconnected")
        return [event] if is_active else []

    def on_deadline(self, now_s: float) -> list[Event]:
        """Apply the policy to the controllers that have not answered by the deadline of the current step.

        Raises:
            EpisodeAborted: the policy is to abort.
        """
        if self.state is not State.WAITING or not self._pending:
            return []
        self._head = b""
        if self._deadline_passed_s is None:
            self._deadline_passed_s = now_s
        if self.policy is Policy.WAIT:
            return []
        names = ", ".join(self.awaiting())
        if self.policy is Policy.ABORT:
            raise EpisodeAborted(f"{names} sent no command within {self.deadline_s:g} s")
        events = []
        for name in self.awaiting():
            claimant = self.claims.by_name[name]
            if claimant.transition(ControllerTrigger.DEADLINE):
                events.append(self._fall_back(claimant, f"sent no command within {self.deadline_s:g} s"))
        self._pending.clear()
        self._answered_slots = set(self._all_slots)
        self._needs_fallback = True
        return events

    def _fall_back(self, claimant: ClaimHolder, reason: str) -> Event:
        if self.policy is Policy.RELINQUISH:
            self.claims.relinquish(claimant)
            outcome = "its commands are relinquished"
        else:
            outcome = "its last commands stay in effect"
        return self.event(EventKind.FALLBACK, f"{claimant.name} {reason}; {outcome}", claimant.name)
