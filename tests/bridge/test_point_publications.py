"""Points on topics of their own: which a node publishes, over a real bus, and when it declares their publishers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime

import numpy as np
import pytest
import zenoh
from support.builders import manifest, meter, sensor
from support.nodes import free_port, until

from zenostat.bridge.node import point_publications
from zenostat.bridge.node.point_publications import PointPublications
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec, keys
from zenostat.topics.messages import PointValue

SENSORS = tuple(sensor(f"t{number}") for number in range(5))
VALUES = np.array([20.0, 21.0, np.nan, 23.0, 24.0, 3600.0, -1.0]).tobytes()
"""Of five sensors and a meter; an actuator follows."""


class Node:
    """A node's points on a bus, and what has been declared."""

    def __init__(self, session: zenoh.Session) -> None:
        self.declared: list[str] = []
        self.of_topics: list[zenoh.Publisher] = []

        def declare(topic: keys.Topic, name: str) -> zenoh.Publisher:
            self.declared.append(name)
            publisher = session.declare_publisher(topic.at("office", name=name))
            self.of_topics += [publisher] if name == "*" else []
            return publisher

        def put(topic: keys.Topic, name: str, payload: bytes) -> None:
            session.put(topic.at("office", name=name), payload)

        described = manifest(sensors=SENSORS, meters=[meter("energy")])
        self.points = PointPublications(described, declare, put)
        self.step = 0

    def publish(self) -> None:
        self.step += 1
        self.points.publish(VALUES, 1, self.step, datetime(2026, 1, 12, 0, self.step))  # local time


@pytest.fixture
def sessions() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_session(listen=[endpoint]) as node, open_session(connect=[endpoint]) as client:
        yield node, client


@contextmanager
def received(client: zenoh.Session, key: str) -> Iterator[list[tuple[str, int, float, str]]]:
    """Name, step, value and unit of each point that arrives while it is subscribed to."""
    got: list[tuple[str, int, float, str]] = []

    def on_point(message: zenoh.Sample) -> None:
        point = codec.decode(PointValue, message.payload.to_bytes())
        got.append((str(message.key_expr).rpartition("/")[2], point.step, point.value, point.unit))

    subscriber = client.declare_subscriber(key, on_point)
    try:
        yield got
    finally:
        subscriber.undeclare()


def test_points__nothing_is_declared_or_sent_without_subscribers(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    node = Node(sessions[0])
    for _ in range(3):
        node.publish()
    assert node.declared == ["*", "*"]


@pytest.mark.parametrize("declaring_s", [0.0, 10.0])
def test_points__each_timestep_is_received_while_publishers_are_declared(
    declaring_s: float, sessions: tuple[zenoh.Session, zenoh.Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With no time for it, no publisher is ever declared; with enough, all at once: the same is received."""
    monkeypatch.setattr(point_publications, "_DECLARING_S", declaring_s)
    node = Node(sessions[0])
    with (
        received(sessions[1], keys.SENSOR.at("office", name="t1")) as one,
        received(sessions[1], keys.METER.at("*", name="*")) as meters,
    ):
        until(lambda: all(all_points.matching_status.matching for all_points in node.of_topics), "both are known")
        until(lambda: node.publish() or (one and meters), "both are routed")
        first = node.step + 1
        for _ in range(3):
            node.publish()
        until(lambda: meters[-1][1] == one[-1][1] == node.step, "they arrive")
    assert one[-3:] == [("t1", step, 21.0, "degC") for step in range(first, first + 3)]
    assert meters[-3:] == [("energy", step, 3600.0, "J") for step in range(first, first + 3)]
    assert len(node.declared) == (2 if declaring_s == 0.0 else 2 + 6)


def test_points__value_that_is_no_number_is_left_out(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    node = Node(sessions[0])
    with received(sessions[1], keys.SENSOR.at("office", name="*")) as sensors:
        until(lambda: node.points.is_needed, "the subscriber is known")
        node.publish()
        until(lambda: len(sensors) == 4, "they arrive")
    assert [name for name, *_ in sensors] == ["t0", "t1", "t3", "t4"]
