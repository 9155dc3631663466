"""Ticks of axes and numbers in pictures."""

import math
from datetime import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.views.rendering.scale import format_time, format_time_tick, format_value, round_scale, time_ticks

NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)


@given(NUMBERS, NUMBERS, st.integers(3, 9), st.booleans())
def test_rendering__axis_contains_its_values_and_has_at_least_two_round_ticks(
    first: float, second: float, most: int, from_zero: bool
) -> None:
    low, high = sorted((first, second))
    bottom, top, ticks = round_scale(low, high, 1e-3, most, from_zero=from_zero)
    assert bottom <= low <= high <= top
    assert not from_zero or bottom <= 0.0 <= top
    assert 2 <= len(ticks) <= most or high - low < 1e-3
    slack = 1e-6 * (top - bottom)
    assert all(bottom - slack <= tick <= top + slack for tick in ticks)


@pytest.mark.parametrize("value", [1e15, -1e17, 1e300, 1e-320, 0.0])
@pytest.mark.parametrize("from_zero", [True, False])
def test_rendering__constant_of_any_size_has_an_axis(value: float, *, from_zero: bool) -> None:
    bottom, top, _ = round_scale(value, value, None, 4, from_zero=from_zero)
    assert bottom <= value <= top
    assert bottom < top


def test_rendering__small_values_fill_their_axis() -> None:
    bottom, top, ticks = round_scale(0.010, 0.012, None, 4)
    assert top - bottom < 0.003
    assert ticks == pytest.approx([0.010, 0.011, 0.012])
    bottom, top, _ = round_scale(21.50, 21.51, None, 4)
    assert top - bottom > 0.1  # noise of a temperature does not


@pytest.mark.parametrize(
    ("first", "last", "texts"),
    [
        (0.0, 24.0, ["Mon 3 Jul", "03:00", "06:00", "09:00", "12:00", "15:00", "18:00", "21:00", "Tue 4 Jul"]),
        (13.5, 15.5, ["13:30", "13:45", "14:00", "14:15", "14:30", "14:45", "15:00", "15:15", "15:30"]),
    ],
)
def test_rendering__time_ticks_are_round(first: float, last: float, texts: list[str]) -> None:
    origin = datetime(2017, 7, 3)  # local standard time
    assert [format_time_tick(origin, tick) for tick in time_ticks(first, last)] == texts
    assert format_time(origin) == "Mon 3 Jul 2017, 00:00"


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (21.26, "°C", "21.3"), (-0.01, "°C", "0.0"), (12.0, "people", "12"), (3955.4, "kW", "3,955"),
        (97.34, "kW", "97.3"), (0.66, "kW", "0.66"), (0.0, "kW", "0"), (math.nan, "kW", "n/a"),
        (0.0014, "kW", "0.0014"),
        (2.5e7, "Pa", "2.5e+07"),
    ],
)  # fmt: skip
def test_rendering__values_have_a_sensible_number_of_digits(value: float, unit: str, text: str) -> None:
    assert format_value(value, unit) == text


def test_rendering__negative_values_have_a_minus_sign() -> None:
    assert format_value(-3955.0, "") == "\N{MINUS SIGN}3,955"
