"""The answers of controllers to the current sample."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain

from zenostat.bridge.exchange.claims import ClaimHolder
from zenostat.topics.messages import ControllerState

# Access to an enum's member raises and catches an error in Python 3.11.
_BYPASSED = ControllerState.BYPASSED


@dataclass(slots=True)
class Answers:
    """The answers of controllers to the current sample.

    Attributes:
        pending: the required controllers for which the next timestep waits.
        controllers: the controllers that have answered, and the slots to which those that are required did.
        slots: the slots that required controllers have answered.
        head: the first bytes of a command on the fast path (empty: each command is decoded).
        opened_s: wall time from which response times count.
        deadline_passed_s: wall time at which the deadline passed (None: it has not).
        needs_fallback: whether a required controller's command may be missing from the next timestep.
        message_counts: number of messages of each controller, apart from those on the fast path.
    """

    pending: set[str] = field(default_factory=set)
    controllers: dict[str, Iterable[int]] = field(default_factory=dict)
    slots: set[int] = field(default_factory=set)
    head: bytes = b""
    opened_s: float = 0.0
    deadline_passed_s: float | None = None
    needs_fallback: bool = False
    message_counts: dict[str, int] = field(default_factory=dict)

    def open(self, required: Sequence[ClaimHolder], deadline_s: float | None, head: bytes, now_s: float) -> None:
        """Prepare for answers to another sample."""
        pending = {claimant.name for claimant in required if claimant.state is not _BYPASSED}
        self.needs_fallback = len(pending) < len(required)
        if not pending and deadline_s is not None:
            # No required controller is connected: the deadline sets the pace.
            pending = {claimant.name for claimant in required}
        self.pending = pending
        self.opened_s, self.deadline_passed_s = now_s, None
        if self.message_counts:
            self.message_counts = {}
        self.controllers = {}
        self.slots = set()
        self.head = head

    def record(self, claimant: ClaimHolder, slots: Iterable[int], now_s: float) -> None:
        """Record an accepted command and its response time."""
        name, stats = claimant.name, claimant.stats
        if claimant.required:
            self.slots.update(slots)
        stats.accepted += 1
        opened_s, connected_s = self.opened_s, claimant.connected_at_s
        stats.response.add(now_s - (opened_s if opened_s > connected_s else connected_s))
        self.pending.discard(name)
        self.controllers[name] = slots if claimant.required else ()

    def forget(self, controller: str) -> None:
        """Forget a controller's answer, and do not wait for one."""
        self.pending.discard(controller)
        if self.controllers.pop(controller, None) is not None:
            self.slots = set(chain.from_iterable(self.controllers.values()))

    def pass_deadline(self, now_s: float) -> None:
        """Record that the deadline has passed; from now on each command is decoded."""
        self.head = b""
        if self.deadline_passed_s is None:
            self.deadline_passed_s = now_s

    def end_wait(self, slots: Iterable[int]) -> None:
        """Let these slots step without the pending answers."""
        self.pending.clear()
        self.slots = set(slots)
        self.needs_fallback = True
