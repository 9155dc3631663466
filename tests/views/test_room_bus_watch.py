"""The nodes of a bus as the control room follows them, on a bus that is none."""

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
    bus: Any = EndedNodesBus()
    started = BusWatch(bus, updates)
    yield started
    started.close()


def connect(watch: BusWatch, node: str) -> None:
    token: Any = SimpleNamespace(key_expr=keys.NODE_TOKEN.at(node, name="1a"), kind=zenoh.SampleKind.PUT)
    watch._on_token(token)


def test_bus_watch__messages_of_branches_that_have_ended_are_forgotten(watch: BusWatch, updates: Updates) -> None:
    for node in ("tank", "tank.b1", "tank.b2"):
        connect(watch, node)
        until(lambda node=node: f"node:{node}" in updates._latest, f"{node} is polled")
    assert [each.node for each in watch.watches()] == ["tank", "tank.b2"]
    assert {topic for topic in updates._latest if topic != "overview"} == {"node:tank", "node:tank.b2"}
