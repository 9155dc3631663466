"""Values behind figures as a page's script reads them: close to the originals, and nothing but text."""

import json
import re
from typing import Any

import numpy as np
import pytest
from support.trajectories import office_comparison

from zenostat.views.report.figures.base import draw
from zenostat.views.report.page import page
from zenostat.views.report.readings import CODE, Series, read_lines, read_series, readings

pytest.importorskip("matplotlib")

MIDNIGHT = np.datetime64("2017-07-03T00:00:00")


def unpacked(packed: list[Any], letters: int) -> np.ndarray:
    """Return packed values: numbers in base 64, the highest of them for no value."""
    low, high, text = packed
    text = re.sub(rf"([^*]{{{letters}}})\*(\d+)\*", lambda match: match[1] * int(match[2]), text)
    codes = [text[place : place + letters] for place in range(0, len(text), letters)]
    levels = np.array(
        [sum(CODE.index(letter) * 64**power for power, letter in enumerate(code[::-1])) for code in codes]
    )
    top = 64**letters - 2
    return np.where(levels > top, np.nan, low + (high - low) * levels / top)


def entries(series: list[Series]) -> Any:
    def fill(figure: Any) -> None:
        axis = figure.subplots()
        axis.set_xlim(0.0, 2.0)
        read_series(axis, "kW", series, MIDNIGHT)

    drawing = draw("test", 2.0, fill)
    drawing.draw_without_rendering()
    (entry,) = json.loads(readings(drawing))
    return entry


def test_report__values_are_within_half_a_step_of_their_range_and_gaps_stay_gaps() -> None:
    random = np.random.default_rng(3)
    y = np.concatenate([random.uniform(-40.0, 90.0, 500), np.full(90, 7.0), [np.nan] * 3, random.uniform(0.0, 1.0, 9)])
    x = np.sort(random.uniform(0.0, 365.0, len(y)))
    (line,) = entries([Series("rbc", "#c2500a", x, y)])["series"]
    np.testing.assert_allclose(unpacked(line["y"], 2), y, atol=0.5001 * np.ptp(y[np.isfinite(y)]) / 4094)
    np.testing.assert_allclose(unpacked(line["x"], 4), x, atol=0.5001 * np.ptp(x) / (64**4 - 2))
    assert line["color"] == "var(--series-3)"
    assert len(line["y"][2]) < 2 * 520  # 90 equal values take a few letters


def test_report__lowest_and_highest_value_are_exact_and_a_constant_is_one_number() -> None:
    x = np.arange(5) / 96
    lines = entries([Series("a", "", x, np.array([21.1, 24.3, 21.1, 24.3, 21.1])), Series("b", "", x, np.full(5, 0.1))])
    high, flat = (unpacked(line["y"], 2) for line in lines["series"])
    assert high.tolist() == [21.1, 24.3, 21.1, 24.3, 21.1]
    assert flat.tolist() == [0.1] * 5
    assert lines["series"][0]["x"] == pytest.approx([0.0, 1 / 96])  # equal distances are not listed


def test_report__box_of_an_axis_is_where_it_is_drawn() -> None:
    def fill(figure: Any) -> None:
        axis = figure.subplots()
        axis.plot([0.0, 1.0], [5.0, 6.0], label="power")
        axis.set_xlim(0.0, 1.0)
        axis.set_ylim(5.0, 6.0)
        read_lines(axis, "kW")

    drawing = draw("test", 2.0, fill)
    drawing.draw_without_rendering()
    (entry,) = json.loads(readings(drawing))
    axis = drawing.axes[0]
    to_points = 72.0 / drawing.dpi
    (left, bottom), (right, top) = (axis.transData.transform(corner) * to_points for corner in ((0.0, 5.0), (1.0, 6.0)))
    assert entry["box"] == pytest.approx([left, 144.0 - top, right, 144.0 - bottom], abs=0.01)
    assert (entry["span"], entry["series"][0]["label"]) == ([0.0, 1.0], "power")


@pytest.mark.slow
def test_report__names_of_users_do_not_end_the_block() -> None:
    text = page(office_comparison(("baseline", "</script><b>")))
    blocks = re.findall(r'<script type="application/json">(.*?)</script>', text)
    labels = {line["label"] for block in blocks for entry in json.loads(block) for line in entry["series"]}
    assert "</script><b>" in labels
    assert "<b>" not in text
