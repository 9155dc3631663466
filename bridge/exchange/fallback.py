"""Fallback policy of the step exchange: what happens without a controller that is waited for."""

from __future__ import annotations

from dataclasses import dataclass

from bridge.exchange.claims import ClaimHolder
from bridge.exchange.state import ExchangeState
from topics.errors import EpisodeAborted
from topics.messages import Event, EventKind, Mode, Policy, State


@dataclass(slots=True)
class FallbackRules(ExchangeState):
    """What happens when controllers leave or miss the deadline."""

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
