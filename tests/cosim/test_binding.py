"""Connections against the points of plants: units, timesteps, bounds, time."""

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.coupled_plants import district_file, manifest_of

from zenostat.cosim.binding import Binding, bind
from zenostat.cosim.topology import check_file
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.units import _CONVERSIONS, conversion

TEXT = """plants:
  a: {plant: "plants.py:A"}
  b: {plant: "plants.py:B"}
connections:
"""
POINTS: Any = {"power": "kW", "temperature": "degF", "content": "kWh", "share": "percent", "level": "furlong"}
ACTUATORS: Any = {
    "load": ("W", 0.0, 5e4), "setpoint": ("degC", 10.0, 30.0), "energy": ("kWh", None, None), "part": ("1", 0.0, 1.0),
    "depth": ("furlong", None, None),
}  # fmt: skip


def bound(folder: Path, text: str, *, head: str = "", a: Any = None, b: Any = None) -> Binding:
    file = district_file(folder, head + TEXT + (text or "  []\n"))
    manifests = {
        "a": manifest_of(POINTS, {}, meters={"heat": "J"}, **(a or {})),
        "b": manifest_of({"x": "1"}, **{"actuators": ACTUATORS, **(b or {})}),
    }
    return bind(file, check_file(file), manifests)


def error_of(folder: Path, text: str, **settings: Any) -> str:
    with pytest.raises(InvalidConfig) as caught:
        bound(folder, text, **settings)
    return str(caught.value).replace(str(folder / "district.yaml"), "FILE")


@pytest.mark.parametrize(
    ("connection", "value", "expected"),
    [
        ("from: a.power, to: b.load", 3.0, 3000.0),
        ("from: a.temperature, to: b.setpoint", 68.0, 20.0),
        ("from: a.share, to: b.part", 25.0, 0.25),
        ("from: a.level, to: b.depth", 25.0, 25.0),
        ("from: a.heat, to: b.load", 1.8e6, 2000.0),  # J in 900 s
        ("from: a.heat, to: b.energy", 1.8e6, 0.5),
        ("from: a.content, to: b.energy", 4.0, 4.0),
        ("from: a.power, to: b.load, factor: 0.5, offset: 100", 3.0, 1600.0),
        ("from: a.power, to: b.setpoint, unit: W, factor: 0.001, offset: 20", 3.0, 23.0),
        ("from: a.heat, to: b.setpoint, unit: kW, factor: 1.5, offset: 21", 1.8e6, 24.0),
    ],
)
def test_units__are_converted_then_factor_and_offset(
    folder: Path, connection: str, value: float, expected: float
) -> None:
    (transfer,) = bound(folder, f"  - {{{connection}}}\n").transfers
    assert transfer.convert(np.array([value]))[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("unit", "target", "expected"),
    [
        ("kg", "kg", 6.0),
        ("m3", "m3", 6.0),
        ("count", "count", 6.0),
        ("kWh", "kWh", 6.0),
        ("kg", "kg/s", 6.0 / 900.0),
        ("m3", "m3/h", 24.0),
        ("L", "L/s", 6.0 / 900.0),
        ("J", "W", 6.0 / 900.0),
    ],
)
def test_amounts__none_is_lost_between_timesteps(folder: Path, unit: str, target: str, expected: float) -> None:
    """1, 2 and 3 of a meter in timesteps of 300 s are 6 in one of 900 s."""
    file = district_file(folder, TEXT + "  - {from: a.used, to: b.u}\n")
    a = manifest_of({}, {}, meters={"used": unit}, step_s=300.0, steps=288)
    b = manifest_of({"x": "1"}, {"u": (target, None, None)})
    (transfer,) = bind(file, check_file(file), {"a": a, "b": b}).transfers
    received = transfer.resample(transfer.convert(np.array([1.0, 2.0, 3.0])), 0.0)
    assert received == pytest.approx([expected], rel=1e-12)


def test_stored_energy__is_held_between_timesteps(folder: Path) -> None:
    file = district_file(folder, TEXT + "  - {from: a.content, to: b.energy}\n")
    a = manifest_of({"content": "J"}, {}, step_s=300.0, steps=288)
    (transfer,) = bind(file, check_file(file), {"a": a, "b": manifest_of({"x": "1"}, ACTUATORS)}).transfers
    assert transfer.resample(transfer.convert(np.array([1e5, 2e5, 3.6e6])), 0.0) == pytest.approx([1.0])


@pytest.mark.parametrize(
    ("connection", "expected"),
    [
        ("from: a.temperature, to: b.load", "FILE:5: a.temperature is in degF and b.load in W, which are unlike"),
        ("from: a.content, to: b.load", "FILE:5: a.content is in kWh and b.load in W, which are unlike"),
        ("from: a.level, to: b.part", "FILE:5: a.level is in furlong and b.part in 1, which are unlike"),
        ("from: a.power, to: b.setpoint, unit: degC", "FILE:5: a.power is in kW, which is not converted to degC"),
        ("from: a.powr, to: b.load", "FILE:5: a.powr: plant 'a' has no sensor or meter 'powr'; did you mean 'power'?"),
        ("from: a.power, to: b.lod", "FILE:5: b.lod: plant 'b' has no actuator 'lod'; did you mean 'load'?"),
        ("from: a.power, to: b.x", "FILE:5: b.x: is a sensor or meter; a connection ends at an actuator"),
        ("from: b.load, to: b.part, delay: 1", "FILE:5: b.load: is an actuator; a connection begins at a sensor"),
        (
            "from: a.power, to: b.load, low: 60000",
            "FILE:5: 60000 to inf has no value within the bounds of b.load, 0 to 50000 W",
        ),
        (
            "from: a.power, to: [b.load, b.setpoint], unit: kW",
            "FILE:5: its targets differ in unit or timestep, so they cannot have the same value; give each an entry",
        ),
        ("from: a.power, to: b.load, delay: 1, initial: -1", "FILE:5: initial = -1 is outside of 0 to 50000 W"),
    ],
)
def test_binding__each_mistake_has_its_line(folder: Path, connection: str, expected: str) -> None:
    assert error_of(folder, f"  - {{{connection}}}\n").startswith(expected)


