"""Single points of a node server: each sensor and meter on a topic of its own, while somebody subscribes to it."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from math import isfinite
from time import perf_counter

import numpy as np
import zenoh
from zenoh.handlers import Callback

from zenostat.topics import codec, keys
from zenostat.topics.messages import Manifest, PointValue

_DECLARING_S = 0.005
"""Time within a timestep for declaring publishers, in s."""


class PointPublications:
    """The publishers of the points.

    The time in which Zenoh declares publishers rises with the square of their number, so a node begins with one for all
    sensors and one for all meters. From the first subscriber of any point on, each timestep declares some more: those
    of single points, each of which is published while it has subscribers. Until all are declared, the others are
    published as well.

    Args:
        manifest: of the node.
        declare: declares the publisher of a topic and the name of a point; `*` is all of them.
        put: publishes a message of a topic and the name of a point.

    Attributes:
        is_needed: whether any point has had a subscriber.
    """

    def __init__(
        self,
        manifest: Manifest,
        declare: Callable[[keys.Topic, str], zenoh.Publisher],
        put: Callable[[keys.Topic, str, bytes], None],
    ) -> None:
        self._points = [(keys.SENSOR, sensor.name, sensor.unit) for sensor in manifest.sensors]
        self._points += [(keys.METER, meter.name, meter.unit) for meter in manifest.meters]
        self._declare, self._put = declare, put
        self.is_needed = False
        self._declared = 0
        self._subscribed: dict[int, zenoh.Publisher] = {}
        self._of_topics = [declare(topic, "*") for topic in dict.fromkeys(topic for topic, _, _ in self._points)]
        for publisher in self._of_topics:
            publisher.declare_matching_listener(Callback(self._on_any_subscriber, indirect=False))

    def publish(self, values: bytes, episode: int, step: int, time: datetime) -> None:
        """Publish the points of slot 0 that have subscribers; `values` are raw, in manifest order."""
        if not self.is_needed:
            return
        self._declare_more()
        numbers, text, subscribed = np.frombuffer(values, count=len(self._points)), time.isoformat(), self._subscribed
        for index in (*subscribed, *range(self._declared, len(self._points))):
            topic, name, unit = self._points[index]
            value = float(numbers[index])
            if not isfinite(value):  # an injected fault has dropped it, or made it infinite
                continue
            payload = codec.encode(PointValue(value=value, unit=unit, episode=episode, step=step, time=text))
            if index < self._declared:
                subscribed[index].put(payload)
            else:
                self._put(topic, name, payload)

    def _on_any_subscriber(self, status: zenoh.MatchingStatus) -> None:
        self.is_needed = self.is_needed or status.matching

    def _declare_more(self) -> None:
        end = perf_counter() + _DECLARING_S
        while self._declared < len(self._points) and perf_counter() < end:
            topic, name, _ = self._points[self._declared]
            self._publish_on_demand(self._declared, self._declare(topic, name))
            self._declared += 1

    def _publish_on_demand(self, index: int, publisher: zenoh.Publisher) -> None:
        """Publish a point only while it has subscribers."""

        def on_matching(status: zenoh.MatchingStatus) -> None:
            subscribed = dict(self._subscribed)  # a copy: another thread may be iterating
            if status.matching:
                subscribed[index] = publisher
            else:
                subscribed.pop(index, None)
            self._subscribed = subscribed

        publisher.declare_matching_listener(Callback(on_matching, indirect=False))
