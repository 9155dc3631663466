"""A node's geometry and systems on the bus: the model's own, also on branches; and nodes that have none."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from support.nodes import SMALL, node_on_bus

import zenostat
from zenostat.models import catalog
from zenostat.models.building.geometry import building_geometry
from zenostat.models.building.model import read_building
from zenostat.models.building.schematic import systems
from zenostat.models.weather.header import read_header
from zenostat.topics import codec, keys
from zenostat.topics.errors import NodeNotFound, RequestRejected
from zenostat.topics.messages import CreateBranch, Geometry, Manifest
from zenostat.views.display.surfaces import surfaces

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


@pytest.fixture
def expected() -> Geometry:
    weather = catalog.find_weather(SMALL["weather"])
    geometry, _ = building_geometry(read_building(catalog.find_building(SMALL["building"])), read_header(weather.path))
    assert geometry is not None
    return geometry


@pytest.mark.slow
def test_geometry__bus_has_the_models_geometry(episode_bus: zenostat.Bus, expected: Geometry) -> None:
    geometry = episode_bus.geometry("office")
    assert geometry == expected
    assert {surface.zone for surface in surfaces(geometry)} == set(range(len(geometry.zones)))
    branch = episode_bus.branch("office", CreateBranch())
    assert episode_bus.geometry(branch) == expected
    episode_bus.stop(branch)


def test_systems__bus_has_the_models_systems(episode_bus: zenostat.Bus) -> None:
    assert episode_bus.systems("office") == systems(read_building(catalog.find_building(SMALL["building"])).objects)


def test_geometry__node_that_is_not_there_is_named(episode_bus: zenostat.Bus) -> None:
    with pytest.raises(NodeNotFound, match="no node 'offise'"):
        episode_bus.geometry("offise")


@pytest.mark.slow
def test_geometry__python_plant_has_no_geometry(scratch: Path) -> None:
    file = scratch / "tank.py"
    file.write_text(PLANT)
    with (
        node_on_bus(scratch / "node", plant=f"{file}:Tank", name="tank") as (_, bus),
        pytest.raises(RequestRejected, match=r"^the plant 'tank' is a Python class, which has no geometry$"),
    ):
        bus.geometry("tank")


@pytest.fixture
def old_node(episode_bus: zenostat.Bus) -> Iterator[str]:
    """A node `old` that answers for its manifest only, as one of a version without this topic would."""
    versions = {"zenostat": "0.1", "energyplus": "25.2"}
    manifest = episode_bus.manifest("office")
    old = Manifest(**manifest.model_dump() | {"node": "old", "versions": versions})

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(keys.MANIFEST.at("old"), codec.encode(old), encoding=zenoh.Encoding(codec.encoding(Manifest)))

    queryable = episode_bus.session.declare_queryable(keys.MANIFEST.at("old"), answer, complete=True)
    yield "old"
    queryable.undeclare()


def test_geometry__older_node_is_named_with_its_version(episode_bus: zenostat.Bus, old_node: str) -> None:
    with pytest.raises(RequestRejected, match=r"^node 'old' is of Zenostat 0\.1, which does not send a geometry$"):
        episode_bus.geometry(old_node)
    with pytest.raises(RequestRejected, match="does not send its systems"):
        episode_bus.systems(old_node)
