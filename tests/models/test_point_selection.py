"""The points of a run, chosen in a small model that is written out here; and the list of a whole one by EnergyPlus."""

import json
from collections import Counter
from datetime import date
from typing import Any

import pytest
from support.energyplus_alone import run_energyplus

from zenostat.models import catalog
from zenostat.models.building.model import Building, for_episode, read_building, write
from zenostat.models.building.summary import zone_areas
from zenostat.models.points.discovery import (
    ActuatorPoint,
    InternalVariable,
    MeterPoint,
    PointCatalog,
    Variable,
    discover,
    hvac_meters,
)
from zenostat.models.points.listing import PointListing, listing
from zenostat.models.points.selection import MeterSpec, Points, Spec, default_aggregation, select_points, sensor_bounds
from zenostat.models.run_period import Period
from zenostat.topics.energyplus_names import HVAC_METERS
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.messages import Aggregation
from zenostat.topics.units import limits, unit_name

THERMOSTAT = "Zone Temperature Control"


def state(name: str, key: str, unit: str, *, system: bool = False) -> Variable:
    return Variable(name, key, unit, system=system, summed=False)


METERS = tuple(
    MeterPoint(name, "J", index)
    for index, name in enumerate(
        ("Electricity:Facility", "Electricity:HVAC", "ElectricityNet:Facility", "Fans:Electricity")
    )
)
SURVEY = PointCatalog(
    variables=(
        state("Site Outdoor Air Drybulb Temperature", "Environment", "degC"),
        state("Zone Air Temperature", "CORE ZN", "degC", system=True),
        state("Zone Air Temperature", "ATTIC", "degC", system=True),
        state("Zone Air Relative Humidity", "CORE ZN", "percent", system=True),
        state("Zone People Occupant Count", "CORE ZN", "1"),
        state("Zone Thermostat Heating Setpoint Temperature", "CORE ZN", "degC"),
        state("Facility Total HVAC Electricity Demand Rate", "Whole Building", "W", system=True),
        Variable("Fan Electricity Energy", "FAN 1", "J", system=True, summed=True),
        state("Schedule Value", "LIGHTS", "1"),
    ),
    meters=(*METERS, *hvac_meters(METERS)),
    actuators=(
        ActuatorPoint(THERMOSTAT, "Heating Setpoint", "CORE ZN", "degC"),
        ActuatorPoint(THERMOSTAT, "Cooling Setpoint", "CORE ZN", "degC"),
        ActuatorPoint("Schedule:Compact", "Schedule Value", "LIGHTS", "1"),
        ActuatorPoint("Schedule:Compact", "Schedule Value", "FREE", "1"),
        ActuatorPoint("Fan", "Fan Air Mass Flow Rate", "FAN 1", "kg/s"),
    ),
    internal=(InternalVariable("Zone Floor Area", "CORE ZN", "m2"),),
)  # fmt: skip
BUILDING = Building(
    "b",
    {
        "Building": {"b": {}},
        "ScheduleTypeLimits": {
            "Fraction": {"lower_limit_value": 0, "upper_limit_value": 1},
            "Any": {"numeric_type": "Continuous"},
        },
        "Schedule:Compact": {"Lights": {"schedule_type_limits_name": "FRACTION"}, "Free": {}},
    },
    "0",
)


def chosen(
    sensors: Spec | None = None,
    meters: MeterSpec | None = None,
    actuators: Spec | None = None,
    survey: PointCatalog = SURVEY,
) -> Points:
    """The points that were asked for; None is none (not the default)."""
    return select_points(BUILDING, survey, sensors or {}, meters or {}, actuators or {})


def refused(**asked: Any) -> str:
    with pytest.raises((UnknownName, InvalidConfig)) as raised:
        chosen(**asked)
    return str(raised.value)


# What is asked for


def test_select_points__keeps_the_requested_order_and_energyplus_names() -> None:
    points = chosen(
        sensors={"b": ("zone air temperature", "core zn"), "a": ("FAN ELECTRICITY ENERGY", "Fan 1")},
        meters={"hvac": "electricity:hvac", "all": "Electricity:Facility"},
        actuators={"lights": ("schedule:compact", "schedule value", "Lights")},
    )
    assert [(s.name, s.variable, s.key, s.unit) for s in points.sensors] == [
        ("b", "Zone Air Temperature", "CORE ZN", "degC"),
        ("a", "Fan Electricity Energy", "FAN 1", "J"),
    ]
    assert points.system == (True, True)
    assert [(m.name, m.meter, m.unit) for m in points.meters] == [
        ("hvac", "Electricity:HVAC", "J"),
        ("all", "Electricity:Facility", "J"),
    ]
    assert points.meter_parts == ((METERS[1],), (METERS[0],))
    (lights,) = points.actuators
    assert (lights.component_type, lights.control_type, lights.key) == ("Schedule:Compact", "Schedule Value", "LIGHTS")


