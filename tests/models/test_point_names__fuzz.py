"""Odd names of a model, and very many points: names are safe and unique, and the rules stay right."""

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.builders import actuator, advance, claim, command, exchange

import zenostat  # noqa: F401  # registers the environments
from zenostat.models.building.model import Building, read_building
from zenostat.models.catalog import find_building
from zenostat.models.points.discovery import ActuatorPoint, PointCatalog, Variable
from zenostat.models.points.monitoring import monitoring_sensors
from zenostat.models.points.selection import default_actuators, default_sensors, find_actuator, thermostat_zones
from zenostat.topics import codec
from zenostat.topics.errors import BadMessage, InvalidConfig, UnknownName
from zenostat.topics.keys import check_name, safe_name
from zenostat.topics.messages import CommandOp, EventKind, Write

MANY = 10_000
ODD = [
    "A/B",
    "A*B",
    "A#B",
    "A@B",
    "A B",
    "A_B",
    "a_b_2",
    "区域",
    "zone",
    "Zone",
    '"A"',
    "'",
    "$",
    "?",
    "Ä" * 100,
    "x" * 100,
    "x" * 300,
    "X" * 299 + "y",
]
VARIABLES = ("Zone Air Temperature", "Zone Thermostat Heating Setpoint Temperature")

zone_names = st.lists(st.text(min_size=1, max_size=300), min_size=1, max_size=8, unique=True)


def model(zones: list[str]) -> PointCatalog:
    """A model of zones with thermostats."""
    controls = ("Heating Setpoint", "Cooling Setpoint")
    return PointCatalog(
        variables=tuple(Variable(v, z, "degC", system=True, summed=False) for v in VARIABLES for z in zones),
        meters=(),
        actuators=tuple(ActuatorPoint("Zone Temperature Control", c, z, "degC") for z in zones for c in controls),
    )


def check(zones: list[str]) -> None:
    survey = model(zones)
    names = thermostat_zones(survey)
    assert list(names) == zones
    assert len(set(names.values())) == len(zones)
    actuators = default_actuators(survey)
    assert len(actuators) == 2 * len(zones)
    assert {key for _, _, key in actuators.values()} == set(zones)
    monitored = monitoring_sensors(Building("b", {"Building": {}}, "0"), survey)
    assert len(monitored) == len(VARIABLES) * len(zones)
    for name in (*actuators, *default_sensors(survey), *monitored):
        assert check_name(name, "the point") == name


def test_point_names__zones_of_odd_names_have_safe_names_of_their_own() -> None:
    check(ODD)


@given(zone_names)
def test_point_names__zones_of_any_names_have_safe_names_of_their_own(zones: list[str]) -> None:
    check(zones)


@given(st.text(max_size=300))
def test_point_names__any_text_has_a_safe_name(text: str) -> None:
    assert check_name(safe_name(text), "the name") == safe_name(text)


@pytest.mark.parametrize("name", ["a/b", "a*", "#", "ü", "", "a b", "@a", "-a"])
def test_invalid_name__is_quoted_as_written(name: str) -> None:
    with pytest.raises(InvalidConfig) as raised:
        check_name(name, "the point name")
    assert repr(name) in str(raised.value)


def test_invalid_name__that_is_too_long_is_cut() -> None:
    with pytest.raises(InvalidConfig, match=f"the point name '{'x' * 100}") as raised:
        check_name("x" * 100_000, "the point name")
    assert len(str(raised.value)) < 600


def test_unknown_key__and_near_ones_have_energyplus_spelling() -> None:
    with pytest.raises(UnknownName, match=r"no key 'A/BB'; did you mean 'A/B'"):
        find_actuator(model(["A/B", "区域"]), "point", "Zone Temperature Control", "Heating Setpoint", "A/BB")


def test_exchange__treats_ten_thousand_actuators_as_two() -> None:
    at = exchange(*(actuator(f"a{i}", 0.0, 100.0) for i in range(MANY)))
    claim(at, "low", 12)
    claim(at, "high", 5, actuators=[f"a{i}" for i in range(0, MANY, 2)])
    values = np.arange(MANY) % 100
    mask = [CommandOp.SET if i % 2 == 0 else CommandOp.KEEP for i in range(MANY)]
    assert at.intake.command("low", command(values), now_s=0.0) is None
    assert at.intake.command("high", command(np.full(MANY, 50.0), operations=mask), now_s=0.0) is None
    assert at.intake.write("a1", Write(value=7.0, source="somebody"), 0.0).kind is EventKind.WRITTEN
    ruling, sources = advance(at)
    expected = np.where(np.arange(MANY) % 2 == 0, 50.0, values)
    expected[1] = 7.0
    assert ruling == expected.tolist()
    assert sources[:4] == ["high", "somebody", "high", "low"]


def test_point_names__one_bad_value_among_ten_thousand_is_named_and_changes_nothing() -> None:
    at = exchange(*(actuator(f"a{i}", 0.0, 100.0) for i in range(MANY)))
    claim(at, "c")
    values = np.full(MANY, 50.0)
    values[4321] = np.nan
    event = at.intake.command("c", command(values), now_s=0.0)
    assert event.kind is EventKind.REJECTED
    assert "a4321 = nan" in event.text
    assert not at.ready_to_step()


def test_source_name__has_a_bounded_length() -> None:
    longest = Write(value=25.0, source="x" * 128)
    assert codec.decode(Write, codec.encode(longest)) == longest
    with pytest.raises(BadMessage, match=r"source.*127"):
        codec.decode(Write, codec.pack(value=25.0, priority=8, duration_s=None, source="x" * 129))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*nothing in the model uses schedule")
def test_point_names__building_with_ten_thousand_actuators_and_odd_names_is_commanded(scratch: Path) -> None:
    """EnergyPlus itself says what each schedule was: what was commanded under a name of our own."""
    odd = ["Fan/Speed*#1", "Ä schedule", 'it\'s "quoted"', "two  blanks", "@live/node", "a,b;c!d", "x" * 90]
    names = [*odd, *(f"Extra {number}" for number in range(MANY))]
    objects = json.loads(json.dumps(read_building(find_building("ref-small-office")).objects))
    objects["Schedule:Constant"] = objects.get("Schedule:Constant", {}) | {
        name: {"hourly_value": 1.0} for name in names
    }
    model = scratch / "odd.epJSON"
    model.write_text(json.dumps(objects))
    actuators = {f"s{place}": ("Schedule:Constant", "Schedule Value", name) for place, name in enumerate(names)}
    day = {"begin": "07-03", "end": "07-03", "steps_per_hour": 4, "affinity": "off", "disable_env_checker": True}
    env = gym.make("zenostat/Building-v1", building=model, weather="USA_CO_Denver", actuators=actuators, **day)
    env.reset()
    for factor in (0.25, -3.0):
        commanded = factor * np.arange(len(names))
        np.testing.assert_array_equal(env.step(commanded)[4]["effective"], commanded)
    env.close()
