"""Output variables of integers (a status, a type, a count), which EnergyPlus's API serves and does not list."""

import json
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from support.energyplus_reference import Alone, Case
from support.nodes import NodeProgram

import zenostat
from zenostat.models import energyplus
from zenostat.models.building.model import Building, for_episode, read_building, write
from zenostat.models.catalog import find_building, find_weather
from zenostat.models.points.discovery import PointCatalog, discover
from zenostat.models.points.selection import default_aggregation, find_variable
from zenostat.models.run_period import Period
from zenostat.topics.messages import Aggregation

CASE = Case("ref-small-office", "USA_CO_Denver", "04-06", "04-09", 4)
"""A Saturday to a Tuesday; the HVAC divides most timesteps. Daylight saving time begins on the second day of April."""

SYSTEM = {
    "Air System Outdoor Air Economizer Status": "PSZ-AC:1",
    "Air System Simulation Cycle On Off Status": "PSZ-AC:1",
    "Air System Solver Iteration Count": "SimHVAC",
    "HVAC System Solver Iteration Count": "SimHVAC",
}
ZONE = {
    "Site Day Type Index": "Environment",
    "Site Daylight Saving Time Status": "Environment",
    "Site Rain Status": "Environment",
    "Zone Thermostat Control Type": "CORE_ZN",
    "Surface Inside Face Convection Model Equation Index": "ATTIC_FLOOR_CORE",
}


@pytest.fixture(scope="module")
def building() -> Building:
    return read_building(find_building(CASE.building))


@pytest.fixture(scope="module")
def catalog(building: Building) -> PointCatalog:
    return discover(building, find_weather(CASE.weather).path)


@pytest.mark.slow
def test_integer_variables__all_that_energyplus_can_report_is_found(
    building: Building, catalog: PointCatalog, tmp_path: Path
) -> None:
    """The survey has each variable of EnergyPlus's own dictionary (`eplusout.rdd`)."""
    day = date(2017, 1, 1)
    objects = for_episode(building, Period(day, day, 4))
    objects["OutputControl:Files"] = {"dictionary": {"output_rdd": "Yes", "output_eso": "No", "output_tabular": "No"}}
    objects["Output:VariableDictionary"] = {"dictionary": {"key_field": "regular"}}
    model = json.loads(write(objects, tmp_path).read_text())
    energyplus._run_until_ready(model, str(find_weather(CASE.weather).path), str(tmp_path / "run"))
    names = energyplus._variable_kinds(str(tmp_path / "run" / "eplusout.rdd"))
    assert {v.name.casefold() for v in catalog.variables} == {name.casefold() for name in names}


def test_integer_variables__they_have_a_kind_and_a_unit(catalog: PointCatalog) -> None:
    for name, key in (SYSTEM | ZONE).items():
        variable = find_variable(catalog, "x", name, key)
        assert (variable.system, variable.summed, variable.unit) == (name in SYSTEM, name.endswith("Count"), "1")
        assert default_aggregation(variable) is (Aggregation.SUM if variable.summed else Aggregation.INSTANT)


@pytest.mark.slow
def test_integer_variables__they_equal_energyplus_alone_to_the_bit(folder: Path) -> None:
    sensors = {f"v{i}": [name, key] for i, (name, key) in enumerate((SYSTEM | ZONE).items())}
    averaged = [name for name in SYSTEM | ZONE if not name.endswith("Count")]
    sensors |= {f"mean{i}": [name, (SYSTEM | ZONE)[name], "mean"] for i, name in enumerate(averaged)}
    sensors |= {f"state{i}": [name, key, "instant"] for i, (name, key) in enumerate(SYSTEM.items()) if "Count" in name}
    with NodeProgram(folder, **CASE.settings(), sensors=sensors, meters={}, actuators={}) as node:
        with zenostat.connect(node.endpoint, affinity="off") as bus, bus.controller("office") as link:
            alone = Alone(CASE, link.manifest.sensors, (), folder / "alone")
            got = []
            for sample in link:
                got.append(sample.values)
                sample.send()
        expected = alone.values()
    columns = {s.name: (s.variable, s.aggregation) for s in link.manifest.sensors}
    for column, about in enumerate(columns.values()):
        assert np.array_equal(np.array(got)[1:, column], expected[:, column]), about
    lively = {about for column, about in enumerate(columns.values()) if len(np.unique(expected[:, column])) > 1}
    assert {
        ("Site Day Type Index", Aggregation.INSTANT),
        ("Air System Solver Iteration Count", Aggregation.SUM),
    } <= lively