def test_point_selection__what_follows_the_system_timestep_is_known() -> None:
    points = chosen(sensors={"o": ("Zone People Occupant Count", "Core ZN"), "t": ("Zone Air Temperature", "Core ZN")})
    assert points.system == (False, True)


def test_select_points__returns_none_if_none_is_requested() -> None:
    points = chosen()
    assert (points.sensors, points.meters, points.actuators) == ((), (), ())


# Readings


@pytest.mark.parametrize(
    ("unit", "summed", "aggregation"),
    [
        ("W", False, Aggregation.MEAN),
        ("kg/s", False, Aggregation.MEAN),
        ("m3/s", False, Aggregation.MEAN),
        ("W/m2", False, Aggregation.MEAN),
        ("degC", False, Aggregation.INSTANT),
        ("percent", False, Aggregation.INSTANT),
        ("1", False, Aggregation.INSTANT),
        ("J", True, Aggregation.SUM),
        ("m3", True, Aggregation.SUM),
        ("W", True, Aggregation.SUM),
    ],
)
def test_point_selection__rates_are_means_states_are_instants_and_sums_are_sums(
    unit: str, summed: bool, aggregation: Aggregation
) -> None:
    assert default_aggregation(Variable("v", "k", unit, system=True, summed=summed)) is aggregation


TEMPERATURE, ENERGY, POWER = (
    ("Zone Air Temperature", "CORE ZN"),
    ("Fan Electricity Energy", "FAN 1"),
    ("Facility Total HVAC Electricity Demand Rate", "Whole Building"),
)


@pytest.mark.parametrize(
    ("spec", "aggregation"),
    [
        (TEMPERATURE, "instant"),
        ((*TEMPERATURE, "mean"), "mean"),
        ((*TEMPERATURE, Aggregation.INSTANT), "instant"),
        (POWER, "mean"),
        ((*POWER, "instant"), "instant"),
        (ENERGY, "sum"),
        ((*ENERGY, "sum"), "sum"),
    ],
)
def test_aggregation__is_the_requested_or_the_usual_one(spec: tuple[str, ...], aggregation: str) -> None:
    (sensor,) = chosen(sensors={"s": spec}).sensors
    assert sensor.aggregation == aggregation


@pytest.mark.parametrize(
    ("spec", "right"),
    [((*TEMPERATURE, "sum"), "as a mean, not as a sum"), ((*ENERGY, "mean"), "as a sum, not as a mean")],
)
def test_point_selection__reading_that_energyplus_does_not_give_is_refused(spec: tuple[str, ...], right: str) -> None:
    assert right in refused(sensors={"s": spec})


def test_point_selection__unknown_reading_is_refused_with_those_there_are() -> None:
    message = refused(sensors={"s": (*TEMPERATURE, "average")})
    assert "no aggregation 'average'; there are: mean, sum, instant" in message


# Bounds


@pytest.mark.parametrize(
    ("variable", "bounds"),
    [
        (Variable("System Node Setpoint Humidity Ratio", "NODE", "kgWater/kgDryAir", True, False), (-999.0, None)),
        (Variable("System Node Humidity Ratio", "NODE", "kgWater/kgDryAir", True, False), (0.0, None)),
        (state("Zone Air Temperature", "k", "degC"), (-100.0, 200.0)),
        (state("Site Outdoor Air Drybulb Temperature", "k", "degC"), (-100.0, 200.0)),
        (state("Zone Air Relative Humidity", "k", "percent"), (0.0, 100.0)),
        (state("Zone People Occupant Count", "k", "1"), (0.0, None)),
        (state("Facility Total HVAC Electricity Demand Rate", "k", "W"), (0.0, None)),
        (state("Site Wind Speed", "k", "m/s"), (0.0, None)),
        (state("Boiler Outlet Temperature", "k", "degC"), (None, None)),
        (state("Zone Air Heat Balance Surface Convection Rate", "k", "W"), (None, None)),
    ],
    ids=lambda v: v.name if isinstance(v, Variable) else "",
)
def test_point_selection__sensors_bounds_are_those_that_no_value_leaves(
    variable: Variable, bounds: tuple[float | None, float | None]
) -> None:
    assert sensor_bounds(variable) == bounds


