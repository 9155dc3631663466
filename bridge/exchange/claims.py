"""Claims: the exclusive rights of controllers to command actuators at a priority. No I/O.

A claim covers some or all actuators at one priority. Each priority of an actuator has at most one holder. A second
claim on it is rejected while the holder is connected, and replaces the holder's claim once it is disconnected. Values
that a controller has set are relinquished when its claim ends.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from zenostat.bridge.exchange.latency import LatencyWindow
from zenostat.bridge.exchange.priority_array import PriorityArray
from zenostat.bridge.exchange.transitions import CONTROLLER_TRANSITIONS, ControllerTrigger, IllegalTransition
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import Actuator, Claim, ControllerState
from zenostat.topics.points import PointIndex

MAX_CLAIMS = 1000
"""Largest number of controllers that have a claim on a node at the same time."""


@dataclass(slots=True)
class ControllerStats:
    """Statistics of a controller: its messages, timesteps simulated without its command, response times."""

    accepted: int = 0
    late: int = 0
    rejected: int = 0
    duplicate: int = 0
    missed: int = 0
    accepted_late: int = 0
    response: LatencyWindow = field(default_factory=LatencyWindow)


@dataclass(slots=True)
class ClaimHolder:
    """A controller's claim: its priority, its actuators, its state and its statistics.

    `mask`: of each actuator, whether it is claimed. `covers_all`: whether all are. `source`: index of its name among
    the sources. `connected_at_s`, `disconnected_at_s`: wall times of its claim and its disconnection. `inherited`:
    names of the controllers whose claims it has replaced, since it keeps their values until it sets others.
    """

    name: str
    priority: int
    mask: NDArray[np.bool_]
    required: bool
    source: int
    covers_all: bool
    stats: ControllerStats
    state: ControllerState = ControllerState.CONNECTED
    connected_at_s: float = 0.0
    disconnected_at_s: float = 0.0
    inherited: frozenset[str] = frozenset()

    def transition(self, trigger: ControllerTrigger) -> bool:
        """Change the state according to the table of transitions; return whether it is another one.

        Raises:
            IllegalTransition: the trigger is not allowed in the current state.
        """
        previous = self.state
        try:
            self.state = CONTROLLER_TRANSITIONS[previous, trigger]
        except KeyError:
            raise IllegalTransition(f"{trigger!r} is not allowed in state {previous!r} of {self.name!r}") from None
        return self.state is not previous


class Claims:
    """The claims on one node's actuators.

    Args:
        actuators: in manifest order.
        array: the values that the controllers have set.
        connected: as in the manifest.

    Attributes:
        by_name: the claims by controller.
        required: those of the controllers that the node waits for in lockstep.
    """

    def __init__(self, actuators: tuple[Actuator, ...], array: PriorityArray, connected: Mapping[str, str]) -> None:
        self.by_name: dict[str, ClaimHolder] = {}
        self.required: list[ClaimHolder] = []
        self._actuators = actuators
        self._array = array
        self._index = PointIndex((a.name for a in actuators), "actuator", RequestRejected, connected)

    def claim(self, claim: Claim, now_s: float) -> tuple[ClaimHolder, list[str]]:
        """Add or renew a claim; also return the disconnected controllers whose claims it replaces.

        Raises:
            RequestRejected: unknown actuators, a priority that another connected controller has claimed, or too many
                claims.
        """
        mask = self._select(claim.actuators)
        self._check_conflicts(claim, mask)
        replaced = [c.name for c in self.by_name.values() if self._replaces(claim, mask, c)]
        if claim.controller not in self.by_name and len(self.by_name) - len(replaced) >= MAX_CLAIMS:
            raise RequestRejected(
                f"{MAX_CLAIMS} controllers have a claim, which is the maximum; "
                "a reset of all slots drops the claims of disconnected ones"
            )
        inherited = frozenset(replaced)
        for name in replaced:
            former = self.by_name.pop(name)
            self._relinquish(former, except_for=mask)
            inherited |= former.inherited
        old = self.by_name.get(claim.controller)
        if old is not None:
            self._relinquish(old, except_for=mask if old.priority == claim.priority else np.zeros_like(mask))
        holder = self.by_name[claim.controller] = ClaimHolder(
            claim.controller,
            claim.priority,
            mask,
            claim.required,
            self._array.source(claim.controller, self.sources),
            covers_all=bool(mask.all()),
            stats=old.stats if old else ControllerStats(),
            connected_at_s=now_s,
            inherited=inherited | old.inherited if old else inherited,
        )
        self._list_required()
        return holder, replaced

    def messages(self) -> list[Claim]:
        """Return the messages that claim the same, in the order of the claims."""
        names = [actuator.name for actuator in self._actuators]
        return [
            Claim(
                controller=holder.name,
                priority=holder.priority,
                actuators=None if holder.covers_all else [names[index] for index in np.flatnonzero(holder.mask)],
                required=holder.required,
            )
            for holder in self.by_name.values()
        ]

    def restore(self, other: Claims) -> None:
        """Copy the claims of another node with the same actuators, without their statistics."""
        self.by_name = {name: replace(claimant, stats=ControllerStats()) for name, claimant in other.by_name.items()}
        self._list_required()

    @property
    def sources(self) -> list[int]:
        """The indices of the controllers' names among the sources, and of those whose values they keep."""
        return [index for claimant in self.by_name.values() for index in self._sources_of(claimant)]

    def _sources_of(self, claimant: ClaimHolder) -> list[int]:
        names = self._array.names
        return [claimant.source, *(names.index(name) for name in claimant.inherited if name in names)]

    def holder(self, priority: int, actuator: int) -> ClaimHolder | None:
        """Return the controller that has claimed a priority of an actuator."""
        return next((c for c in self.by_name.values() if c.priority == priority and c.mask[actuator]), None)

    def begin_episode(self) -> None:
        """Drop the claims of disconnected controllers; those of the others have the sources of the present array."""
        self.by_name = {name: c for name, c in self.by_name.items() if c.state.is_connected}
        self._list_required()
        for claimant in self.by_name.values():
            claimant.source, claimant.inherited = self._array.source(claimant.name), frozenset()
            claimant.transition(ControllerTrigger.RESET)

    def copies(self) -> tuple[ClaimHolder, ...]:
        """Return copies of the claims, for a snapshot of the values that are in effect."""
        return tuple(replace(claimant) for claimant in self.by_name.values())

    def return_to(self, formers: Collection[ClaimHolder]) -> None:
        """Begin an episode at a snapshot, whose values the array has again.

        Values of a controller that had a claim then stay where somebody has a claim at its priority, who answers for
        them from now on; the others are relinquished.

        Args:
            formers: copies of the claims at the snapshot.
        """
        self.begin_episode()
        for former in formers:
            kept = np.zeros_like(former.mask)
            for claimant in self.by_name.values():
                if claimant.priority == former.priority:
                    kept |= claimant.mask
                    claimant.inherited |= (former.inherited | {former.name}) - {claimant.name}
            self._relinquish(former, except_for=kept)

    def remove(self, controller: str) -> None:
        """End a controller's claim and relinquish the values that it has set."""
        self.relinquish(self.by_name.pop(controller))
        self._list_required()

    def _list_required(self) -> None:
        self.required = [claimant for claimant in self.by_name.values() if claimant.required]

    def relinquish(self, claimant: ClaimHolder) -> None:
        """Relinquish the values that a controller has set; it keeps its claim."""
        self._relinquish(claimant, except_for=np.zeros_like(claimant.mask))

    def _select(self, names: list[str] | None) -> NDArray[np.bool_]:
        mask = np.full(len(self._actuators), names is None)
        for name in names or ():
            mask[self._index[name]] = True
        return mask

    def _check_conflicts(self, claim: Claim, mask: NDArray[np.bool_]) -> None:
        for holder in self.by_name.values():
            overlap = holder.mask & mask
            if (
                holder.name != claim.controller
                and holder.priority == claim.priority
                and holder.state.is_connected
                and overlap.any()
            ):
                actuator = self._actuators[int(np.flatnonzero(overlap)[0])].name
                raise RequestRejected(
                    f"priority {claim.priority} of {actuator!r} is claimed by {holder.name!r}; "
                    "claim another priority, or wait until it disconnects"
                )

    def _replaces(self, claim: Claim, mask: NDArray[np.bool_], holder: ClaimHolder) -> bool:
        # Without actuators there are no conflicts, but controllers still set the pace.
        overlaps = bool((holder.mask & mask).any()) or not self._actuators
        is_other = holder.name != claim.controller
        return is_other and not holder.state.is_connected and holder.priority == claim.priority and overlaps

    def _relinquish(self, claimant: ClaimHolder, except_for: NDArray[np.bool_]) -> None:
        """Relinquish the values that a controller has set, except for actuators that the next claim covers.

        What others have written at its priority stays.
        """
        self._array.relinquish(claimant.priority, self._sources_of(claimant), claimant.mask & ~except_for)
