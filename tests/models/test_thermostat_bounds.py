"""Default bounds of setpoints: what the building's own schedules do, and never heating above cooling."""

from pathlib import Path
from typing import Any

import pytest

from zenostat.lab.benchmark.definition import BUILDINGS
from zenostat.lab.benchmark.observation import sensors
from zenostat.models.building.conflicts import thermostat_setpoints
from zenostat.models.building.model import Building, read_building
from zenostat.models.catalog import bundled_buildings, find_building, find_weather
from zenostat.models.points import discovery, selection
from zenostat.models.points.thermostat_bounds import _values, setpoint_bounds
from zenostat.topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT, OCCUPANTS

DUAL = "ThermostatSetpoint:DualSetpoint"


def thermostat(zone: str, setpoints: str, heating: str = "", cooling: str = "") -> dict[str, Any]:
    """A zone's thermostat with a dual setpoint of this name."""
    schedules = {"heating": heating, "cooling": cooling}
    return {
        "ZoneControl:Thermostat": {
            f"{zone} thermostat": {
                "zone_or_zonelist_name": zone, "control_1_object_type": DUAL, "control_1_name": setpoints,
            }
        },
        DUAL: {setpoints: {f"{kind}_setpoint_temperature_schedule_name": name for kind, name in schedules.items()}},
    }  # fmt: skip


def building(schedules: dict[str, Any]) -> Building:
    return Building("a.epJSON", {**thermostat("Hall", "t", heating="heat"), **schedules}, "")


def constant_setpoints(**zones: tuple[float, float]) -> Building:
    """A building whose zones have constant heating and cooling setpoints."""
    objects: dict[str, Any] = {"ZoneControl:Thermostat": {}, DUAL: {}, "Schedule:Constant": {}}
    for zone, setpoints in zones.items():
        names = (f"{zone} heat", f"{zone} cool")
        for kind, items in thermostat(zone, f"{zone} setpoints", *names).items():
            objects[kind] |= items
        objects["Schedule:Constant"] |= {n: {"hourly_value": v} for n, v in zip(names, setpoints, strict=True)}
    return Building("a.epJSON", objects, "")


YEAR_END = "Through: 12/31"


def compact(*fields: str | float) -> dict[str, Any]:
    return {"Schedule:Compact": {"Heat": {"data": [{"field": field} for field in fields]}}}


YEAR: dict[str, Any] = {
    "Schedule:Year": {"heat": {"schedule_weeks": [{"schedule_week_name": "week", "start_month": 1}]}},
    "Schedule:Week:Daily": {
        "week": {
            "monday_schedule_day_name": "day",
            "winterdesignday_schedule_day_name": "design",
            "customday1_schedule_day_name": "design",
        }
    },
    "Schedule:Day:Interval": {
        "day": {"data": [{"time": "08:00", "value_until_time": 11.0}, {"time": "24:00", "value_until_time": 21.0}]},
        "design": {"data": [{"time": "24:00", "value_until_time": 6.0}]},
    },
}


def week_compact(days: str) -> dict[str, Any]:
    """A year whose setpoint on these days is 12 degC, and 20 degC on all others."""
    return {
        "Schedule:Year": YEAR["Schedule:Year"],
        "Schedule:Week:Compact": {
            "week": {
                "data": [
                    {"daytype_list": days, "schedule_day_name": "low"},
                    {"daytype_list": "AllOtherDays", "schedule_day_name": "high"},
                ]
            }
        },
        "Schedule:Day:Interval": {
            name: {"data": [{"time": "24:00", "value_until_time": value}]}
            for name, value in (("low", 12.0), ("high", 20.0))
        },
    }


@pytest.mark.parametrize(
    ("schedule", "expected"),
    [
        (compact(YEAR_END, "For: AllDays", "Until: 24:00", 7.2), 7.2),
        (compact(YEAR_END, "For: AllDays", "Until: 24:00", "7.2"), 7.2),  # EnergyPlus reads the text
        (compact(YEAR_END, "For: Weekdays", "Until: 24:00", 21.0, "For: WinterDesignDay", "Until: 24:00", 8.0), 15.0),
        (compact(YEAR_END, "For: Weekdays WinterDesignDay", "Until: 24:00", 9.0), 9.0),
        (compact(YEAR_END, "For: AllDays", "Until: 24:00", -60.0), 15.0),  # off
        (compact(YEAR_END, "For: AllDays", "Until: 24:00", 21.0), 15.0),
        ({"Schedule:Constant": {"HEAT": {"hourly_value": 12.5}}}, 12.5),
        ({"Schedule:Day:Hourly": {}, "Schedule:Compact": {}}, 15.0),  # of a program: unknown
        (YEAR, 11.0),
        (week_compact("For: Weekdays SummerDesignDay"), 12.0),
        (week_compact("WinterDesignDay, CustomDay1"), 15.0),
    ],
)
def test_thermostat_bounds__heating_goes_down_to_the_lowest_scheduled_setpoint(
    schedule: dict[str, Any], expected: float
) -> None:
    assert setpoint_bounds(building(schedule), HEATING_SETPOINT, "HALL") == (expected, 22.5)
    assert setpoint_bounds(building(schedule), COOLING_SETPOINT, "HALL") == (22.5, 30.0)
    assert setpoint_bounds(building(schedule), "Schedule Value", "HALL") is None


