"""Roles of points: on manifests by hand, of fakes, of a Python plant, and of all scenarios of the data pack."""

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import manifest, meter, sensor
from support.data_packs import sinergym

from zenostat.agent_sdk.rewards.energy_meter import EnergyMeter
from zenostat.agent_sdk.testing import FakeBuilding
from zenostat.bridge.python_plant.description import describe as describe_plant
from zenostat.bridge.python_plant.description import load_class
from zenostat.metrics.comfort import DEFAULT_BAND_DEGC
from zenostat.metrics.energy_meters import FUELS, facility_sources, hvac_sources
from zenostat.metrics.reward_comfort import comfort, display_comfort
from zenostat.metrics.roles import PowerSource, roles
from zenostat.topics.keys import safe_name
from zenostat.topics.messages import Actuator, Aggregation, Manifest, Meter, Sensor, Task
from zenostat.topics.units import units_of
from zenostat.views.room.description import describe

JULY = datetime(2017, 7, 3, 12)


def thermostat(zone: str, kind: str) -> Actuator:
    name = f"{zone.lower()}_{kind.lower()}_setpoint"
    return Actuator(
        name=name, component_type="Zone Temperature Control", control_type=f"{kind} Setpoint", key=zone, unit="degC"
    )


def schedule(name: str, key: str = "S", unit: str = "1") -> Actuator:
    return Actuator(name=name, component_type="Schedule:Compact", control_type="Schedule Value", key=key, unit=unit)


OFFICE = manifest(
    sensors=[
        sensor("out", "Site Outdoor Air DryBulb Temperature", "Environment"),
        sensor("a", "Zone Mean Air Temperature", "PERIMETER_BOT_ZN_1"),
        sensor("b", "Zone Air Temperature", "core_bottom"),
        sensor("b_again", "Zone Air Temperature", "Core_Bottom").model_copy(update={"aggregation": Aggregation.MEAN}),
        sensor("b_people", "Zone People Occupant Count", "CORE_BOTTOM", "1"),
        sensor("b_rh", "Zone Air Relative Humidity", "CORE_BOTTOM", "percent"),
        sensor("b_heat", "Zone Thermostat Heating Setpoint Temperature", "CORE_BOTTOM"),
        sensor("b_cool", "Zone Thermostat Cooling Setpoint Temperature", "CORE_BOTTOM"),
        sensor("wind", "Site Wind Speed", "Environment", "m/s"),
        sensor("demand", "Facility Total HVAC Electricity Demand Rate", "Whole Building", "W"),
    ],
    meters=[
        meter("all", "electricity:facility"),
        meter("lights", "InteriorLights:Electricity"),
        meter("gas", "NaturalGas:Facility"),
        meter("boiler", "Heating:NaturalGas"),
        meter("coils", "Cooling:EnergyTransfer"),
        meter("cooling", "Cooling:Electricity"),
    ],
    actuators=[thermostat("CORE_BOTTOM", "Cooling"), thermostat("CORE_BOTTOM", "Heating")],
)


def test_roles__by_hand() -> None:
    identified = roles(OFFICE)
    first, second = identified.zones
    assert (first.key, first.label, first.place, first.temperature) == (
        "PERIMETER_BOT_ZN_1", "Perimeter bottom 1", 0, 1,
    )  # fmt: skip
    assert (first.occupants, first.heating_actuator, first.cooling_setpoint) == (None, None, None)
    assert (second.label, second.place, second.temperature) == ("Core bottom", 1, 2)
    assert (second.occupants, second.humidity, second.heating_setpoint, second.cooling_setpoint) == (4, 5, 6, 7)
    assert (second.heating_actuator, second.cooling_actuator) == (1, 0)
    assert identified.outdoor_temperature == 0
    to_kw = 1.0 / 900.0 / 1000.0  # J in a quarter of an hour
    assert identified.facility_power == PowerSource(10, pytest.approx(to_kw), "Whole building")  # type: ignore[arg-type]
    assert identified.hvac_power == PowerSource(9, 1e-3, "HVAC and plant")
    assert [(use.label, use.fuel, use.index) for use in identified.end_uses] == [
        ("heating", "natural gas", 13),
        ("cooling", "electricity", 15),
        ("interior lights", "electricity", 11),
    ]
    assert [(fuel.fuel, fuel.index) for fuel in identified.fuels] == [("electricity", 10), ("natural gas", 12)]
    assert identified.others == {"degC": (3,), "m/s": (8,), "J": (14,)}
    assert identified.labels[6] == "B heat"
    assert identified.actuator_labels == ("Core bottom cooling setpoint", "Core bottom heating setpoint")
    assert all(use.to_kw == pytest.approx(to_kw) for use in (*identified.end_uses, *identified.fuels))


