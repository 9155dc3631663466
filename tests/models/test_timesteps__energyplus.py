"""The number of timesteps per hour of a model: as EnergyPlus itself takes it, or refused before anything starts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.box_model import box_model
from support.energyplus_alone import run_energyplus

from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.engine_pool import EnginePool
from zenostat.eplus_node.fork_template import EngineTemplate
from zenostat.eplus_node.plan import plan
from zenostat.models.building.model import Building
from zenostat.models.building.run_needs import changed_timesteps
from zenostat.models.catalog import find_weather
from zenostat.models.run_period import Period
from zenostat.topics.errors import InvalidConfig, SimulatorError

DENVER = find_weather("USA_CO_Denver").path
FINITE = {"algorithm": "ConductionFiniteDifference"}
SURFACE = "SurfaceProperty:HeatTransferAlgorithm"
MODE = {"PerformancePrecisionTradeoffs": {"fast": {"override_mode": "Mode01"}}}
DIFFERENCES = {"HeatBalanceAlgorithm": {"h": FINITE}}


def steps(number: int) -> dict[str, Any]:
    return {"Timestep": {"t": {"number_of_timesteps_per_hour": number}}}


CASES: dict[str, dict[str, Any]] = {
    "no object": {"Timestep": {}},
    "an empty object": {"Timestep": {"t": {}}},
    "mode 1": MODE,
    "mode 1 with 1": MODE | steps(1),
    "mode 8": {"PerformancePrecisionTradeoffs": {"fast": {"override_mode": "Mode08"}}},
    "advanced mode": {"PerformancePrecisionTradeoffs": {"fast": {"override_mode": "Advanced"}}},
    "finite differences": DIFFERENCES,
    "finite differences with 20": DIFFERENCES | steps(20),
    "finite differences of a surface": {SURFACE: {"s": {"surface_name": "Roof", **FINITE}}},
    "finite differences of all walls": {
        f"{SURFACE}:MultipleSurface": {"s": {"surface_type": "AllExteriorWalls", **FINITE}}
    },
    "finite differences of a list": {
        f"{SURFACE}:SurfaceList": {"s": {"surface": [{"surface_name": "Roof"}], **FINITE}}
    },
    "mode 1 with finite differences": MODE | DIFFERENCES,
}


def energyplus_steps(objects: dict[str, Any], folder: Path) -> int:
    """Return the number that EnergyPlus writes into its EIO file."""
    path = folder / "in.epJSON"
    path.write_text(json.dumps({kind: items for kind, items in objects.items() if items}))
    run_energyplus(path, DENVER, folder)
    lines = (folder / "eplusout.eio").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(" Timesteps per Hour,")).split(",")[1])


@pytest.mark.process
@pytest.mark.parametrize("case", CASES)
def test_timesteps__are_those_that_energyplus_takes(case: str, tmp_path: Path) -> None:
    objects = box_model() | CASES[case]
    own = Building("box", objects, "0").steps_per_hour
    change = changed_timesteps(objects, own)
    assert energyplus_steps(objects, tmp_path) == (change[-1] if change else own)


@pytest.mark.parametrize(
    ("more", "words", "possible"),
    [
        (MODE, "PerformancePrecisionTradeoffs 'fast' of box has override_mode 'Mode01'.* 1 instead of 4 timesteps", 1),
        (DIFFERENCES, "HeatBalanceAlgorithm 'h' of box .* 20 instead of 4 .*set steps_per_hour to 20", 20),
    ],
)
def test_run_period__with_timesteps_that_energyplus_changes_is_refused(
    more: dict[str, Any], words: str, possible: int
) -> None:
    building = Building("box", box_model() | more, "0")
    for asked in (None, 4):
        with pytest.raises(InvalidConfig, match=words):
            building.period(None, None, asked)
    assert building.period(None, None, possible).steps == 24 * possible


@pytest.mark.process
def test_engine__of_another_number_of_timesteps_fails_before_its_first_sample(tmp_path: Path) -> None:
    model = tmp_path / "box.epJSON"
    model.write_text(json.dumps(box_model() | MODE))
    planned = plan(read_config({"building": str(model), "weather": str(DENVER), "steps_per_hour": 1}))
    wrong = replace(planned, period=Period(planned.period.begin, planned.period.end, 4))
    pool = EnginePool(wrong, tmp_path / "node", [EngineTemplate()])
    with pytest.raises(SimulatorError, match="EnergyPlus takes 1 instead of 4 timesteps"):
        pool.engine(0)
    pool.close()