def test_point_selection__what_is_used_is_never_negative_and_a_net_meter_may_be() -> None:
    points = chosen(meters={"used": "Electricity:Facility", "net": "ElectricityNet:Facility"})
    assert [(m.low, m.high) for m in points.meters] == [(0.0, None), (None, None)]


@pytest.mark.parametrize(
    ("spec", "bounds"),
    [
        ((THERMOSTAT, "Heating Setpoint", "CORE ZN"), (15.0, 22.5)),
        ((THERMOSTAT, "Cooling Setpoint", "CORE ZN"), (22.5, 30.0)),
        (("Schedule:Compact", "Schedule Value", "LIGHTS"), (0.0, 1.0)),
        (("Schedule:Compact", "Schedule Value", "FREE"), (None, None)),
        (("Fan", "Fan Air Mass Flow Rate", "FAN 1"), (0.0, None)),
        ((THERMOSTAT, "Heating Setpoint", "CORE ZN", 12, 21.5), (12.0, 21.5)),
        ((THERMOSTAT, "Heating Setpoint", "CORE ZN", "12", "21.5"), (12.0, 21.5)),
    ],
)
def test_actuator_bounds__are_those_requested_or_of_schedule_or_unit(
    spec: tuple[object, ...], bounds: tuple[float | None, float | None]
) -> None:
    (actuator,) = chosen(actuators={"a": spec}).actuators
    assert (actuator.low, actuator.high) == bounds


@pytest.mark.parametrize(
    ("low", "high"), [(22, 15), (20, 20), (float("nan"), 20), ("cold", 20), (float("-inf"), 20), (15, float("inf"))]
)
def test_point_selection__bounds_that_cannot_be_are_an_invalid_configuration(low: object, high: object) -> None:
    with pytest.raises(InvalidConfig, match="'a'"):
        chosen(actuators={"a": (THERMOSTAT, "Heating Setpoint", "CORE ZN", low, high)})


@pytest.mark.parametrize(
    ("spec", "feedback"),
    [
        ((THERMOSTAT, "Heating Setpoint", "CORE ZN"), "Zone Thermostat Heating Setpoint Temperature"),
        ((THERMOSTAT, "Cooling Setpoint", "CORE ZN"), None),  # the model does not have that variable
        (("Schedule:Compact", "Schedule Value", "LIGHTS"), "Schedule Value"),
        (("Schedule:Compact", "Schedule Value", "FREE"), None),
        (("Fan", "Fan Air Mass Flow Rate", "FAN 1"), None),
    ],
)
def test_point_selection__feedback_is_a_variable_that_the_model_has(
    spec: tuple[str, ...], feedback: str | None
) -> None:
    (actuator,) = chosen(actuators={"a": spec}).actuators
    assert actuator.feedback == feedback


# What is not there


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"sensors": {"s": ("Zone Air Temprature", "CORE")}}, ["sensor 's'", "no variable", "'Zone Air Temperature'"]),
        ({"sensors": {"s": ("Zone Air Temperature", "CORE")}}, ["sensor 's'", "no key 'CORE'", "'CORE ZN'"]),
        ({"meters": {"m": "Electricity:Facilty"}}, ["meter 'm'", "no meter", "'Electricity:Facility'"]),
        ({"actuators": {"a": ("Fann", "x", "y")}}, ["actuator 'a'", "no component type 'Fann'", "'Fan'"]),
        ({"actuators": {"a": (THERMOSTAT, "Heating", "CORE ZN")}}, ["no control type 'Heating'", "'Heating Setpoint'"]),
        ({"actuators": {"a": (THERMOSTAT, "Heating Setpoint", "ATTIC")}}, ["no key 'ATTIC'", "'CORE ZN'"]),
    ],
)  # fmt: skip
def test_point_selection__unknown_point_states_which_part_is_wrong_and_lists_near_ones(
    asked: dict[str, Any], words: list[str]
) -> None:
    message = refused(**asked)
    assert all(word in message for word in words), message


