"""`zenostat points BUILDING --default` lists what a node of the building has: names, units and bounds."""

import json
from pathlib import Path
from typing import Any

import pytest
from support.data_packs import sinergym
from support.nodes import WEATHER, node_on_bus
from support.run_cli import run_in_process

from zenostat.topics.messages import Manifest

BUILDINGS = [
    "warehouse",
    *(
        pytest.param(name, marks=pytest.mark.slow)
        for name in ("ref-small-office", "restaurant-fast-food", "office-medium", "5ZoneAutoDXVAV")
    ),
]


def _manifest(folder: Path, building: str, *, monitoring: bool) -> Manifest:
    run: dict[str, Any] = {"weather": WEATHER, "begin": "07-03", "end": "07-03"}
    with node_on_bus(folder, building=building, **run, monitoring=monitoring) as (_, bus):
        return bus.manifest("office")


def _listed(building: str, *options: str) -> list[tuple[Any, ...]]:
    rows = json.loads(run_in_process("points", building, *options, "--json").stdout)
    return [tuple(row[k] for k in ("kind", "bus_name", "name", "key", "unit", "low", "high")) for row in rows]


def _rows(manifest: Manifest) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = [
        ("sensor", s.name, s.variable, s.key, s.unit, s.low, s.high) for s in manifest.sensors
    ]
    rows += [("meter", m.name, m.meter, "", m.unit, m.low, m.high) for m in manifest.meters]
    for a in manifest.actuators:
        rows.append(("actuator", a.name, f"{a.component_type} / {a.control_type}", a.key, a.unit, a.low, a.high))
    return rows


@pytest.mark.slow
@pytest.mark.parametrize("building", BUILDINGS)
def test_points__are_those_of_the_manifest(building: str, folder: Path) -> None:
    sinergym()
    monitored = _manifest(folder / "monitored", building, monitoring=True)
    assert _listed(building, "--default") == _listed(building, "--default", "--monitoring") == _rows(monitored)
    plain = _manifest(folder / "plain", building, monitoring=False)
    assert _listed(building, "--default", "--no-monitoring") == _rows(plain)
    shown = _listed(building, "--monitoring")
    assert set(shown) <= set(_rows(monitored))
    assert {point.name for point in monitored.points if not point.observed} <= {row[1] for row in shown}
    assert ("sensor", "outdoor_temperature") in {row[:2] for row in shown}
    of_meters = _listed(building, "--default", "--kind", "meter")
    assert of_meters == [row for row in _rows(monitored) if row[0] == "meter"]