def test_timestep__longest_of_the_plants_by_default(folder: Path) -> None:
    binding = bound(folder, "", a={"step_s": 300.0, "steps": 30}, b={"step_s": 900.0, "steps": 9})
    assert [member.steps for member in binding.members.values()] == [3, 1]
    assert (binding.run_period.step_s, binding.run_period.steps) == (900.0, 9)


@pytest.mark.parametrize(
    ("head", "steps", "expected"),
    [
        ("timestep: 10min\n", (900.0, 900.0), "FILE:1: the timestep 10 min is no multiple of the 15 min of plant 'a'"),
        ("", (600.0, 900.0), "FILE:2: the 10 min of plant 'a' do not divide the 15 min of 'b'; set `timestep: 1800`"),
        ("duration: 40min\n", (900.0, 900.0), "FILE:1: the duration 2400 s is no multiple of the timestep 900 s"),
        ("duration: 2d\n", (900.0, 900.0), "FILE:1: the duration is 48 h, but an episode of plant 'a' ends after 24 h"),
        ("start: 13-01\n", (900.0, 900.0), "FILE:1: "),
    ],
)
def test_timestep__what_does_not_divide_is_an_error(
    folder: Path, head: str, steps: tuple[float, float], expected: str
) -> None:
    text = error_of(folder, "", head=head, a={"step_s": steps[0]}, b={"step_s": steps[1]})
    assert any(line.strip().startswith(expected) for line in text.splitlines()), text


def test_run_period__begins_with_the_first_plant_or_on_the_day_of_the_file(folder: Path) -> None:
    assert bound(folder, "").run_period.begin == datetime(2001, 1, 1)
    assert bound(folder, "", head="start: 2026-07-03\n").run_period.begin == datetime(2026, 7, 3)


@pytest.mark.parametrize("begin", ["2026-07-01T12:00:00", "2001-01-01T06:00:00", "2024-02-29T00:00:00"])
def test_run_period__plant_that_begins_at_another_time_of_the_year_is_a_warning(folder: Path, begin: str) -> None:
    (warning,) = bound(folder, "", b={"begin": begin}).warnings
    expected = f":3: plant 'b' begins at {begin[:10]} {begin[11:16]}, the district at 2001-01-01 00:00"
    assert warning.endswith(expected)
    assert len(bound(folder, "", head="start: 2026-07-03\n", b={"begin": begin}).warnings) == 1
    assert bound(folder, "", head="start: 2026-07-03\n", b={"begin": "2025-07-03T00:00:00"}).warnings == ()
    assert bound(folder, "", head="start: 2026-07-03\n").warnings == ()  # a class without a calendar


def test_binding__points_names_are_not_too_long_with_that_of_their_plant(folder: Path) -> None:
    long, head = "x" * 127, "FILE:3: its point"
    text = error_of(folder, "", b={"actuators": {long: ("1", None, None)}})
    rest = "characters, of which there are at most 128; give"
    assert text == f"{head} b.{long} would have a name of 129 {rest} the point a shorter name"
    file = district_file(folder, TEXT.replace("  b:", "  house:") + "  []\n")
    manifests = {"a": manifest_of(POINTS, {}), "house": manifest_of({long[:123]: "1"}, {})}
    with pytest.raises(InvalidConfig, match=f"would have a name of 129 {rest} plant 'house' a name of at most 4$"):
        bind(file, check_file(file), manifests)


def test_binding__plant_with_several_slots_is_refused(folder: Path) -> None:
    assert error_of(folder, "", a={"slots": 2}).startswith("FILE:2: plant 'a' has 2 slots")


UNITS = st.sampled_from(sorted(_CONVERSIONS))


@given(UNITS, UNITS, UNITS, st.floats(-1e3, 1e3))
def test_conversion__there_and_back_and_by_way_of_a_third_unit(a: str, b: str, c: str, value: float) -> None:
    forward, back = conversion(a, b), conversion(b, a)
    assert (forward is None) == (back is None) == (_CONVERSIONS[a][0] != _CONVERSIONS[b][0])
    if forward is None or back is None:
        return
    other = forward[0] * value + forward[1]
    assert back[0] * other + back[1] == pytest.approx(value, rel=1e-9, abs=1e-6)
    first, second = conversion(a, c), conversion(c, b)
    if first is not None and second is not None:
        assert second[0] * (first[0] * value + first[1]) + second[1] == pytest.approx(other, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize(
    ("source", "value", "target", "expected"),
    [("degF", 32.0, "degC", 0.0), ("degC", -40.0, "degF", -40.0), ("kWh", 1.0, "MJ", 3.6), ("m3/h", 3.6, "L/s", 1.0)],
)
def test_conversion__known_values(source: str, value: float, target: str, expected: float) -> None:
    linear = conversion(source, target)
    assert linear is not None
    assert linear[0] * value + linear[1] == pytest.approx(expected, abs=1e-9)