def test_thermostat_bounds__value_within_them_does_not_cross_the_zones_own_other_setpoint() -> None:
    rooms = constant_setpoints(lab=(20.0, 22.2), theater=(16.0, 16.5), sauna=(28.0, 35.0), cold_room=(4.0, 6.0))

    def bounds(zone: str | None) -> tuple[Any, Any]:
        return tuple(setpoint_bounds(rooms, kind, zone) for kind in (HEATING_SETPOINT, COOLING_SETPOINT))

    assert bounds("LAB") == ((15.0, 22.2), (22.5, 35.0))
    assert bounds("THEATER") == ((15.0, 16.5), (22.5, 35.0))
    assert bounds("SAUNA") == ((15.0, 22.5), (28.0, 35.0))
    assert bounds("COLD_ROOM") == ((5.0, 6.0), (22.5, 35.0))
    assert bounds("HALL") == ((15.0, 22.5), (22.5, 35.0))  # no thermostat that is known
    assert bounds(None) == ((15.0, 22.5), (22.5, 35.0))  # of one pair for all zones


def test_thermostat_bounds__values_of_a_file_are_those_of_its_column(tmp_path: Path) -> None:
    path = tmp_path / "setpoints.csv"
    path.write_text("hour;heating\n" + "\n".join(f"7;{13.5 if hour == 50 else 20}" for hour in range(8760)))
    of_file = {"file_name": str(path), "column_number": 2, "rows_to_skip_at_top": 1, "column_separator": "Semicolon"}
    assert setpoint_bounds(building({"Schedule:File": {"Heat": of_file}}), HEATING_SETPOINT, "HALL") == (13.5, 22.5)
    path.unlink()
    assert setpoint_bounds(building({"Schedule:File": {"Heat": of_file}}), HEATING_SETPOINT, "HALL") == (15.0, 22.5)


def test_thermostat_bounds__warehouse_can_be_heated_as_little_as_it_is() -> None:
    warehouse = read_building(find_building("ref-warehouse"))
    assert setpoint_bounds(warehouse, HEATING_SETPOINT, "ZONE1 OFFICE") == (7.2, 22.5)
    assert setpoint_bounds(warehouse, COOLING_SETPOINT, "ZONE1 OFFICE") == (22.5, 30.0)


@pytest.mark.slow
def test_thermostat_bounds__no_zone_of_a_bundled_building_can_be_heated_above_a_cooling_setpoint() -> None:
    for entry in bundled_buildings():
        of = read_building(entry)
        scheduled: dict[str, dict[str, set[float]]] = {}
        for zone, control, schedule in thermostat_setpoints(of.objects):
            scheduled.setdefault(zone, {}).setdefault(control, set()).update(_values(of, schedule))
        for zone, own in scheduled.items():
            heating, cooling = (setpoint_bounds(of, kind, zone) for kind in (HEATING_SETPOINT, COOLING_SETPOINT))
            assert heating is not None
            assert cooling is not None
            assert 5.0 < heating[0] <= 15.0 < heating[1] <= cooling[0] < 30.0 <= cooling[1] < 40.0, entry.name
            assert heating[1] <= min(own.get("cooling setpoint", {22.5})), (entry.name, zone)
            assert cooling[0] >= max(own.get("heating setpoint", {22.5})), (entry.name, zone)


@pytest.mark.parametrize("name", BUILDINGS)
def test_thermostat_bounds__benchmark_observes_every_zone_with_a_thermostat(name: str) -> None:
    model = read_building(find_building(name))
    offered = discovery.discover(model, find_weather("USA_IL_Chicago").path)
    zones = {spec[2] for spec in selection.default_actuators(offered).values()}
    observed = [spec for spec in sensors(name).values() if spec[0] == "Zone Air Temperature"]
    assert {zone for _, zone in observed} == zones
    people = {spec[1] for spec in sensors(name).values() if spec[0] == OCCUPANTS}
    default = selection.default_sensors(offered).values()
    assert people == {spec[1] for spec in default if spec[0] == OCCUPANTS}
