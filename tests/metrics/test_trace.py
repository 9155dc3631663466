"""The samples of an episode in arrays."""

from __future__ import annotations

from datetime import timedelta

import numpy as np
import pytest
from support.traces import office, sample

from zenostat.metrics.trace import TraceRecorder, weather_trace
from zenostat.topics.errors import UsageError
from zenostat.topics.messages import WeatherSeries

OFFICE = office(("core",), steps=4)
VALUES = [24.0, 2.0, 1e6, 5e5, 4e5, 3e5, 3e5]


def test_rows_are_samples_and_terms_belong_to_the_timesteps_between_them() -> None:
    recorder = TraceRecorder(OFFICE)
    for step in range(5):
        row = [20.0 + step, *VALUES[1:]]
        recorder.add(sample(OFFICE, step, row), {"energy": -float(step)} if step else None)
    trace = recorder.trace()
    assert trace.values[:, 0].tolist() == [20.0, 21.0, 22.0, 23.0, 24.0]
    assert trace.terms["energy"].tolist() == [-1.0, -2.0, -3.0, -4.0]
    assert trace.steps == 4
    assert trace.end - trace.begin == timedelta(hours=1)
    assert [begin.minute for begin in trace.begins()] == [0, 15, 30, 45]


def test_an_episode_joined_late_and_ended_early_has_the_timesteps_between() -> None:
    recorder = TraceRecorder(OFFICE)
    recorder.add(sample(OFFICE, 1, VALUES))
    recorder.add(sample(OFFICE, 3, VALUES))  # sample 2 was missed
    trace = recorder.trace()
    assert trace.begin.minute == 15
    assert trace.steps == 2
    assert np.isnan(trace.values[1]).all()
    assert trace.values[2].tolist() == VALUES


def test_sample_0_starts_again() -> None:
    recorder = TraceRecorder(OFFICE)
    for step in (0, 1, 2, 0, 1):
        recorder.add(sample(OFFICE, step, VALUES), {"energy": -1.0} if step else None)
    trace = recorder.trace()
    assert trace.steps == 1
    assert trace.terms["energy"].tolist() == [-1.0]


def test_sources_keep_their_numbers_and_get_names_for_readers() -> None:
    recorder = TraceRecorder(OFFICE)
    for step, source in enumerate((0, 1, 2, 1)):
        recorder.add(sample(OFFICE, step, VALUES, source=source))
    trace = recorder.trace({"env-1": "rbc"})
    assert [trace.sources[number] for number in trace.source_index[:, 0]] == ["", "rbc", "operator", "rbc"]


def test_a_changed_list_of_sources_does_not_mix_them_up() -> None:
    recorder = TraceRecorder(OFFICE)
    for step, sources in enumerate((["", "env-1"], ["", "operator"], ["", "operator", "env-1"])):
        view = sample(OFFICE, step, VALUES, source=len(sources) - 1)
        view.message = view.message.model_copy(update={"sources": sources})
        recorder.add(view)
    trace = recorder.trace()
    assert [trace.sources[number] for number in trace.source_index[:, 0]] == ["env-1", "operator", "env-1"]


def test_nothing_recorded_is_an_error() -> None:
    recorder = TraceRecorder(OFFICE)
    with pytest.raises(UsageError, match="no timestep"):
        recorder.trace()
    recorder.add(sample(OFFICE, 0, VALUES))
    with pytest.raises(UsageError, match="no timestep"):
        recorder.trace()


def test_the_weather_ends_with_the_episode_and_radiation_is_a_power() -> None:
    table = np.array([[10.0, 100.0], [11.0, 200.0], [12.0, 300.0]])
    columns = ["dry_bulb_temperature", "global_horizontal_radiation"]
    series = WeatherSeries(
        episode=0, columns=columns, units=["degC", "Wh/m2"], step_s=1800.0, values=table.astype("<f8").tobytes()
    )  # fmt: skip
    weather = weather_trace(series, timedelta(hours=1))
    assert weather.temperature.tolist() == [10.0, 11.0]
    assert weather.solar.tolist() == [200.0, 400.0]  # Wh/m2 in half an hour
