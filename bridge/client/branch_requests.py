"""The part of the client of a bus that takes snapshots and creates branches."""

from __future__ import annotations

from abc import abstractmethod
from typing import TypeVar

from zenostat.topics import keys
from zenostat.topics.messages import (
    Ack,
    BranchCreated,
    CreateBranch,
    DropSnapshot,
    Message,
    PlanSimulated,
    SimulatePlan,
    SnapshotTaken,
    TakeSnapshot,
)

M = TypeVar("M", bound=Message)


class BranchRequests:
    """Base class of `Bus`: requests about snapshots, branches and plans of a node."""

    def snapshot(self, node: str, controller: str = "") -> SnapshotTaken:
        """Take a snapshot of a node, to return to with a `Reset`; the node drops it when `controller` disconnects.

        Raises:
            RequestRejected: No episode is running, or the node has its maximum of snapshots and branches.
            ForkFailed: The system cannot fork the engine.
        """
        return self._ask(keys.SNAPSHOT, node, TakeSnapshot(controller=controller), SnapshotTaken)

    def drop(self, node: str, snapshot: str) -> None:
        """Drop a snapshot and free its memory; `RequestRejected` if the node has none of that name."""
        self._ask(keys.DROP, node, DropSnapshot(snapshot=snapshot), Ack)

    def branch(self, node: str, branch: CreateBranch) -> str:
        """Create a branch of a node and return the branch's name; a branch is a node like any other.

        Raises:
            RequestRejected, ForkFailed: As for `snapshot`; a branch cannot have branches.
        """
        return self._ask(keys.BRANCH, node, branch, BranchCreated).node

    def plan(self, branch: str, plan: SimulatePlan) -> PlanSimulated:
        """Let a branch simulate several timesteps, and return their samples.

        Raises:
            RequestRejected: It is not a branch in lockstep, or a command is not valid; nothing was simulated.
            SimulatorError: The simulator failed.
        """
        return self._ask(keys.PLAN, branch, plan, PlanSimulated)

    @abstractmethod
    def _ask(self, topic: keys.Topic, node: str, request: Message | None, reply_type: type[M], *, name: str = "") -> M:
        """Send a request and wait for the reply."""
