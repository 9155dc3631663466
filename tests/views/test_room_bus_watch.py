"""The nodes of a bus as the control room follows them, on a bus that is none."""

import json
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from support import builders
from support.nodes import until

pytest.importorskip("starlette")

from zenostat.topics import keys
from zenostat.topics.errors import NodeLost, RequestRejected
from zenostat.topics.messages import Manifest
from zenostat.views.room import bus_watch
from zenostat.views.room.bus_watch import BusWatch
from zenostat.views.room.updates import Updates


class EndedNodesBus:
    """A bus whose nodes send their manifests and have ended when they are asked for anything else."""

    def __init__(self) -> None:
        subscriber = SimpleNamespace(undeclare=lambda: None)
        declare = SimpleNamespace(declare_subscriber=lambda *_, **__: subscriber)
        self.session = SimpleNamespace(liveliness=lambda: declare, **declare.__dict__)

    def manifest(self, node: str) -> Manifest:
        parent = node.rpartition(".")[0]
        return builders.manifest().model_copy(update={"node": node, "branch_of": parent})

    def geometry(self, node: str) -> None:
        raise RequestRejected(f"{node} has no geometry")

    systems = geometry

    def status(self, node: str) -> None:
        raise NodeLost(f"{node} is gone")


@pytest.fixture
def updates() -> Updates:
    return Updates()


@pytest.fixture
def watch(updates: Updates) -> Iterator[BusWatch]:
    started = BusWatch(EndedNodesBus(), updates)  # type: ignore[arg-type]
    yield started
    started.close()


def connect(watch: BusWatch, node: str, kind: zenoh.SampleKind = zenoh.SampleKind.PUT) -> None:
    token: Any = SimpleNamespace(key_expr=keys.NODE_TOKEN.at(node, name="1a"), kind=kind)
    watch._on_token(token)


def test_bus_watch__messages_of_branches_that_have_ended_are_forgotten(watch: BusWatch, updates: Updates) -> None:
    for node in ("tank", "tank.b1", "tank.b2"):
        connect(watch, node)
        until(lambda node=node: f"node:{node}" in updates._latest, f"{node} is polled")
    assert [each.node for each in watch.watches()] == ["tank", "tank.b2"]
    assert {topic for topic in updates._latest if topic != "overview"} == {"node:tank", "node:tank.b2"}


def test_bus_watch__own_branches_are_never_followed_and_those_of_others_later(watch: BusWatch) -> None:
    with watch.without_branches("tank") as on_branch, watch.without_branches("tank") as on_other_branch:
        for node in ("tank", "tank.b1", "tank.b2", "tank.b3", "tank.b4"):
            connect(watch, node)
        on_branch("tank.b1")
        on_other_branch("tank.b3")
        connect(watch, "tank.b4", zenoh.SampleKind.DELETE)
    assert [each.node for each in watch.watches()] == ["tank", "tank.b2"]


class SilentBus(EndedNodesBus):
    """A bus whose nodes have ended before they are asked for their manifests."""

    def manifest(self, node: str) -> Manifest:
        raise NodeLost(f"{node} is gone")


def test_bus_watch__node_that_never_answered_is_forgotten_when_it_leaves(updates: Updates) -> None:
    watch = BusWatch(SilentBus(), updates)  # type: ignore[arg-type]
    try:
        connect(watch, "tank.b1")
        until(lambda: "node:tank.b1" in updates._latest, "it is polled")
        connect(watch, "tank.b1", zenoh.SampleKind.DELETE)
        assert watch.watches() == []
        assert "node:tank.b1" not in updates._latest
    finally:
        watch.close()


class CountingUpdates(Updates):
    """Keeps the names of each list of all nodes that is published."""

    def __init__(self) -> None:
        super().__init__()
        self.overviews: list[list[str]] = []

    def publish(self, topic: str, message: bytes) -> None:
        super().publish(topic, message)
        if topic == "overview":
            self.overviews.append([entry["node"] for entry in json.loads(message)["nodes"]])


@pytest.mark.parametrize("period_s", [1e6, 0.0])
def test_bus_watch__changes_within_a_period_are_one_message(monkeypatch: pytest.MonkeyPatch, period_s: float) -> None:
    monkeypatch.setattr(bus_watch, "OVERVIEW_S", period_s)
    updates = CountingUpdates()
    watch = BusWatch(EndedNodesBus(), updates)  # type: ignore[arg-type]
    try:
        until(lambda: updates.overviews == [[]], "the list without nodes is published")
        nodes = [f"tank{number:02}" for number in range(20)]
        for node in nodes:
            connect(watch, node)
        until(lambda: all(each.polls for each in watch.watches()), "all nodes are polled")
        assert [entry["node"] for entry in watch.overview()] == nodes
        if period_s:
            assert updates.overviews == [[]]
        else:
            until(lambda: updates.overviews[-1] == nodes, "the list with all nodes is published")
    finally:
        watch.close()
