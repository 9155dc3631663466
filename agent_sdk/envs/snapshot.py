"""Snapshots: samples of an episode that an environment can return to."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

from zenoh import ZError

from zenostat.agent_sdk.envs.episode_state import EpisodeState
from zenostat.bridge.client.connection import Connection
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import BusError, InvalidConfig, RequestRejected
from zenostat.topics.messages import Manifest


@dataclass(slots=True)
class Snapshot:
    """A stopped copy of an environment's engines; `env.reset(options={"snapshot": snap})` returns to it.

    The node keeps an engine that waits at the sample; it costs the memory by which the episode has diverged from it
    since (`zenostat status` shows it). `close()`, the end of a `with` statement, or closing the environment frees it.

    Attributes:
        bus: The bus of the node.
        node, instance: Name and instance of the node that keeps it.
        name: Its name on that node.
        owner: Name of the controller that took it.
        sample: The sample at which it was taken.
        env_state: State of the environment: reward, limits, context.
        wrapper_states: State of each wrapper around the environment.
        closed: Whether it has been closed.
    """

    bus: Connection
    node: str
    instance: str
    name: str
    owner: str
    sample: SampleView
    env_state: dict[str, Any] = field(repr=False)
    wrapper_states: WeakKeyDictionary[Any, Any] = field(repr=False)
    closed: bool = False

    def check(self, manifest: Manifest) -> None:
        """Check that an environment on this node can return to it.

        Raises:
            InvalidConfig: It is closed, of another node, or its node was restarted since.
        """
        if self.closed:
            raise InvalidConfig(f"snapshot {self.name} of node {self.node!r} is closed; take another one")
        if self.node != manifest.node:
            raise InvalidConfig(
                f"snapshot {self.name} is of node {self.node!r}; this environment is on {manifest.node!r}"
            )
        if self.instance != manifest.instance:
            raise InvalidConfig(
                f"snapshot {self.name} is of another environment's node {self.node!r}, or was lost when that node was "
                "restarted; take one of this environment"
            )

    def close(self) -> None:
        """Free its memory; idempotent, also after the node has ended."""
        if not self.closed:
            self.closed = True
            # If the node has ended or the bus is closed, the snapshot is gone already.
            with suppress(BusError, RequestRejected, ZError):
                if self.bus.manifest(self.node).instance == self.instance:  # a restarted node may reuse the name
                    self.bus.drop(self.node, self.name, self.owner)

    def __enter__(self) -> Snapshot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def require_node(link: object) -> ControllerLink:
    """Return the link to a node that can fork; `InvalidConfig` for any other link, such as a fake building's."""
    if not isinstance(link, ControllerLink):
        raise InvalidConfig("this environment has no node; only an environment of a node has snapshots and branches")
    return link


def take(link: ControllerLink, sample: SampleView, state: EpisodeState[Any]) -> Snapshot:
    """Take a snapshot of a node at `sample`, with the state of its environment and of the wrappers around it.

    Raises:
        RequestRejected: No episode is running, the node is a branch, or has its maximum of snapshots and branches.
        ForkFailed: The system has no memory for a fork; the episode continues.
    """
    node, bus = link.manifest.node, link.bus
    name = bus.snapshot(node, link.name).snapshot
    saved = state.capture(), state.wrapper_states()
    return Snapshot(bus, node, link.manifest.instance, name, link.name, sample, *saved)


def from_options(options: Mapping[str, Any], manifest: Manifest, allowed: Collection[str] = ()) -> Snapshot | None:
    """Return the snapshot in the options of a reset, if there is one.

    Args:
        options: The options of `reset`.
        manifest: The manifest of the environment's node.
        allowed: Names of the other options.

    Raises:
        InvalidConfig: Unknown option, not a snapshot, or one that this environment cannot return to; or it is a branch.
    """
    if manifest.branch_of:
        raise InvalidConfig("a branch cannot be reset: it has no sample 0; close it and make another one")
    known = ("snapshot", *allowed)
    if unknown := sorted(set(options) - set(known)):
        raise InvalidConfig(f"unknown reset options {unknown}; available: {', '.join(map(repr, known))}")
    snapshot = options.get("snapshot")
    if snapshot is None:
        return None
    return checked(snapshot, manifest, "options['snapshot']")


def checked(snapshot: object, manifest: Manifest, label: str) -> Snapshot:
    """Return a snapshot to which an environment on this node can return.

    Raises:
        InvalidConfig: Not a snapshot, or one to which it cannot return; `label` names the argument.
    """
    if not isinstance(snapshot, Snapshot):
        raise InvalidConfig(f"{label} is {snapshot!r}; a result of env.unwrapped.snapshot() expected")
    snapshot.check(manifest)
    return snapshot