def test_hvac_power__is_that_of_the_end_uses_where_they_are_measured() -> None:
    groups, uses, gas = (
        meter(name.replace(":", "_"), name) for name in ("Electricity:HVAC", "HVAC:Electricity", "HVAC:NaturalGas")
    )
    to_kw = pytest.approx(1.0 / 900.0 / 1000.0)
    identified = roles(manifest(meters=[groups, uses, gas]))
    assert identified.hvac_power == PowerSource(1, to_kw, "HVAC")  # type: ignore[arg-type]
    assert [(fuel.fuel, fuel.index) for fuel in identified.hvac_fuels] == [("natural gas", 2)]
    assert identified.others == {"J": (0,)}
    without = roles(manifest(sensors=OFFICE.sensors, meters=[groups]))
    assert without.hvac_power == PowerSource(10, to_kw, "HVAC without plant")  # type: ignore[arg-type]


def test_roles__zone_has_its_place_and_color_in_the_building_whatever_is_measured() -> None:
    zones = ("Attic", "Core_bottom", "Perimeter_bot_ZN_1")
    whole = roles(OFFICE.model_copy(update={"zones": zones}))
    assert [(zone.key, zone.place) for zone in whole.zones] == [
        ("Core_bottom", 1), ("Perimeter_bot_ZN_1", 2),
    ]  # fmt: skip
    part = roles(OFFICE.model_copy(update={"zones": zones, "sensors": OFFICE.sensors[1:2]}))
    assert [(zone.label, zone.place) for zone in part.zones] == [("Perimeter bottom 1", 2)]


def test_roles__setpoints_that_are_schedules_serve_the_zones_that_their_names_tell() -> None:
    air = [sensor(safe_name(zone), key=zone) for zone in ("Zone1 Office", "Zone2 Fine Storage", "First Plenum")]
    one = roles(manifest(sensors=air, actuators=[schedule("Heating_Setpoint_RL"), schedule("fan_speed")]))
    assert [zone.heating_actuator for zone in one.zones] == [0, 0, None]  # a plenum has no thermostat
    assert [zone.cooling_actuator for zone in one.zones] == [None] * 3
    names = [
        "office_cooling_setpoint", "cooling_setpoint", "supply_air_cooling_setpoint", "fine_storage_cooling_setpoint",
    ]  # fmt: skip
    several = roles(manifest(sensors=air, actuators=[schedule(name) for name in names]))
    assert [zone.cooling_actuator for zone in several.zones] == [0, 3, None]
    watts = roles(manifest(sensors=air, actuators=[schedule("heating_setpoint", unit="W")]))
    assert watts.zones[0].heating_actuator is None


def test_roles__empty_manifest_has_no_roles() -> None:
    identified = roles(manifest())
    assert (identified.zones, identified.others, identified.end_uses, identified.hvac_power) == ((), {}, (), None)


@pytest.mark.parametrize("is_energyplus", [True, False])
def test_roles__fake_building_has_zones_and_powers_under_energyplus_names_and_as_a_plant(
    *, is_energyplus: bool
) -> None:
    of = FakeBuilding(2).manifest
    if not is_energyplus:  # as a node describes a Python plant: names, units and bounds
        of = of.model_copy(
            update={
                "sensors": tuple(Sensor(name=s.name, unit=s.unit) for s in of.sensors),
                "meters": tuple(Meter(name=m.name, unit=m.unit) for m in of.meters),
                "actuators": tuple(Actuator(name=a.name, unit=a.unit) for a in of.actuators),
            }
        )
    identified = roles(of)
    assert [zone.label for zone in identified.zones] == ["Zone 1", "Zone 2"]
    assert [(z.temperature, z.occupants, z.heating_actuator, z.cooling_actuator) for z in identified.zones] == [
        (2, 3, 0, 1), (4, 5, 2, 3),
    ]  # fmt: skip
    assert identified.outdoor_temperature == 0
    assert (identified.facility_power, identified.hvac_power) == (
        PowerSource(6, 1 / 9e5, "Whole building"), PowerSource(7, 1 / 9e5, "HVAC"),
    )  # fmt: skip


