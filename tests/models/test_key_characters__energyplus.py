"""Zones with unusual characters in their names: EnergyPlus has their points, and a node reads them by its own keys."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.box_model import box_model

from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.engine_pool import EnginePool
from zenostat.eplus_node.fork_template import EngineTemplate
from zenostat.eplus_node.plan import plan
from zenostat.models.catalog import find_weather

VARIABLES = {
    "temperature": "Zone Air Temperature",
    "globe": "Zone Wetbulb Globe Temperature",  # computed on request
    "algorithm": "Surface Inside Face Convection Classification Index",  # an integer
}
NAMES = ["büro", "Straße", "a\tb", "a\u2028b", "[z", "a.b (1)", "back\\slash"]


def named(name: str) -> dict[str, Any]:
    """Return the box model with another name of its zone and its roof."""
    text = json.dumps(box_model()).replace('"Box"', json.dumps(name)).replace('"Roof": {', f"{json.dumps(name)}: {{")
    model: dict[str, Any] = json.loads(text)
    return model


def first_samples(name: str, folder: Path) -> tuple[list[float], list[float]]:
    """Return the values at the beginning of a run of that model and a timestep later, by the engine of a node.

    They are the sensors and the energy of the zone's lights (J).
    """
    path = folder / "box.epJSON"
    path.write_text(json.dumps(named(name)))
    sensors = {sensor: [variable, name] for sensor, variable in VARIABLES.items()}
    settings = {"building": str(path), "weather": str(find_weather("USA_CO_Denver").path), "sensors": sensors}
    meters = {"lights": f"InteriorLights:Electricity:Zone:{name}"}
    planned = plan(read_config({**settings, "meters": meters, "actuators": {}}))
    assert planned.geometry.geometry is not None
    assert set(np.frombuffer(planned.geometry.geometry.zone_index, "<i2")) == {0}
    pool = EnginePool(planned, folder / "node", [EngineTemplate()])
    engine = pool.engine(0)
    first = np.frombuffer(engine.frame.values()).tolist()
    engine.send(b"")
    engine.receive()
    second = np.frombuffer(engine.frame.values()).tolist()
    engine.close()
    pool.close()
    return first, second


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[float], list[float]]:
    return first_samples("Box", tmp_path_factory.mktemp("plain"))


@pytest.mark.process
@pytest.mark.parametrize("name", NAMES)
def test_engine__reads_the_points_of_a_zone_of_any_name(
    name: str, plain: tuple[list[float], list[float]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    assert first_samples(name, tmp_path) == plain
    (*sensors, none), (*_, lights) = plain
    assert 0.0 not in sensors
    assert (none, lights) == (0.0, 100.0 * 900)
