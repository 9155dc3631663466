"""An episode without commands gives what EnergyPlus gives alone: each sensor and meter, each timestep, to the bit.

The same prepared model is run twice: through the bus, with a controller that answers each sample and commands
nothing, and by EnergyPlus alone, whose own reports are the reference (`tests/support/energyplus_reference.py`).
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.energyplus_reference import Case, Runs, check_equal, run_both
from support.nodes import WEATHER

from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building, find_weather
from zenostat.models.points import discovery, selection
from zenostat.topics.messages import Aggregation, Manifest

ZONE = {"ref-small-office": "Core_ZN", "office-small": "Core_ZN", "office-medium": "Core_mid"}
"""A zone of each building."""

WEEKS = [
    Case("office-small", WEATHER, "01-09", "01-15", 6),
    Case("office-medium", WEATHER, "07-01", "07-07", 4),
    Case("ref-small-office", WEATHER, "04-10", "04-16", 4),
]
YEARS = [Case(building, WEATHER, "01-01", "12-31", 4) for building in ZONE]


def _name(case: Case) -> str:
    return f"{case.building}-{case.begin}"


def _with_other_readings(case: Case) -> dict[str, list[str]]:
    """The default sensors and more: what is read as a state by default as a mean, and the other way round; sums."""
    entry, weather = find_building(case.building), find_weather(case.weather).path
    zone = ZONE[case.building].upper()
    more = {
        "zone_mean": ("Zone Air Temperature", zone, "mean"),
        "zone_humidity_mean": ("Zone Air Relative Humidity", zone, "mean"),
        "zone_mean_air_temperature": ("Zone Mean Air Temperature", zone),
        "zone_cooling": ("Zone Air System Sensible Cooling Energy", zone),
        "zone_cooling_rate": ("Zone Air System Sensible Cooling Rate", zone),
        "zone_cooling_rate_instant": ("Zone Air System Sensible Cooling Rate", zone, "instant"),
        "outdoor_mean": ("Site Outdoor Air Drybulb Temperature", "Environment", "mean"),
        "sun": ("Site Direct Solar Radiation Rate per Area", "Environment"),
        "hvac_power_instant": (selection.HVAC_POWER, "Whole Building", "instant"),
    }
    defaults = selection.default_sensors(discovery.discover(read_building(entry), weather))
    return {name: list(spec) for name, spec in (defaults | more).items()}


def _both(case: Case, folder: Path) -> Runs:
    return run_both(case, folder, sensors=_with_other_readings(case))


def _check_kinds(manifest: Manifest) -> None:
    """The comparison covers each reading, and the meters."""
    assert {sensor.aggregation for sensor in manifest.sensors} == set(Aggregation)
    assert {"Electricity:Facility", "HVAC:Electricity"} <= {meter.meter for meter in manifest.meters}


@pytest.fixture(scope="module")
def both(module_folder: Path) -> Callable[[Case], Runs]:
    """Both runs, once for each case."""
    return cache(lambda case: _both(case, module_folder / _name(case)))


@pytest.fixture(params=WEEKS, ids=_name)
def week(request: pytest.FixtureRequest, both: Callable[[Case], Runs]) -> Runs:
    return both(request.param)


@pytest.mark.variants
def test_fidelity__week_equals_energyplus_alone(week) -> None:
    manifest, got, expected = week
    _check_kinds(manifest)
    check_equal(manifest, got, expected)


@pytest.mark.variants
def test_fidelity__each_point_lives(week) -> None:
    """A comparison of constants would show nothing."""
    manifest, got, _ = week
    changing = {name for column, name in enumerate(manifest.names) if len(np.unique(got[:, column])) > 1}
    idle = {name for name in manifest.names if name not in changing}
    assert not idle & {"outdoor_temperature", "hvac_and_plant_power", "zone_mean", "electricity_facility"}
    assert len(changing) > len(manifest.names) / 2


@pytest.fixture
def divided(both: Callable[[Case], Runs]) -> Runs:
    """A week of a building whose HVAC divides most timesteps, which those of ASHRAE 901 never do."""
    return both(WEEKS[-1])


def test_fidelity__state_and_mean_are_distinguished(divided) -> None:
    """The state at the end of a timestep is not its mean if the HVAC needed shorter steps: neither may be
    taken for EnergyPlus's report of the other.
    """
    manifest, got, expected = divided
    column = {name: i for i, name in enumerate(manifest.names)}
    zone = next(s for s in manifest.sensors if s.name == "zone_mean").key
    state = next(
        s.name
        for s in manifest.sensors
        if s.key == zone and s.variable == "Zone Air Temperature" and s.aggregation is Aggregation.INSTANT
    )
    pairs = [
        (state, "zone_mean"),
        ("hvac_power_instant", "hvac_and_plant_power"),
        ("zone_cooling_rate_instant", "zone_cooling_rate"),
    ]
    for name, mean in pairs:
        assert (expected[:, column[name]] != expected[:, column[mean]]).sum() > 100, name
        assert (got[:, column[name]] != expected[:, column[mean]]).sum() > 100, name
        assert (got[:, column[mean]] != expected[:, column[name]]).sum() > 100, name


def test_fidelity__energy_follows_from_means(divided) -> None:
    """The HVAC's meter is the mean power times the length of the timestep; with the state it would not be."""
    manifest, got, _ = divided
    column = {name: i for i, name in enumerate(manifest.names)}
    energy_j = got[:, column["hvac_electricity"]]
    seconds = manifest.step_s
    np.testing.assert_allclose(got[:, column["hvac_and_plant_power"]] * seconds, energy_j, rtol=1e-9, atol=1e-3)
    wrong_j = got[:, column["hvac_power_instant"]] * seconds
    assert (~np.isclose(wrong_j, energy_j, rtol=1e-6, atol=1e-3)).sum() > 50


@pytest.mark.slow
@pytest.mark.parametrize("case", YEARS, ids=_name)
def test_fidelity__year_equals_energyplus_alone(case: Case, folder: Path) -> None:
    manifest, got, expected = _both(case, folder)
    _check_kinds(manifest)
    assert manifest.steps == 35040
    check_equal(manifest, got, expected)
