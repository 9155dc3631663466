"""Unmet hours and site energy by hand; `tests/system/test_hvac_energy.py` compares them with EnergyPlus's summary."""

from datetime import timedelta

import pytest
from support.builders import NOON, manifest, meter, sensor, view

from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.topics.messages import Aggregation, Manifest

SUMMED = {"aggregation": Aggregation.SUM}
OFFICE = manifest(
    sensors=[
        sensor("heat", "Facility Heating Setpoint Not Met While Occupied Time", "FACILITY", "hr"),
        sensor("cool", "Facility Cooling Setpoint Not Met While Occupied Time", "FACILITY", "hr"),
    ],
    meters=[meter("electricity"), meter("gas", "NaturalGas:Facility")],
)
OFFICE = OFFICE.model_copy(
    update={"floor_area_m2": 50.0, "sensors": tuple(s.model_copy(update=SUMMED) for s in OFFICE.sensors)}
)


def measured(of: Manifest, *rows: dict[str, float]) -> EpisodeMetrics:
    metrics = MetricsAccumulator(of)
    before = dict.fromkeys(of.names, 9.0)  # what happened before sample 0 does not count
    for step, row in enumerate((before, *rows)):
        values = dict.fromkeys(of.names, 0.0) | row
        metrics.add(view(of, NOON + step * timedelta(minutes=15), step=step, **values))
    return metrics.result()


def test_unmet_hours__are_the_sum_over_the_timesteps() -> None:
    result = measured(OFFICE, {"heat": 0.25}, {}, {"heat": 0.25, "cool": 0.25})
    assert (result.unmet_heating_h, result.unmet_cooling_h) == (0.5, 0.25)


def test_unmet_hours__are_unknown_where_they_are_not_measured() -> None:
    result = measured(OFFICE.model_copy(update={"sensors": ()}), {})
    assert (result.unmet_heating_h, result.unmet_cooling_h) == (None, None)


def test_site_energy__is_that_of_all_fuels_per_floor_area() -> None:
    result = measured(OFFICE, {"electricity": 3.6e6, "gas": 7.2e6}, {"gas": 3.6e6})
    assert result.site_kwh_m2 == pytest.approx(4.0 / 50.0)


def test_metrics__timesteps_of_lost_samples_are_counted() -> None:
    metrics = MetricsAccumulator(OFFICE)
    metrics.begin(view(OFFICE, NOON, step=2))
    for step in (3, 7, 8):
        metrics.add(view(OFFICE, NOON + step * timedelta(minutes=15), step=step, electricity=3.6e6))
    result = metrics.result()
    assert (result.steps, result.lost) == (3, 3)
    assert result.energy_kwh["electricity"] == pytest.approx(3.0)
    metrics.add(view(OFFICE, NOON))
    assert metrics.result().lost == 0