def test_select_points__reports_all_missing_points_at_once() -> None:
    with pytest.raises(UnknownName) as raised:
        chosen(
            sensors={"s1": ("No Such Thing", "k"), "good": TEMPERATURE, "s2": ("Zone Air Temperature", "CELLAR")},
            meters={"m1": "Steam:Facility"},
            actuators={"a1": ("Fan", "Speed", "FAN 1"), "a2": ("Pump", "x", "y")},
        )
    lines = str(raised.value).splitlines()
    assert [line.split(":")[0] for line in lines] == [
        "sensor 's1'", "sensor 's2'", "meter 'm1'", "actuator 'a1'", "actuator 'a2'",
    ]  # fmt: skip


def test_select_points__reports_all_errors_at_once() -> None:
    message = refused(
        sensors={"s1": (*TEMPERATURE, "sum"), "s2": ("Zone Air Temperature",), "a/b": TEMPERATURE},
        meters={"m1": "Steam:Facility"},
        actuators={"a1": (THERMOSTAT, "Heating Setpoint", "CORE ZN", 22, 15)},
    )
    assert [name for name in ("'s1'", "'s2'", "'a/b'", "'m1'", "'a1'") if name not in message] == []


def test_point_selection__one_name_is_one_point() -> None:
    message = refused(sensors={"a": TEMPERATURE, "b": POWER}, meters={"b": "Electricity:HVAC", "a": "Electricity:HVAC"})
    assert "sensor and a meter: a, b" in message


def test_select_points__actuator_has_one_name() -> None:
    heating = (THERMOSTAT, "Heating Setpoint", "CORE ZN")
    in_another_case = tuple(part.casefold() for part in heating)
    message = refused(
        actuators={"a": heating, "lights": ("Schedule:Compact", "Schedule Value", "LIGHTS"), "b": in_another_case}
    )
    assert message == f"actuators 'a', 'b' are one actuator of EnergyPlus ({', '.join(heating)}); keep one"


@pytest.mark.parametrize("kind", ["sensors", "meters", "actuators"])
def test_point_selection__name_that_cannot_stand_in_a_topic_is_refused(kind: str) -> None:
    spec = {
        "sensors": TEMPERATURE,
        "meters": "Electricity:HVAC",
        "actuators": (THERMOSTAT, "Heating Setpoint", "CORE ZN"),
    }
    message = refused(**{kind: {"core zn/t": spec[kind]}})
    assert "'core zn/t'" in message
    assert "'core_zn_t'" in message


@pytest.mark.parametrize(
    "asked",
    [
        {"sensors": {"s": "Zone Air Temperature"}},
        {"sensors": {"s": ("Zone Air Temperature",)}},
        {"sensors": {"s": (*TEMPERATURE, "mean", "more")}},
        {"actuators": {"s": "Fan"}},
        {"actuators": {"s": (THERMOSTAT, "Heating Setpoint")}},
        {"actuators": {"s": (THERMOSTAT, "Heating Setpoint", "CORE ZN", 15)}},
    ],
)
def test_point_selection__point_of_another_form_is_refused_with_the_right_one(asked: dict[str, Any]) -> None:
    with pytest.raises(InvalidConfig, match=r"'s': expected \("):
        chosen(**asked)


# What is found where nothing is asked


def test_point_selection__default_is_the_weather_the_power_the_conditioned_zones_and_the_fuels() -> None:
    points = select_points(BUILDING, SURVEY, None, None, None)
    assert [(s.name, s.key) for s in points.sensors] == [
        ("outdoor_temperature", "Environment"),
        ("hvac_and_plant_power", "Whole Building"),
        ("core_zn_air_temperature", "CORE ZN"),
        ("core_zn_relative_humidity", "CORE ZN"),
        ("core_zn_occupants", "CORE ZN"),
    ]
    assert [(m.name, m.meter) for m in points.meters] == [
        ("electricity_facility", "Electricity:Facility"),
        ("hvac_electricity", "HVAC:Electricity"),
    ]
    assert [a.name for a in points.actuators] == ["core_zn_heating_setpoint", "core_zn_cooling_setpoint"]


def test_point_selection__zones_whose_names_are_alike_have_points_of_their_own() -> None:
    zones = ("ZONE 1", "ZONE_1")
    survey = PointCatalog(
        variables=tuple(state("Zone Air Temperature", zone, "degC") for zone in zones),
        meters=(),
        actuators=tuple(ActuatorPoint(THERMOSTAT, "Cooling Setpoint", zone, "degC") for zone in zones),
    )
    points = select_points(BUILDING, survey, None, None, None)
    assert sorted(s.key for s in points.sensors) == sorted(zones)
    assert sorted(a.key for a in points.actuators) == sorted(zones)


