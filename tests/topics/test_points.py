"""Bounds of points and the index by name: what they admit, how they are described, which errors they raise."""

import sys
from math import inf, isfinite, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.builders import actuator, manifest, meter, sensor

from zenostat.topics.errors import InvalidAction, UnknownName, ZenostatError
from zenostat.topics.messages import Action
from zenostat.topics.points import (
    LARGEST,
    PointIndex,
    actuator_index,
    bound_arrays,
    bounds,
    check_command,
    check_order,
    contains,
    describe_bounds,
    describe_violation,
    value_index,
)

FINITE = st.floats(allow_nan=False, allow_infinity=False)
BOUND = st.none() | FINITE
BUILDING = manifest(
    sensors=[sensor("zone_t"), sensor("outdoor_t")],
    meters=[meter("electricity"), meter("gas")],
    actuators=[actuator("heat"), actuator("cool")],
)
NAMES = st.lists(st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True), unique=True)


def point(low: float | None = None, high: float | None = None, unit: str = "degC") -> Action:
    return Action(name="heating", unit=unit, low=low, high=high, actuators=("a",))


@given(BOUND, BOUND, st.floats())
def test_contains__exactly_the_finite_values_that_violate_neither_bound(
    low: float | None, high: float | None, value: float
) -> None:
    violates_low = low is not None and value < low
    violates_high = high is not None and value > high
    assert contains(point(low, high), value) == (isfinite(value) and not violates_low and not violates_high)


@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_contains__no_value_that_is_not_finite_even_without_bounds(value: float) -> None:
    assert not contains(point(), value)


@pytest.mark.parametrize("value", [None, 20, 20.5, np.float32(20.5), np.int64(20), np.array(20.5)])
def test_check_command__takes_numbers_and_none(value: object) -> None:
    check_command("cooling", value)


@pytest.mark.parametrize("value", ["25", True, np.True_, nan, -inf, [25.0, 26.0], {}, 10**400])
def test_check_command__names_the_actuator(value: object) -> None:
    with pytest.raises(InvalidAction, match=r"cooling = .*; a finite number or None"):
        check_command("cooling", value)


@given(st.lists(st.tuples(BOUND, BOUND), max_size=5), st.sampled_from([inf, LARGEST]))
def test_bound_arrays__are_the_bounds_of_each_point(
    pairs: list[tuple[float | None, float | None]], unbounded: float
) -> None:
    points = [point(low, high) for low, high in pairs]
    lows, highs = bound_arrays(points, unbounded=unbounded)
    assert lows.dtype == highs.dtype == np.float64
    assert lows.shape == highs.shape == (len(points),)
    assert [*zip(lows.tolist(), highs.tolist(), strict=True)] == [bounds(p, unbounded=unbounded) for p in points]


def test_bounds__a_missing_bound_is_infinite() -> None:
    assert bounds(point()) == (-inf, inf)
    assert bounds(point(low=0.0)) == (0.0, inf)
    assert bounds(point(high=0.0)) == (-inf, 0.0)


def test_bounds__the_largest_number_admits_all_finite_values_and_no_infinity() -> None:
    low, high = bounds(point(), unbounded=LARGEST)
    assert low <= -sys.float_info.max
    assert high >= sys.float_info.max
    assert -inf < low
    assert high < inf


@given(BOUND, BOUND)
def test_check_order__rejects_exactly_two_bounds_that_leave_no_range(low: float | None, high: float | None) -> None:
    if low is not None and high is not None and low >= high:
        with pytest.raises(ValueError, match="is not below high"):
            check_order(point(low, high))
    else:
        check_order(point(low, high))


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        (point(15.0, 22.5), "15 to 22.5 degC"),
        (point(low=0.0, unit="kg/s"), "0 to inf kg/s"),
        (point(high=30.0), "-inf to 30 degC"),
        (point(0.0, 1.0, unit="fraction"), "0 to 1"),
    ],
)
def test_describe_bounds__has_both_bounds_and_the_unit(limits: Action, text: str) -> None:
    assert describe_bounds(limits) == text


@pytest.mark.parametrize(("value", "text"), [(40, "40"), (np.float64(22.75), "22.75"), (nan, "nan")])
def test_describe_violation__has_name_value_and_bounds(value: object, text: str) -> None:
    assert describe_violation(point(15.0, 22.5), value) == f"heating = {text}; its bounds are 15 to 22.5 degC"


@pytest.mark.parametrize(("value", "text"), [("20", "'20'"), (np.array(20.0), "array(20.)")])
def test_describe_violation__of_what_is_no_number_has_no_bounds(value: object, text: str) -> None:
    assert describe_violation(point(15.0, 22.5), value) == f"heating = {text}; a number expected"


@pytest.mark.parametrize(
    ("bounded", "value", "text"),
    [
        (point(15.0, 22.5), 22.5000001, "22.5000001; its bounds are 15 to 22.5 degC"),
        (point(22.5, 30.0), np.nextafter(30.0, 31.0), "30.000000000000004; its bounds are 22.5 to 30 degC"),
        (point(15.0, 22.1234567), 22.1235, "22.1235; its bounds are 15 to 22.1234567 degC"),
    ],
)
def test_describe_violation__shows_how_a_value_differs_from_a_bound(bounded: Action, value: float, text: str) -> None:
    assert describe_violation(bounded, value) == f"heating = {text}"


@given(NAMES)
def test_point_index__has_the_position_of_each_name(names: list[str]) -> None:
    index = PointIndex(names, "sensor")
    assert [*index] == names
    assert [index[name] for name in names] == [*range(len(names))]


@pytest.mark.parametrize("error", [UnknownName, InvalidAction])
def test_point_index__an_unknown_name_raises_the_error_with_similar_names(error: type[ZenostatError]) -> None:
    index = PointIndex(["heating", "cooling"], "actuator", error)
    with pytest.raises(error, match=r"^no actuator 'heatng'; .*'heating'") as raised:
        index["heatng"]
    assert type(raised.value) is error
    assert "heatng" not in index  # nothing is added


def test_point_index__require_names_all_unknown_names_and_only_those() -> None:
    index = PointIndex(["heating", "cooling"], "actuator")
    index.require(["cooling", "heating"])
    with pytest.raises(UnknownName) as raised:
        index.require(["heatng", "cooling", "coolng"])
    lines = str(raised.value).splitlines()
    assert [line.partition(";")[0] for line in lines] == ["no actuator 'heatng'", "no actuator 'coolng'"]


def test_actuator_index__names_the_source_of_a_connected_input() -> None:
    manifest = BUILDING.model_copy(update={"connected": {"house.supply": "boiler.power, pump.heat"}})
    expected = "^'house.supply' cannot be commanded: it is connected to boiler.power, pump.heat$"
    with pytest.raises(UnknownName, match=expected):
        actuator_index(manifest)["house.supply"]


def test_value_index__counts_the_meters_after_the_sensors() -> None:
    index = value_index(BUILDING)
    assert dict(index) == {"zone_t": 0, "outdoor_t": 1, "electricity": 2, "gas": 3}


def test_actuator_index__has_the_order_of_the_actuators() -> None:
    assert dict(actuator_index(BUILDING)) == {"heat": 0, "cool": 1}
