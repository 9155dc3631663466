"""A place in an episode to go back to."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

from zenoh import ZError

from agent_sdk.bus.bus import Bus
from agent_sdk.bus.controller_link import ControllerLink
from agent_sdk.bus.sample import SampleView
from agent_sdk.envs.episode_state import EpisodeState
from topics.errors import BusError, InvalidConfig, RequestRejected
from topics.messages import Manifest


@dataclass(slots=True)
class Snapshot:
    """Where an environment stood: `env.reset(options={"snapshot": snap})` goes back there.

    The node keeps an engine that waits at that sample; it costs the memory by which the episode has diverged from it
    since (`zenostat status` shows it). `close()`, or the end of a `with`, gives it back; so does the environment's end.

    Attributes:
        node, instance: whose it is.
        name: what it is called there.
        sample: the one at which it stands.
    """

    bus: Bus
    node: str
    instance: str
    name: str
    sample: SampleView
    env_state: dict[str, Any] = field(repr=False)
    wrapper_states: WeakKeyDictionary[Any, Any] = field(repr=False)
    closed: bool = False

    def check(self, manifest: Manifest) -> None:
        """Whether an environment on this node can go back to it.

        Raises:
            InvalidConfig: it is closed, of another node, or its node has started again since.
        """
        if self.closed:
            raise InvalidConfig(f"snapshot {self.name} of node {self.node!r} is closed; take another one")
        if self.node != manifest.node:
            raise InvalidConfig(
                f"snapshot {self.name} is of node {self.node!r}; this environment is on {manifest.node!r}"
            )
        if self.instance != manifest.instance:
            raise InvalidConfig(
                f"snapshot {self.name} went with the node {self.node!r} that it was of, which has started again since; "
                "take another one"
            )

    def close(self) -> None:
        """Gives its memory back; twice is fine, and so is after the node's end."""
        if not self.closed:
            self.closed = True
            with suppress(
                BusError, RequestRejected, ZError
            ):  # the node or the bus has ended, and its snapshots with it
                if self.bus.manifest(self.node).instance == self.instance:  # another's may have the same name
                    self.bus.drop(self.node, self.name)

    def __enter__(self) -> Snapshot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def forking(link: object) -> ControllerLink:
    """The hold on a node that can fork; `InvalidConfig` if it is none, as of a fake building."""
    if not isinstance(link, ControllerLink):
        raise InvalidConfig("this environment has no node: nothing that could be forked")
    return link


def take(link: ControllerLink, sample: SampleView, memory: EpisodeState[Any]) -> Snapshot:
    """Keeps where a node stands, at `sample`, and the memory of its environment and of the wrappers around it.

    Raises:
        RequestRejected: no episode is running, the node has its maximum of snapshots and branches, or it is one.
        ForkFailed: the system has no memory for a fork; the episode goes on.
    """
    node, bus = link.manifest.node, link.bus
    name = bus.snapshot(node, link.name).snapshot
    return Snapshot(bus, node, link.manifest.instance, name, sample, memory.state(), memory.wrapper_states())


def asked_for(options: Mapping[str, Any], manifest: Manifest, others: Collection[str] = ()) -> Snapshot | None:
    """The snapshot that the options of a reset name, if they name one.

    Args:
        options: of `reset`.
        manifest: of the environment's node.
        others: what else the options may name.

    Raises:
        InvalidConfig: an unknown option; no snapshot, or one that this environment cannot go back to.
    """
    known = ("snapshot", *others)
    if unknown := sorted(set(options) - set(known)):
        raise InvalidConfig(f"unknown reset options {unknown}; there is: {', '.join(map(repr, known))}")
    snapshot = options.get("snapshot")
    if snapshot is None:
        return None
    if not isinstance(snapshot, Snapshot):
        raise InvalidConfig(f"options['snapshot'] is {snapshot!r}; what env.unwrapped.snapshot() gave is expected")
    snapshot.check(manifest)
    return snapshot