def test_roles__plant_of_ones_own_has_a_room_and_its_tank_is_none() -> None:
    example = Path(__file__).parents[2] / "examples" / "own_plant.py"
    plant = describe_plant(load_class(f"{example}:HeatPumpRoom")())
    of = manifest(
        sensors=[Sensor(name=p.name, unit=p.unit) for p in plant.sensors],
        meters=[Meter(name=p.name, unit=p.unit) for p in plant.meters],
        actuators=[Actuator(name=p.name, unit=p.unit) for p in plant.actuators],
    )
    identified = roles(of)
    names = of.names
    assert [(zone.label, names[zone.temperature or 0]) for zone in identified.zones] == [("Room", "room_temperature")]
    assert identified.outdoor_temperature == names.index("outdoor_temperature")
    assert identified.facility_power is not None
    assert identified.facility_power.index == names.index("electricity")
    assert [names[index] for indices in identified.others.values() for index in indices] == ["tank_temperature", "cop"]


def test_roles__only_power_sensor_of_a_plant_is_its_power() -> None:
    sensors = [Sensor(name="temperature", unit="degC"), Sensor(name="heat_pump_power", unit="kW")]
    identified = roles(manifest(sensors=sensors))
    assert identified.facility_power == PowerSource(1, 1.0, "Whole building")
    assert [zone.label for zone in identified.zones] == []  # it may be that of a tank


@pytest.mark.parametrize("name", ["solar_gain", "heating_power", "heat_pump", "pv_power"])
def test_roles__power_that_may_not_be_electric_is_no_electricity(name: str) -> None:
    identified = roles(manifest(sensors=[Sensor(name=name, unit="W")]))
    assert (identified.facility_power, identified.others) == (None, {"W": (0,)})


@pytest.mark.parametrize("fuel", [*FUELS])
def test_roles__fuels_of_a_plant_of_ones_own_are_those_of_the_metrics(fuel: str) -> None:
    names = (f"{fuel}", f"hvac_{fuel}", f"heating_{fuel}")
    of = manifest(meters=[Meter(name=name, unit="J") for name in names])
    identified = roles(of)
    (whole,) = identified.fuels
    (use,) = identified.end_uses
    assert (whole.index, use.index, use.label) == (0, 2, "heating")
    assert [part.index for part in identified.hvac_fuels] == ([] if fuel == "electricity" else [1])
    assert {name: source.index for name, source in facility_sources(of).items()} == {fuel: 0}
    assert {name: source.index for name, source in hvac_sources(of).items()} == {fuel: 1}


def of_scenario(scenario: Any) -> Manifest:
    """The manifest of a scenario of the data pack as far as it follows from its definition, without EnergyPlus."""

    def unit(variable: str) -> str:
        return "degC" if "Temperature" in variable else "W" if "Demand Rate" in variable else "1"

    return manifest(
        sensors=[sensor(n, s.variable, s.key, unit(s.variable)) for n, s in scenario.sensors.items()],
        meters=[meter(name, of) for name, of in (scenario.meters or {}).items()],
        actuators=[schedule(name, spec.key) for name, spec in scenario.actuators.items()],
    )


ZONES = {
    "demo": (1, 1), "5zone": (1, 1), "datacenter_dx": (2, 0), "datacenter_cw": (2, 0), "smalldatacenter": (1, 0),
    "office": (18, 15), "warehouse": (3, 1), "officegrid": (19, 16), "shop": (5, 5), "radiant": (5, 0),
}  # fmt: skip
"""By building: zones with a temperature, and those whose heating setpoint an action sets (plenums have none)."""


def test_roles__scenarios_of_the_data_pack() -> None:
    sinergym()
    from zenostat.models.sinergym.scenarios import pack_scenarios

    first = {name.partition("-")[0]: scenario for name, scenario in reversed(list(pack_scenarios().items()))}
    assert first.keys() == ZONES.keys()
    for building, scenario in first.items():
        identified = roles(of_scenario(scenario))
        heated = [zone for zone in identified.zones if zone.heating_actuator is not None]
        assert (len(identified.zones), len(heated)) == ZONES[building], building
        assert identified.hvac_power is not None
        assert identified.outdoor_temperature is not None
        assert len({zone.label for zone in identified.zones}) == len(identified.zones)


# Comfort


