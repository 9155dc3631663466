"""Who may command what: controllers' claims on actuators at priority levels. Rules without I/O.

A claim is on a level of some or all actuators. A level of an actuator has one holder; a second claim on it is
refused by name while the holder is present, and takes over once it has gone. What a claimant has set does not
outlive its claim.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bridge.exchange.latency import LatencyWindow
from bridge.exchange.priority_array import PriorityArray
from topics.errors import RequestRejected, did_you_mean
from topics.messages import Actuator, Claim

MAX_CLAIMS = 1000
"""Controllers that may have claimed something at a node at a time."""


@dataclass(slots=True)
class ControllerStats:
    """How a controller has done: its messages, the timesteps that went on without it, how fast it answers."""

    accepted: int = 0
    late: int = 0
    rejected: int = 0
    duplicate: int = 0
    missed: int = 0
    accepted_late: int = 0
    response: LatencyWindow = field(default_factory=LatencyWindow)


@dataclass(slots=True)
class ClaimHolder:
    """A controller's claim: its priority, its actuators, and its statistics.

    `bypassed`: it is disconnected, and the policy applies. `unresponsive`: it missed the deadline and has not answered
    since. `connected_at_s`, `disconnected_at_s`: when it claimed, and when it disconnected (wall time).
    """

    name: str
    priority: int
    mask: NDArray[np.bool_]
    required: bool
    source: int
    covers_all: bool
    stats: ControllerStats
    connected: bool = True
    bypassed: bool = False
    unresponsive: bool = False
    connected_at_s: float = 0.0
    disconnected_at_s: float = 0.0


class Claims:
    """The claims on one node's actuators.

    Args:
        actuators: in manifest order.
        array: where claimants' values stand, and are released.

    Attributes:
        by_name: controller to its claim.
    """

    def __init__(self, actuators: tuple[Actuator, ...], array: PriorityArray) -> None:
        self.by_name: dict[str, ClaimHolder] = {}
        self._actuators = actuators
        self._array = array
        self._index = {a.name: i for i, a in enumerate(actuators)}

    def claim(self, claim: Claim, now_s: float = 0.0) -> tuple[ClaimHolder, list[str]]:
        """Takes or renews a claim; also returns the absent controllers that it replaces.

        Raises:
            RequestRejected: unknown actuators, a priority that another connected controller has claimed, or too many
                claims.
        """
        allowed = self._select(claim.actuators)
        self._refuse_held(claim, allowed)
        replaced = [c.name for c in self.by_name.values() if self._replaces(claim, allowed, c)]
        if claim.controller not in self.by_name and len(self.by_name) - len(replaced) >= MAX_CLAIMS:
            raise RequestRejected(
                f"{MAX_CLAIMS} controllers have claimed something, which is the most; "
                "a reset of all slots forgets those that have gone"
            )
        for name in replaced:
            self._give_up(self.by_name.pop(name), kept=allowed)
        old = self.by_name.get(claim.controller)
        if old is not None:
            self._give_up(old, kept=allowed if old.priority == claim.priority else np.zeros_like(allowed))
        taken = self.by_name[claim.controller] = ClaimHolder(
            claim.controller,
            claim.priority,
            allowed,
            claim.required,
            self._array.source(claim.controller, self.sources),
            covers_all=bool(allowed.all()),
            stats=old.stats if old else ControllerStats(),
            connected_at_s=now_s,
        )
        return taken, replaced

    @property
    def sources(self) -> list[int]:
        """The claimants' places among the sources."""
        return [claimant.source for claimant in self.by_name.values()]

    def holder(self, priority: int, actuator: int) -> ClaimHolder | None:
        """Who has claimed a level of an actuator."""
        return next((c for c in self.by_name.values() if c.priority == priority and c.mask[actuator]), None)

    def begin_episode(self) -> None:
        """Forgets controllers that have gone; call it after the array was cleared."""
        self.by_name = {name: c for name, c in self.by_name.items() if c.connected}
        for claimant in self.by_name.values():
            claimant.source = self._array.source(claimant.name)
            claimant.unresponsive = False

    def relinquish(self, claimant: ClaimHolder) -> None:
        """Gives back what a claimant has set; it keeps its claim."""
        self._give_up(claimant, kept=np.zeros_like(claimant.mask))

    def _select(self, names: list[str] | None) -> NDArray[np.bool_]:
        allowed = np.full(len(self._actuators), names is None)
        for name in names or ():
            if name not in self._index:
                raise RequestRejected(f"no actuator {name!r}; {did_you_mean(name, self._index)}")
            allowed[self._index[name]] = True
        return allowed

    def _refuse_held(self, claim: Claim, allowed: NDArray[np.bool_]) -> None:
        for other in self.by_name.values():
            clash = other.mask & allowed
            if other.name != claim.controller and other.priority == claim.priority and other.connected and clash.any():
                which = self._actuators[int(np.flatnonzero(clash)[0])].name
                raise RequestRejected(
                    f"level {claim.priority} of {which!r} is claimed by {other.name!r}; "
                    "claim another level, or wait until it has left"
                )

    def _replaces(self, claim: Claim, allowed: NDArray[np.bool_], other: ClaimHolder) -> bool:
        # A building without actuators has controllers all the same: they set the pace.
        meets = bool((other.mask & allowed).any()) or not self._actuators
        return not other.connected and other.name != claim.controller and other.priority == claim.priority and meets

    def _give_up(self, claimant: ClaimHolder, kept: NDArray[np.bool_]) -> None:
        """Releases what a claimant has set, but for the actuators that the next claim on its level covers."""
        where = np.tile(claimant.mask & ~kept, (self._array.shape[0], 1))
        if where.any():
            self._array.put(claimant.priority, claimant.source, np.full(self._array.shape, np.nan), where)
