"""Counters and callbacks of a gateway's client of a node."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from zenostat.bridge.client.sample import SampleView
from zenostat.topics.messages import Event, Manifest


@dataclass(slots=True)
class Counts:
    """Numbers of messages between a gateway and its node.

    Attributes:
        samples: samples received.
        missed: messages dropped because the gateway lagged by more than 4,096 of them.
        writes: accepted writes.
        rejected: rejected writes and requests.
    """

    samples: int = 0
    missed: int = 0
    writes: int = 0
    rejected: int = 0


@dataclass(slots=True)
class Listeners:
    """Functions that are called in the loop's thread; they must not block.

    Attributes:
        samples: called with each sample.
        events: called with each event of the node.
        presence: called with whether the node is on the bus, at each change.
        manifests: called with each new manifest: that of another instance of the node, or of changed settings.
    """

    samples: list[Callable[[SampleView], None]] = field(default_factory=list)
    events: list[Callable[[Event], None]] = field(default_factory=list)
    presence: list[Callable[[bool], None]] = field(default_factory=list)
    manifests: list[Callable[[Manifest], None]] = field(default_factory=list)
