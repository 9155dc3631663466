"""Output variables that EnergyPlus computes only on request are not 0, and requesting them writes no files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.data_packs import sinergym
from support.energyplus_reference import Case, check_equal, run_both
from support.nodes import SMALL, WEATHER

from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import plan
from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building, find_weather
from zenostat.models.points.discovery import discover
from zenostat.topics.energyplus_names import COMPUTED_ON_REQUEST
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.points import bound_arrays

CASE = Case("warehouse", WEATHER, "07-01", "07-02", 4)


@pytest.mark.slow
def test_each_variable__equals_the_report_and_is_not_constant(folder: Path) -> None:
    """The oscillating temperatures, of which some are 0 in each building, are only compared."""
    points = discover(read_building(find_building(CASE.building)), find_weather(WEATHER).path)
    keys = {}
    for variable in points.variables:
        if variable.name.casefold() in COMPUTED_ON_REQUEST and variable.key != "ZONE3UNITHEATERAIRINLETNODE":
            keys.setdefault(variable.name, variable.key)
    assert len(keys) >= len(COMPUTED_ON_REQUEST) - 1  # spaces have points only where a model defines them
    sensors = {name.replace(" ", "_").lower(): [name, key] for name, key in keys.items()}
    sensors["inlet"] = ["System Node Relative Humidity", "Zone3UnitHeaterAirInletNode"]
    sensors["temperature"] = ["Zone Air Temperature", "Zone1 Office"]
    manifest, got, expected = run_both(CASE, folder / "run", sensors=sensors)
    check_equal(manifest, got, expected)
    constant = [name for i, name in enumerate(manifest.names) if len(np.unique(got[:, i])) == 1]
    assert not [name for name in constant if "node" in name or "globe" in name or name == "inlet"]
    assert np.unique(got[:, manifest.names.index("zone_oscillating_temperatures_time")]).tolist() == [0.0, 0.25]
    episodes = list((folder / "run" / "run").rglob("episode-*"))
    written = {path.name for episode in episodes for path in episode.rglob("*") if path.is_file()}
    assert not {name for name in written if name.endswith((".eso", ".mtr", ".sql", ".csv", ".rdd"))}


@pytest.mark.slow
def test_every_variable_and_meter__equals_the_report_within_its_bounds(folder: Path) -> None:
    """Also the setpoints of nodes that have none, which EnergyPlus reports as -999."""
    sinergym()
    case = replace(CASE, building="1ZoneDataCenterCRAC_wApproachTemp")
    points = discover(read_building(find_building(case.building)), find_weather(WEATHER).path)
    sensors = {f"s{i}": [v.name, v.key] for i, v in enumerate(points.by_variable.values())}
    meters = {f"m{i}": meter.name for i, meter in enumerate(points.meters)}
    manifest, got, expected = run_both(case, folder, sensors=sensors, meters=meters, actuators={})
    check_equal(manifest, got, expected)
    low, high = bound_arrays(manifest.points)
    outside = ((got < low) | (got > high)).any(axis=0)
    assert not [point for point, is_outside in zip(manifest.points, outside, strict=True) if is_outside]
    assert -999.0 in got


@pytest.mark.parametrize(
    ("edits", "hint"),
    [
        (
            {"output:variable": {"mine": {"key_value": "*", "variable_name": "System Node Temperature"}}},
            "Output:Variable 'mine' has no effect, because output objects are left out; "
            "to observe an output variable, name it in `sensors`",
        ),
        ({"Output:Meter": {"mine": {"key_name": "Electricity:Facility"}}}, "name it in `meters`"),
        ({"OutputControl:Files": {"mine": {"output_csv": "Yes"}}}, "OutputControl:Files 'mine' has no effect"),
        ({"Output:JSON": {"mine": {"option_type": "TimeSeries"}}}, "Output:JSON 'mine' has no effect"),
        (
            {"Output:Diagnostics": {"mine": {"diagnostics": [{"key": "DisplayExtraWarnings"}]}}},
            "Output:Diagnostics 'mine' has no effect",
        ),
    ],
)
def test_edits_of_output_objects__are_rejected_where_they_have_no_effect(
    edits: dict[str, object], hint: str, folder: Path
) -> None:
    config: dict[str, object] = {**SMALL, "edits": edits}
    with pytest.raises(InvalidConfig, match=hint):
        plan(read_config(config))
    plan(read_config(config | {"output_dir": str(folder)}))


def test_edits_that_act_or_remove__are_accepted() -> None:
    edits = {
        "Output:Variable": {"*": None},
        "OutputControl:ReportingTolerances": {"*": {"tolerance_for_time_heating_setpoint_not_met": 0.5}},
    }
    plan(read_config({**SMALL, "edits": edits}))


@pytest.mark.slow
def test_diagnostics_that_act_on_the_simulation__are_kept(folder: Path) -> None:
    """Without its mirror image, a screen in front of the south wall does not shade it."""
    corners = [(0, 6), (0, 0), (27, 0), (27, 6)]
    vertices = [{"vertex_x_coordinate": x, "vertex_y_coordinate": -2, "vertex_z_coordinate": z} for x, z in corners]
    screen = {"Shading:Building:Detailed": {"screen": {"number_of_vertices": 4, "vertices": vertices}}}
    not_mirrored = {"Output:Diagnostics": {"mine": {"diagnostics": [{"key": "DoNotMirrorDetachedShading"}]}}}
    sun = ["Surface Outside Face Incident Beam Solar Radiation Rate per Area", "Perimeter_ZN_1_wall_south"]
    received = {}
    for name, edits in {"open": {}, "mirrored": screen, "one-sided": screen | not_mirrored}.items():
        case = Case("ref-small-office", WEATHER, "01-10", "01-10", 4, edits)
        manifest, got, expected = run_both(case, folder / name, sensors={"sun": sun}, meters={}, actuators={})
        check_equal(manifest, got, expected)
        received[name] = got.sum()
    assert received["mirrored"] < received["one-sided"] == received["open"]
