"""Runs of models that lack something: equal to those of a model that has it, with a sentence on what was assumed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building, find_weather

SENSORS = {
    "outdoor": ["Site Outdoor Air Drybulb Temperature", "Environment"],
    "core": ["Zone Mean Air Temperature", "Core_ZN"],
    "power": ["Facility Total HVAC Electricity Demand Rate", "Whole Building"],
}
DAY = {"weather": "USA_CO_Denver", "begin": "01-02", "end": "01-02", "steps_per_hour": 1, "sensors": SENSORS}


def episode(**arguments: Any) -> tuple[np.ndarray[Any, Any], tuple[str, ...]]:
    """Observations of the sensors at each sample of a day under baseline control, and the warnings on the model."""
    env = gym.make("zenostat/Building-v1", **{**DAY, "actuators": {}, "meters": {}, "affinity": "off", **arguments})
    try:
        rows = [env.reset(seed=0)[0]]
        is_over = False
        while not is_over:
            observation, *_, truncated, _ = env.step(env.action_space.sample())
            rows.append(observation)
            is_over = truncated
        return np.array(rows), env.unwrapped.manifest.warnings  # type: ignore[attr-defined]
    finally:
        env.close()


@pytest.fixture(scope="module")
def reference() -> np.ndarray[Any, Any]:
    """The day of the model itself."""
    return episode(building="ref-small-office")[0]


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.filterwarnings("ignore:.*the model has no")
@pytest.mark.parametrize(
    ("left_out", "words"),
    [
        ("SizingPeriod:DesignDay", "sized for the design days of the weather file"),
        ("SimulationControl", "no SimulationControl; it is sized"),
        ("RunPeriod", ""),
    ],
)
def test_run__of_a_model_that_lacks_an_object_equals_the_whole_model(
    left_out: str, words: str, reference: np.ndarray[Any, Any], tmp_path: Path
) -> None:
    objects = read_building(find_building("ref-small-office")).objects
    path = tmp_path / "mine.epJSON"
    path.write_text(json.dumps({kind: items for kind, items in objects.items() if kind != left_out}))
    values, warnings = episode(building=str(path))
    assert values.shape == reference.shape
    assert np.array_equal(values, reference)
    assert [words in text for text in warnings] == [True] * bool(words)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*missing values")
def test_run__missing_temperature_is_that_of_the_hour_before(tmp_path: Path) -> None:
    lines = find_weather("USA_CO_Denver").path.read_text("latin-1").splitlines()
    hour = 8 + 24 + 9  # the tenth hour of 2 January
    before = float(lines[hour - 1].split(",")[6])
    cells = lines[hour].split(",")
    assert float(cells[6]) != before
    cells[6] = "99.9"
    lines[hour] = ",".join(cells)
    path = tmp_path / "gap.epw"
    path.write_text("\r\n".join(lines) + "\r\n", encoding="latin-1")
    values, warnings = episode(building="ref-small-office", weather=str(path))
    assert values[10, 0] == pytest.approx(before)
    assert "gap has missing values: dry_bulb_temperature (1)" in warnings[0]
