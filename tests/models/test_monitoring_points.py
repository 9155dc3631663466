"""Unobserved points of a run: a scenario's own, and those that `monitoring` adds."""

from collections.abc import Mapping
from dataclasses import replace

import pytest

from zenostat.models.building.model import Building
from zenostat.models.points.discovery import ActuatorPoint, MeterPoint, PointCatalog, Variable, hvac_meters
from zenostat.models.points.monitoring import with_monitoring, with_unobserved
from zenostat.models.points.selection import Points, default_meters, select_points
from zenostat.topics.errors import UnknownName

THERMOSTAT = "Zone Temperature Control"
BUILDING = Building("b", {"Building": {"b": {}}}, "0")


def state(name: str, key: str, unit: str = "degC") -> Variable:
    return Variable(name, key, unit, system=name.startswith("Zone Air"), summed=False)


METERS = tuple(
    MeterPoint(name, "J", index)
    for index, name in enumerate(
        ("Electricity:Facility", "Electricity:HVAC", "NaturalGas:Facility", "Fans:Electricity", "Cooling:Electricity",
         "Cooling:EnergyTransfer", "Heating:NaturalGas", "InteriorLights:Electricity",
         "InteriorLights:Electricity:Zone:CORE ZN", "WaterSystems:NaturalGas", "WaterSystems:MainsWater")
    )
)  # fmt: skip
CATALOG = PointCatalog(
    variables=(
        state("Site Outdoor Air Drybulb Temperature", "Environment"),
        state("Zone Air Temperature", "CORE ZN"),
        state("Zone Mean Air Temperature", "CORE ZN"),
        state("Zone Air Temperature", "ATTIC"),
        state("Zone People Occupant Count", "CORE ZN", "1"),
        state("Zone People Occupant Count", "ATTIC", "1"),
        state("Zone Thermostat Heating Setpoint Temperature", "CORE ZN"),
        state("Zone Thermostat Cooling Setpoint Temperature", "CORE ZN"),
    ),
    meters=(*METERS, *hvac_meters(METERS)),
    actuators=(ActuatorPoint(THERMOSTAT, "Heating Setpoint", "CORE ZN", "degC"),),
)  # fmt: skip
ADDED_SENSORS = {
    "outdoor_temperature": ("Site Outdoor Air Drybulb Temperature", "Environment"),
    "core_zn_air_temperature": ("Zone Air Temperature", "CORE ZN"),
    "core_zn_occupants": ("Zone People Occupant Count", "CORE ZN"),
    "core_zn_thermostat_heating_setpoint": ("Zone Thermostat Heating Setpoint Temperature", "CORE ZN"),
    "core_zn_thermostat_cooling_setpoint": ("Zone Thermostat Cooling Setpoint Temperature", "CORE ZN"),
}
ADDED_METERS = {
    "electricity_facility": "Electricity:Facility",
    "naturalgas_facility": "NaturalGas:Facility",
    "hvac_electricity": "HVAC:Electricity",
    "hvac_natural_gas": "HVAC:NaturalGas",
    "heating_natural_gas": "Heating:NaturalGas",
    "cooling_electricity": "Cooling:Electricity",
    "fans_electricity": "Fans:Electricity",
    "interior_lights_electricity": "InteriorLights:Electricity",
    "water_systems_natural_gas": "WaterSystems:NaturalGas",
}


def own(sensors: Mapping[str, tuple[str, ...]] | None = None, meters: Mapping[str, str] | None = None) -> Points:
    return select_points(BUILDING, CATALOG, sensors or {}, meters or {}, {})


def monitored(points: Points) -> Points:
    return with_monitoring(BUILDING, CATALOG, points)


def test_monitoring_points__zones_with_a_thermostat_the_weather_and_all_end_uses_are_added_unobserved() -> None:
    points = monitored(own())
    assert {s.name: (s.variable, s.key) for s in points.sensors} == ADDED_SENSORS  # no attic: it has no thermostat
    assert {m.name: m.meter for m in points.meters} == ADDED_METERS  # no energy transfer, no water, no zone's meter
    assert not any(point.observed for point in (*points.sensors, *points.meters))
    assert points.system == (False, True, False, False, False)
    parts = {
        "HVAC:Electricity": ("Cooling:Electricity", "Fans:Electricity"), "HVAC:NaturalGas": ("Heating:NaturalGas",)
    }  # fmt: skip
    added_up = [tuple(part.name for part in parts) for parts in points.meter_parts]
    assert added_up == [parts.get(meter.meter, (meter.meter,)) for meter in points.meters]
    assert all(METERS[part.index] is part for parts in points.meter_parts for part in parts)


