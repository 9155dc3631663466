"""Charts of the terminal: what a reader sees at a place is the value at that time."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.cli.chart import Line, Scale, chart, scale_of

BEGIN = datetime(2017, 7, 3)


def line(values: list[float]) -> Line:
    array = np.array(values, float)
    return Line(array, array, array)


def drawn(lines: list[Line], *, width: int = 80, rows: int = 10, step_s: float = 900.0, **options: object) -> list[str]:
    times = [BEGIN + timedelta(seconds=step_s * i) for i in range(len(lines[0].values))]
    return [str(text) for text in chart(lines, times, width=width, rows=rows, scale=scale_of(lines, rows), **options)]


def test_a_ramp__rises_from_the_lower_left_to_the_upper_right() -> None:
    *body, _, _ = drawn([line([float(i) for i in range(97)])], is_unicode=False)
    columns = [row.find("*") for row in body]
    assert columns == sorted(columns, reverse=True)
    assert body[-1].index("*") < 8
    assert body[0].rindex("*") > 70


@pytest.mark.parametrize("width", [40, 80, 200])
def test_no_line__is_wider_than_the_terminal(width: int) -> None:
    rows = drawn([line([1e6 * np.sin(i / 9) for i in range(500)])], width=width)
    assert max(map(len, rows)) <= width


def test_a_gap__is_blank() -> None:
    *body, _, _ = drawn([line([1.0] * 40 + [np.nan] * 40 + [1.0] * 40)], is_unicode=False)
    row = next(row for row in body if "*" in row)
    drawn_part = row[row.index("*") :]
    third = len(drawn_part) // 3
    assert "*" not in drawn_part[third + 2 : 2 * third - 2]
    assert drawn_part.rstrip().endswith("*")


def test_values_that_are_all_missing__give_an_empty_chart() -> None:
    *body, _, _ = drawn([line([np.nan] * 9)], is_unicode=False)
    assert not any("*" in row for row in body)


def test_chart__single_sample_is_a_dot() -> None:
    assert sum(row.count("*") for row in drawn([line([5.0])], is_unicode=False)) == 1


def test_a_range_between_two_samples__is_drawn() -> None:
    values, highs = np.zeros(50), np.zeros(50)
    highs[25] = 10.0
    *body, _, _ = drawn([Line(values, values, highs)], is_unicode=False)
    assert "*" in body[0]


def test_the_time_axis__has_dates_at_midnight_and_times_between() -> None:
    labels = drawn([line([1.0] * 97)])[-1].split()
    assert labels == ["07-03", "03:00", "06:00", "09:00", "12:00", "15:00", "18:00", "21:00", "07-04"]


@given(
    st.lists(st.floats(-1e12, 1e12), min_size=1, max_size=30).filter(
        lambda v: max(v) == min(v) or max(v) - min(v) > 1e-3
    ),
    st.integers(3, 40),
)
def test_a_scale__contains_all_values_with_few_round_labels(values: list[float], rows: int) -> None:
    scale = scale_of([line(values)], rows)
    slack = 1e-6 * (scale.high - scale.low)
    assert scale.low - slack <= min(values)
    assert max(values) <= scale.high + slack
    assert 2 <= len(scale.ticks()) <= max(4, rows // 2 + 3)
    assert drawn([line(values)], rows=rows)


def test_labels__have_the_digits_of_their_distance() -> None:
    assert [Scale(20.0, 21.0, 0.25).label(v) for v in (20.0, 20.25)] == ["20.00", "20.25"]
    assert Scale(0.0, 1.0, 0.2).label(0.2 * 3) == "0.6"
    assert Scale(0.0, 4e6, 2e6).label(2e6) == "2,000,000"


@pytest.mark.parametrize(
    "ends", [(20.0, 20.000001), (0.1, 0.10000001), (5e9, 5.00001e9), (1e9 - 5, 1e9 + 5), (-2e20, -1.999e20)]
)
def test_a_scale__labels_of_nearly_constant_values_differ_and_are_the_values(ends: tuple[float, float]) -> None:
    scale = scale_of([line([*ends])], 10)
    labels = [float(scale.label(value).replace(",", "")) for value in scale.ticks()]
    np.testing.assert_allclose(labels, scale.ticks(), rtol=0, atol=0.05 * scale.step)