def test_roles__band_of_a_reward_has_its_zones_in_metrics_and_all_zones_in_pictures() -> None:
    of = FakeBuilding(3, reward={"kind": "linear", "temperatures": ["zone_2_air_temperature"]}).manifest
    values = np.full(len(of.points), 27.5)
    rated, shown = comfort(of), display_comfort(of)
    assert rated is not None
    assert shown is not None
    assert [of.names[index] for index in rated.zones] == ["zone_2_air_temperature"]
    assert len(shown.zones) == 3
    for limits in (rated.limits(values, JULY), shown.limits(values, JULY)):
        assert [{*row.tolist()} for row in limits] == [{23.0}, {26.0}]
    np.testing.assert_allclose(shown.deviations(values, JULY), 1.5)
    np.testing.assert_allclose(shown.deviations(values - 6.0, JULY), -1.5)
    np.testing.assert_allclose(shown.deviations(values - 3.0, JULY), 0.0)


def test_roles__pictures_have_a_band_where_the_reward_has_none_or_there_is_no_reward() -> None:
    of = FakeBuilding(2, reward=None).manifest
    assert comfort(of) is None
    shown = display_comfort(of)
    low, high = shown.limits(np.zeros(len(of.points)), JULY)
    assert [(low.tolist(), high.tolist())] == [([b] * 2, [c] * 2) for b, c in [DEFAULT_BAND_DEGC]]
    assert shown.source == "2 zones, 20 to 26 °C"
    assert display_comfort(of.model_copy(update={"sensors": ()})) is None


def test_roles__setpoints_of_zones_are_their_bands_and_others_have_the_band_of_pictures() -> None:
    of = OFFICE.model_copy(update={"task": Task(reward={"kind": "multi_zone", "zones": {"b": ["b_heat", "b_cool"]}})})
    values = {"b": 24.0, "a": 27.0, "b_heat": 21.0, "b_cool": 23.0}
    row = np.array([values.get(name, 0.0) for name in of.names])
    shown = display_comfort(of)
    low, high = shown.limits(row, JULY)
    assert list(zip(low.tolist(), high.tolist(), strict=True)) == [(20.0, 26.0), (20.5, 23.5)]  # a threshold of 0.5 K
    np.testing.assert_allclose(shown.deviations(row, JULY), [1.0, 0.5])


@pytest.mark.parametrize("name", ["old_house_flow_temperature", "tank_temperature", "exchange_house_flow_temperature"])
def test_roles__temperature_of_a_fluid_is_no_zone(name: str) -> None:
    assert roles(manifest(sensors=[Sensor(name=name, unit="degC")])).zones == ()


def test_roles__only_temperature_of_a_plant_with_a_setpoint_is_a_zone() -> None:
    plant = manifest(
        sensors=[Sensor(name="temperature", unit="degC")], actuators=[Actuator(name="setpoint", unit="degC")]
    )
    assert len(roles(plant).zones) == 1


ENERGIES = {
    "J": 3.6e6, "kJ": 3600.0, "MJ": 3.6, "GJ": 3.6e-3, "Wh": 1000.0, "kWh": 1.0, "MWh": 1e-3, "kBtu": 3.412141633,
    "therm": 0.03412141633,
}  # fmt: skip
"""1 kWh in each unit of energy; a BTU is 1055.05585262 J."""
POWERS = {"W": 4000.0, "kW": 4.0, "MW": 0.004}
"""The mean power of 1 kWh in a quarter of an hour."""


def test_units__those_of_energy_and_power_are_all_checked() -> None:
    assert {*ENERGIES} == {*units_of("energy")}
    assert {*POWERS} == {*units_of("power")}


@pytest.mark.parametrize(("unit", "value"), (ENERGIES | POWERS).items())
def test_units__kilowatt_hour_of_a_quarter_of_an_hour_counts_everywhere_in_each_unit(unit: str, value: float) -> None:
    power = sensor("electricity", "Facility Total Electricity Demand Rate", "Whole Building", unit)
    meters = [Meter(name="electricity", meter="Electricity:Facility", unit=unit)] if unit in ENERGIES else []
    of = manifest(sensors=[] if meters else [power], meters=meters)
    (source,) = facility_sources(of).values()
    shown = roles(of).facility_power
    (point,) = describe(of, None).content["points"]
    reward = EnergyMeter("linear", ["electricity"], of)
    assert shown is not None
    assert value * source.to_kwh == pytest.approx(1.0)
    assert value * shown.to_kw == pytest.approx(4.0)
    assert (point["unit"], value * point["factor"]) == ("kW", pytest.approx(4.0))
    assert reward.kwh(np.array([value])) == pytest.approx(1.0)