def test_monitoring_points__fuel_that_the_hvac_does_not_use_has_a_meter_of_zero() -> None:
    electric = tuple(meter for meter in METERS if meter.name != "Heating:NaturalGas")
    catalog = replace(CATALOG, meters=(*electric, *hvac_meters(electric)))
    points = with_monitoring(BUILDING, catalog, own())
    assert {m.name: m.meter for m in points.meters} == {
        name: meter for name, meter in ADDED_METERS.items() if meter != "Heating:NaturalGas"
    }
    parts = dict(zip((meter.meter for meter in points.meters), points.meter_parts, strict=True))
    assert parts["HVAC:NaturalGas"] == ()
    assert len(parts["HVAC:Electricity"]) == 2


@pytest.mark.parametrize("generates", [True, False])
def test_monitoring_points__generation_and_purchase_are_measured_where_there_are_generators(generates: bool) -> None:
    names = {"purchased": "Purchased", "surplus_sold": "SurplusSold", "net": "Net"}
    names |= {"produced": "Produced"} if generates else {}
    present = (*METERS, *(MeterPoint(f"Electricity{name}:Facility", "J", len(METERS)) for name in names.values()))
    points = with_monitoring(BUILDING, replace(CATALOG, meters=(*present, *hvac_meters(present))), own())
    added = {m.name: m.meter for m in points.meters if m.name not in ADDED_METERS}
    expected = {f"electricity_{own}_facility": f"Electricity{name}:Facility" for own, name in names.items()}
    assert added == (expected if generates else {})


def test_default_meters__hvac_electricity_of_a_model_whose_hvac_uses_none_is_no_default() -> None:
    meters = (MeterPoint("Electricity:Facility", "J", 0), MeterPoint("InteriorLights:Electricity", "J", 1))
    catalog = replace(CATALOG, meters=(*meters, *hvac_meters(meters)))
    assert catalog.meters[-1].name == "HVAC:Electricity"
    assert set(default_meters(catalog).values()) == {"Electricity:Facility"}


def test_monitoring_points__own_points_stay_first_and_are_measured_once() -> None:
    points = own(
        {
            "mean": ("zone mean air temperature", "core zn"),
            "out": ("Site Outdoor Air Drybulb Temperature", "ENVIRONMENT"),
        },
        {"total": "electricity:facility"},
    )
    extended = monitored(points)
    assert extended.sensors[:2] == points.sensors
    assert extended.meters[:1] == points.meters
    assert all(point.observed for point in (*points.sensors, *points.meters))
    assert [s.name for s in extended.sensors[2:]] == list(ADDED_SENSORS)[2:]
    assert [m.name for m in extended.meters[1:]] == list(ADDED_METERS)[1:]


def test_monitoring_points__setpoint_that_a_thermostat_never_has_is_left_out() -> None:
    control = {"control_1_object_type": "ThermostatSetpoint:SingleHeating", "control_1_name": "night"}
    objects = {
        "Zone": {"Core ZN": {}},
        "ThermostatSetpoint:SingleHeating": {"night": {"setpoint_temperature_schedule_name": "heat"}},
        "ZoneControl:Thermostat": {"core": {"zone_or_zonelist_name": "Core ZN", **control}},
    }
    names = {sensor.name for sensor in with_monitoring(Building("b", objects, "0"), CATALOG, own()).sensors}
    assert ADDED_SENSORS.keys() - names == {"core_zn_thermostat_cooling_setpoint"}


def test_monitoring_points__points_are_added_once_only() -> None:
    points = monitored(own())
    assert monitored(points) == points


def test_monitoring_points__name_that_is_taken_gets_a_number() -> None:
    points = monitored(
        own(
            {
                "core_zn_occupants": ("Zone Air Temperature", "ATTIC"),
                "hvac_electricity": ("Zone Air Temperature", "ATTIC"),
            },
            {"outdoor_temperature": "Cooling:EnergyTransfer"},
        )
    )
    names = [*(s.name for s in points.sensors), *(m.name for m in points.meters)]
    assert len(set(names)) == len(names)
    assert {"outdoor_temperature_2", "core_zn_occupants_2", "hvac_electricity_2"} <= set(names)


def test_monitoring_points__scenario_names_its_own_unobserved_points() -> None:
    points = own(
        {"a": ("Zone Air Temperature", "ATTIC"), "b": ("Zone Air Temperature", "CORE ZN")}, {"m": "Electricity:HVAC"}
    )
    hidden = with_unobserved(points, ["a", "m"])
    assert [s.observed for s in hidden.sensors] == [False, True]
    assert [m.observed for m in hidden.meters] == [False]
    assert with_unobserved(points, []) == points
    with pytest.raises(UnknownName, match=r"no sensor or meter 'bb'.*'b'"):
        with_unobserved(points, ["a", "bb"])
