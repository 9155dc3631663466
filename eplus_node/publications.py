"""What a node says: its manifest, samples, single points and events."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import datetime
from math import isfinite

import numpy as np
import zenoh
from zenoh import CongestionControl
from zenoh.handlers import Callback

from bridge.runtime.timer import Timer
from eplus_node.batching import SampleBatcher
from topics import codec, keys
from topics.messages import Event, EventKind, Manifest, PointValue

EVENTS_A_STEP = 20
"""More refusals than this in one step are counted, but not told one by one."""

WRITTEN_A_STEP = 1000
"""Likewise writes that were taken: a controller that waits for a reset cannot take in any number of events."""

_MANIFEST, _SAMPLE, _EVENT = keys.MANIFEST.key, keys.SAMPLE.key, keys.EVENT.key
_REFUSALS = (EventKind.REJECTED, EventKind.LATE, EventKind.DUPLICATE)


class Publications:
    """The publishers of a node; `with Outlets(session, manifest, timer) as outlets`. It publishes the manifest."""

    def __init__(self, session: zenoh.Session, manifest: Manifest, timer: Timer) -> None:
        self._session = session
        self._node = manifest.node
        self._close = ExitStack()
        self._watched: dict[int, zenoh.Publisher] = {}
        self._events_left, self._written_left = EVENTS_A_STEP, WRITTEN_A_STEP
        self._put_sample = self._publisher(keys.SAMPLE).put
        self._put_event = self._publisher(keys.EVENT).put
        self._put_manifest = self._publisher(keys.MANIFEST).put
        self._batches = SampleBatcher(self._publisher(keys.BATCH), timer)
        topics = [(keys.SENSOR, s.name, s.unit) for s in manifest.sensors]
        topics += [(keys.METER, m.name, m.unit) for m in manifest.meters]
        self._units = [unit for _, _, unit in topics]
        for index, (topic, name, _) in enumerate(topics):
            self._watch(index, self._publisher(topic, name))
        self.manifest(manifest)

    def __enter__(self) -> Publications:
        return self

    def __exit__(self, *_: object) -> None:
        self._batches.close()
        self._close.close()

    def _publisher(self, topic: keys.Topic, name: str = "") -> zenoh.Publisher:
        drop = topic.delivery is keys.Delivery.DROP
        publisher = self._session.declare_publisher(
            topic.at(self._node, name=name),
            encoding=zenoh.Encoding(codec.encoding(topic.message)) if topic.message else None,
            congestion_control=CongestionControl.DROP if drop else CongestionControl.BLOCK,
        )
        return self._close.enter_context(publisher)

    def _watch(self, index: int, publisher: zenoh.Publisher) -> None:
        """Has a point published as long as somebody listens to it."""

        def wanted(status: zenoh.MatchingStatus) -> None:
            watched = dict(self._watched)  # another thread may be walking over the old one
            if status.matching:
                watched[index] = publisher
            else:
                watched.pop(index, None)
            self._watched = watched

        publisher.declare_matching_listener(Callback(wanted, indirect=False))

    def manifest(self, manifest: Manifest) -> None:
        """What the node is; again when its weather has changed."""
        payload = codec.encode(manifest)
        self._put_manifest(payload)
        if self._batches.wanted:
            self._batches.add(_MANIFEST, payload)

    def sample(self, payload: bytes) -> None:
        """One step's frame."""
        self._put_sample(payload)
        if self._batches.wanted:
            self._batches.add(_SAMPLE, payload)
        self._events_left, self._written_left = EVENTS_A_STEP, WRITTEN_A_STEP

    def points(self, values: bytes, episode: int, step: int, time: datetime) -> None:
        """One step's single points (of slot 0), those that somebody listens to; `values` raw, in manifest order."""
        for index, publisher in self._watched.items():
            unit, value = self._units[index], float(np.frombuffer(values, count=1, offset=8 * index)[0])
            if not isfinite(value):  # an injected fault has dropped it, or blown it up
                continue
            point = PointValue(value=value, unit=unit, episode=episode, step=step, time=time.isoformat())
            publisher.put(codec.encode(point))

    def event(self, event: Event) -> None:
        """An event; a flood of refusals, or of writes, within a step is cut."""
        if event.kind in _REFUSALS:
            self._events_left -= 1
            if self._events_left < 0:
                return
        elif event.kind is EventKind.WRITTEN:
            self._written_left -= 1
            if self._written_left < 0:
                return
        payload = codec.encode(event)
        self._put_event(payload)
        if self._batches.wanted:
            self._batches.add(_EVENT, payload)