def test_point_selection__model_without_anything_has_no_points() -> None:
    points = select_points(BUILDING, PointCatalog((), (), ()), None, None, None)
    assert (points.sensors, points.meters, points.actuators) == ((), (), ())


def test_point_selection__listing_has_every_point_with_unit_bounds_and_place() -> None:
    zone = Building("b", BUILDING.objects | {"Zone": {"Core Zn": {}}, "Meter:Custom": {"electricity:hvac": {}}}, "0")
    rows = list(listing(SURVEY, zone))
    assert Counter(row.kind for row in rows) == {"sensor": 9, "meter": 5, "actuator": 5, "internal": 1}
    for row in (
        PointListing("sensor", "Zone Air Temperature", "CORE ZN", "degC", -100.0, 200.0, "Core Zn"),
        PointListing("sensor", "Zone Air Temperature", "ATTIC", "degC", -100.0, 200.0, ""),
        PointListing(
            "sensor", "Site Outdoor Air Drybulb Temperature", "Environment", "degC", -100.0, 200.0, "Environment"
        ),
        PointListing(
            "sensor", "Facility Total HVAC Electricity Demand Rate", "Whole Building", "W", 0.0, None, "facility"
        ),
        PointListing("meter", "Electricity:Facility", "", "J", 0.0, None, "facility"),
        PointListing("meter", "Electricity:HVAC", "", "J", 0.0, None, ""),  # the model's own: it may be of anything
        PointListing("meter", "HVAC:Electricity", "", "J", 0.0, None, "facility"),
        PointListing("meter", "ElectricityNet:Facility", "", "J", None, None, "facility"),
        PointListing("actuator", f"{THERMOSTAT} / Heating Setpoint", "CORE ZN", "degC", 15.0, 22.5, "Core Zn"),
        PointListing("actuator", "Schedule:Compact / Schedule Value", "LIGHTS", "1", 0.0, 1.0, ""),
        PointListing("actuator", "Fan / Fan Air Mass Flow Rate", "FAN 1", "kg/s", 0.0, None, ""),
        PointListing("internal", "Zone Floor Area", "CORE ZN", "m2", None, None, "Core Zn"),
    ):
        assert row in rows


@pytest.mark.parametrize(
    ("meter", "where"),
    [
        ("Electricity:Zone:CORE ZN", "Core Zn"),
        ("General:InteriorLights:Electricity:Zone:CORE ZN", "Core Zn"),
        ("InteriorLights:Electricity:SpaceType:GENERAL", ""),
        ("InteriorLights:Electricity", "facility"),
        ("Electricity:Plant", "facility"),
    ],
)
def test_point_selection__meter_is_of_a_zone_or_of_the_facility(meter: str, where: str) -> None:
    metered = PointCatalog((), (MeterPoint(meter, "J", 0),), ())
    (row,) = listing(metered, Building("b", {"Building": {"b": {}}, "Zone": {"Core Zn": {}}}, "0"))
    assert row.where == where


# The list of a whole model, by EnergyPlus's own

_ASK = """
wanted = json.load(open(folder + "/wanted.json"))
for name, key in wanted["sensor"]:
    exchange.request_variable(state, name, key)

def ready(at):
    x = exchange
    if not x.api_data_fully_ready(at):
        return
    said = {"list": [[p.what, p.name, p.key, p.type] for p in x.get_api_data(at)]}
    said["sensor"] = [x.get_variable_handle(at, name, key) for name, key in wanted["sensor"]]
    said["actuator"] = [x.get_actuator_handle(at, *names) for names in wanted["actuator"]]
    handles = [x.get_internal_variable_handle(at, name, key) for name, key in wanted["internal"]]
    said["internal"] = [[h, x.get_internal_variable_value(at, h) if h >= 0 else None] for h in handles]
    json.dump(said, open(folder + "/said.json", "w"))
    runtime.stop_simulation(at)

runtime.callback_begin_new_environment(state, ready)
"""


@pytest.fixture(scope="module")
def whole(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Building, list[PointListing], dict[str, Any], dict[str, Any]]:
    """A model, its listing, the points that EnergyPlus was asked for, and what it said."""
    folder = tmp_path_factory.mktemp("whole")
    weather = catalog.find_weather("USA_CO_Denver").path
    building = read_building(catalog.find_building("office-small"))
    rows = list(listing(discover(building, weather), building))
    wanted = {
        "sensor": [(r.name, r.key) for r in rows if r.kind == "sensor"][::20],
        "actuator": [(*r.name.split(" / "), r.key) for r in rows if r.kind == "actuator"],
        "internal": [(r.name, r.key) for r in rows if r.kind == "internal"],
    }
    (folder / "wanted.json").write_text(json.dumps(wanted))
    day = date(2017, 1, 1)
    model = write(for_episode(building, Period(day, day, building.steps_per_hour)), folder)
    run_energyplus(model, weather, folder, before=_ASK)
    return building, rows, wanted, json.loads((folder / "said.json").read_text())


