"""A node's semantic model on the bus: the model's own, on branches as well; and nodes that have none."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from support.nodes import node_on_bus

import zenostat
from zenostat import semantic
from zenostat.topics.errors import InvalidConfig, RequestRejected
from zenostat.topics.messages import CreateBranch

PLANT = """
class Tank:
    sensors = {"level": "m"}
    actuators = {"valve": ("1", 0.0, 1.0)}
    step_s, steps = 60, 5

    def reset(self, seed):
        return {"level": 1.0}

    def step(self, command):
        return {"level": 1.0}
"""
POINTS = """
    SELECT ?name ?kind ?key WHERE {
        ?point ref:hasExternalReference ?bus .
        ?bus a zenostat:BusReference ; zenostat:name ?name ; zenostat:kind ?kind ; zenostat:key ?key
    }"""


def test_semantic__bus_has_the_points_of_the_manifest(episode_bus: zenostat.Bus) -> None:
    manifest = episode_bus.manifest("office")
    with ThreadPoolExecutor(4) as askers:
        texts = set(askers.map(lambda _: episode_bus.semantic("office"), range(8)))
    (text,) = texts
    rows = semantic.SemanticGraph.parse(text).query(POINTS)
    kinds = {"sensor": manifest.sensors, "meter": manifest.meters, "actuator": manifest.actuators}
    assert {(row["kind"], row["name"]) for row in rows} == {(k, p.name) for k, points in kinds.items() for p in points}
    (key,) = (row["key"] for row in rows if row["name"] == "core_zn_cooling_setpoint")
    assert key == "zenostat/v3/office/actuator/*/core_zn_cooling_setpoint"
    branch = episode_bus.branch("office", CreateBranch())
    assert {row["key"].split("/")[2] for row in semantic.read(episode_bus, branch).query(POINTS)} == {branch}
    episode_bus.stop(branch)


@pytest.mark.slow
def test_semantic__python_plant_has_none(scratch: Path) -> None:
    file = scratch / "tank.py"
    file.write_text(PLANT)
    with (
        node_on_bus(scratch / "node", plant=f"{file}:Tank", name="tank") as (_, bus),
        pytest.raises(RequestRejected, match=r"^the plant 'tank' is a Python class, which has no semantic model$"),
    ):
        bus.semantic("tank")


@pytest.mark.parametrize("query", ["SELECT", "ASK { ?a ?b ?c }", "SELECT ?a WHERE { ?a unknown:b ?c }"])
def test_semantic_graph__query_that_is_no_select_query_is_refused(query: str) -> None:
    with pytest.raises(InvalidConfig):
        semantic.SemanticGraph.parse("").query(query)


def test_semantic_graph__text_that_is_no_turtle_is_refused() -> None:
    with pytest.raises(InvalidConfig, match="not valid Turtle"):
        semantic.SemanticGraph.parse("<urn:a> <urn:b>")
