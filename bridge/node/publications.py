"""Publishers of a node server: its manifest, samples, events and single points."""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import zenoh
from zenoh import CongestionControl, Priority

from zenostat.bridge.node.batching import SampleBatcher
from zenostat.bridge.node.point_publications import PointPublications
from zenostat.bridge.recording.channels import EVENTS, MANIFESTS
from zenostat.bridge.runtime.timer import Timer
from zenostat.topics import codec, keys
from zenostat.topics.messages import REJECTIONS, Event, EventKind, Manifest

if TYPE_CHECKING:
    from zenostat.bridge.recording.recorder import Recorder

EVENTS_A_STEP = 20
"""Refusals per step that are published as events: for each controller with a claim, and for all other senders together;
further ones are only counted and recorded."""

WRITTEN_A_STEP = 1000
"""Accepted writes per step that are published as events; the queues of subscribers are bounded."""

_MANIFEST, _SAMPLE, _EVENT = keys.MANIFEST.key, keys.SAMPLE.key, keys.EVENT.key


def _qos(topic: keys.Topic) -> dict[str, Any]:
    """Return how the messages of a topic are sent."""
    drop = topic.delivery is keys.Delivery.DROP
    return {
        "encoding": zenoh.Encoding(codec.encoding(topic.message)) if topic.message else None,
        "congestion_control": CongestionControl.DROP if drop else CongestionControl.BLOCK,
        # Each priority has a queue of its own: a large message of another program does not displace a sample.
        "priority": Priority.INTERACTIVE_HIGH if keys.is_streamed(topic) else Priority.DATA,
    }


class Publications:
    """The publishers of a server; `with Publications(session, manifest, timer) as publications`.

    It publishes the manifest when it is created.

    Attributes:
        points: the publishers of single points.
        recorder: records the manifests that are published, and all events.
    """

    def __init__(self, session: zenoh.Session, manifest: Manifest, timer: Timer) -> None:
        self._session = session
        self._node = manifest.node
        self.recorder: Recorder | None = None
        self._close = ExitStack()
        self._refused: Counter[str] = Counter()
        self._written_left = WRITTEN_A_STEP
        self._put_sample = self._publisher(keys.SAMPLE).put
        self._put_event = self._publisher(keys.EVENT).put
        self._put_manifest = self._publisher(keys.MANIFEST).put
        self._batches = SampleBatcher(self._publisher(keys.BATCH), timer)
        self.points = PointPublications(manifest, self._publisher, self._put_point)
        self.manifest(manifest)

    def __enter__(self) -> Publications:
        return self

    def __exit__(self, *_: object) -> None:
        self._batches.close()
        self._close.close()

    def _publisher(self, topic: keys.Topic, name: str = "") -> zenoh.Publisher:
        publisher = self._session.declare_publisher(topic.at(self._node, name=name), **_qos(topic))
        return self._close.enter_context(publisher)

    def _put_point(self, topic: keys.Topic, name: str, payload: bytes) -> None:
        self._session.put(topic.at(self._node, name=name), payload, **_qos(topic))

    def manifest(self, manifest: Manifest) -> None:
        """Publish the manifest."""
        payload = codec.encode(manifest)
        self._put_manifest(payload)
        if self.recorder is not None:
            self.recorder.add(MANIFESTS, payload)
        if self._batches.has_listeners:
            self._batches.add(_MANIFEST, payload)

    def sample(self, payload: bytes) -> None:
        """Publish an encoded sample."""
        self._put_sample(payload)
        if self._batches.has_listeners:
            self._batches.add(_SAMPLE, payload)
        self._refused.clear()
        self._written_left = WRITTEN_A_STEP

    def event(self, event: Event, claimant: str = "") -> None:
        """Record an event, and publish it unless it is one of too many refusals or writes within a step.

        Args:
            event: the event.
            claimant: the controller that it refers to, if that has a claim.
        """
        is_published = self._is_published(event, claimant)
        if not is_published and self.recorder is None:
            return
        payload = codec.encode(event)
        if is_published:
            self._put_event(payload)
        if self.recorder is not None:  # the outcome of each recorded message follows it
            self.recorder.add(EVENTS, payload)
        if is_published and self._batches.has_listeners:
            self._batches.add(_EVENT, payload)

    def _is_published(self, event: Event, claimant: str) -> bool:
        """Count a refusal or a write; return whether its event is not one of too many."""
        if event.kind in REJECTIONS:
            self._refused[claimant] += 1
            return self._refused[claimant] <= EVENTS_A_STEP
        if event.kind is EventKind.WRITTEN:
            self._written_left -= 1
            return self._written_left >= 0
        return True