Whole = tuple[Building, list[PointListing], dict[str, Any], dict[str, Any]]


def test_point_selection__meters_actuators_and_internal_variables_are_energyplus_own_list(whole: Whole) -> None:
    _, rows, _, answers = whole
    listed = Counter((r.kind, r.name, r.key) for r in rows if r.kind != "sensor" and r.name not in HVAC_METERS)
    own: Counter[tuple[str, str, str]] = Counter()
    for what, name, key, control in answers["list"]:
        if what == "Actuator":
            own["actuator", f"{name} / {control}", key] += 1
        elif what == "OutputMeter":
            own["meter", key, ""] += 1
        elif what == "InternalVariable":
            own["internal", name, key] += 1
    assert listed == own


def test_point_selection__every_listed_point_can_be_had(whole: Whole) -> None:
    _, _, wanted, answers = whole
    assert len(wanted["sensor"]) > 300
    assert [point for point, handle in zip(wanted["sensor"], answers["sensor"], strict=True) if handle < 0] == []
    assert [point for point, handle in zip(wanted["actuator"], answers["actuator"], strict=True) if handle < 0] == []
    assert [point for point, (h, _) in zip(wanted["internal"], answers["internal"], strict=True) if h < 0] == []


def test_point_selection__internal_variables_have_the_models_numbers(whole: Whole) -> None:
    building, _, wanted, answers = whole
    values = dict(zip(map(tuple, wanted["internal"]), (value for _, value in answers["internal"]), strict=True))
    areas = {key: value for (name, key), value in values.items() if name == "Zone Floor Area"}
    assert areas == pytest.approx({zone.upper(): area for zone, area in zone_areas(building.objects).items()})


def test_point_selection__points_of_zones_surfaces_and_loads_are_in_their_zone(whole: Whole) -> None:
    building, rows, _, _ = whole
    kinds = ("BuildingSurface:Detailed", "People", "Lights", "ElectricEquipment", "ZoneInfiltration:DesignFlowRate")
    fields = ("zone_name", "zone_or_zonelist_or_space_or_spacelist_name")
    zone_of = {zone.upper(): zone.upper() for zone in building.objects["Zone"]}
    for kind in kinds:
        for name, object_ in building.objects[kind].items():
            zone_of.setdefault(name.upper(), next(str(object_[f]).upper() for f in fields if f in object_))
    keyed = [row for row in rows if row.key.upper() in zone_of]
    assert len(keyed) > 1000
    assert {row.key for row in keyed if row.where.upper() != zone_of[row.key.upper()]} == set()


def test_point_selection__loops_and_their_equipment_are_found_by_the_loops_name(whole: Whole) -> None:
    building, rows, _, _ = whole
    loops = {*building.objects["AirLoopHVAC"], *building.objects["PlantLoop"]}
    assert loops <= {row.where for row in rows}
    assert {row.where for row in rows} <= loops | set(building.objects["Zone"]) | {"", "Environment", "facility"}


# Units


@pytest.mark.parametrize(
    ("energyplus", "unit"),
    [
        ("C", "degC"), ("[C]", "degC"), (" [C] ", "degC"), ("deltaC", "delta_degC"), ("%", "percent"), ("", "1"),
        ("[]", "1"), ("W", "W"), ("J", "J"), ("kg/s", "kg/s"), ("W/m2-K", "W/m2-K"), ("on/off", "on_off"),
    ],
)  # fmt: skip
def test_point_selection__unit_has_one_name(energyplus: str, unit: str) -> None:
    assert unit_name(energyplus) == unit


@pytest.mark.parametrize(
    ("unit", "bounds"),
    [
        ("percent", (0.0, 100.0)), ("fraction", (0.0, 1.0)), ("kg/s", (0.0, None)), ("W", (None, None)),
        ("degC", (None, None)), ("furlong", (None, None)),
    ],
)  # fmt: skip
def test_point_selection__unit_has_its_limits(unit: str, bounds: tuple[float | None, float | None]) -> None:
    assert limits(unit) == bounds
