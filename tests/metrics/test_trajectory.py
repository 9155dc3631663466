"""Trajectories: one run in arrays, with names, units and times."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from support.trajectories import office, sample

from zenostat.metrics.episode_weather import read_weather
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics.errors import InvalidConfig, UnknownName, UsageError
from zenostat.topics.messages import Aggregation, WeatherSeries

OFFICE = office(("core",), steps=4)
VALUES = [24.0, 2.0, 1e6, 5e5, 4e5, 3e5, 3e5]


def test_trajectory__rows_are_samples_and_terms_belong_to_the_timesteps_between_them() -> None:
    recorder = TrajectoryRecorder(OFFICE)
    for step in range(5):
        row = [20.0 + step, *VALUES[1:]]
        recorder.add(sample(OFFICE, step, row), {"energy": -float(step)} if step else None)
    trajectory = recorder.trajectory()
    assert trajectory.values[:, 0].tolist() == [20.0, 21.0, 22.0, 23.0, 24.0]
    assert trajectory.terms["energy"].tolist() == [-1.0, -2.0, -3.0, -4.0]
    assert trajectory.steps == 4
    assert trajectory.end - trajectory.begin == timedelta(hours=1)
    assert [begin.minute for begin in trajectory.begins()] == [0, 15, 30, 45]


def test_trajectory__episode_joined_late_and_ended_early_has_the_timesteps_between() -> None:
    recorder = TrajectoryRecorder(OFFICE)
    recorder.add(sample(OFFICE, 1, VALUES))
    recorder.add(sample(OFFICE, 3, VALUES))  # sample 2 was missed
    trajectory = recorder.trajectory()
    assert trajectory.begin.minute == 15
    assert trajectory.steps == 2
    assert np.isnan(trajectory.values[1]).all()
    assert trajectory.values[2].tolist() == VALUES


def test_trajectory__sample_0_starts_again() -> None:
    recorder = TrajectoryRecorder(OFFICE)
    for step in (0, 1, 2, 0, 1):
        recorder.add(sample(OFFICE, step, VALUES), {"energy": -1.0} if step else None)
    trajectory = recorder.trajectory()
    assert trajectory.steps == 1
    assert trajectory.terms["energy"].tolist() == [-1.0]


def test_trajectory__sources_keep_their_numbers_and_get_names_for_readers() -> None:
    recorder = TrajectoryRecorder(OFFICE)
    for step, source in enumerate((0, 1, 2, 1)):
        recorder.add(sample(OFFICE, step, VALUES, source=source))
    trajectory = recorder.trajectory({"env-1": "rbc"})
    assert [trajectory.sources[number] for number in trajectory.source_index[:, 0]] == ["", "rbc", "operator", "rbc"]


def test_trajectory__changed_list_of_sources_does_not_mix_them_up() -> None:
    recorder = TrajectoryRecorder(OFFICE)
    for step, sources in enumerate((["", "env-1"], ["", "operator"], ["", "operator", "env-1"])):
        view = sample(OFFICE, step, VALUES, source=len(sources) - 1)
        view.message = view.message.model_copy(update={"sources": sources})
        recorder.add(view)
    trajectory = recorder.trajectory()
    assert [trajectory.sources[number] for number in trajectory.source_index[:, 0]] == ["env-1", "operator", "env-1"]


def recorded(steps: int = 9) -> Trajectory:
    """An office whose temperature is the step, and whose meters count 1 J in each timestep."""
    of = office(("core",), steps=steps)
    recorder = TrajectoryRecorder(of)
    for step in range(steps + 1):
        recorder.add(sample(of, step, [float(step), 2.0, *[1.0] * 5]), {"energy": -1.0} if step else None)
    return recorder.trajectory()


def test_trajectory__parts_by_name_step_and_time_are_views() -> None:
    whole = recorded()
    assert whole["core_air_temperature"].tolist() == [*map(float, range(10))]
    assert whole.units["core_air_temperature"] == "degC"
    with pytest.raises(UnknownName, match="core_air_temperature"):
        whole["core_temperature"]
    part = whole.between_steps(2, 4)
    assert (part.step.tolist(), part.steps, len(part.terms["energy"])) == ([2, 3, 4], 2, 2)
    assert part.fault_free_values is part.values
    assert np.shares_memory(part.values, whole.values)
    timed = whole.between("07-03T00:30", "07-03T01:10")
    assert timed.step.tolist() == part.step.tolist()
    assert (timed.begin.minute, timed.end.hour) == (30, 1)
    assert whole.between().step.tolist() == whole.step.tolist()


def test_trajectory__longer_timesteps_have_means_of_sensors_and_sums_of_meters_and_terms() -> None:
    hourly = recorded().between_steps(1).resample(timedelta(hours=1))  # from step 4, the first whole hour
    assert hourly.time.astype("datetime64[m]").astype(str).tolist() == ["2017-07-03T01:00", "2017-07-03T02:00"]
    assert hourly["core_air_temperature"].tolist() == [4.0, 6.5]
    assert hourly.values[:, 2].tolist() == [1.0, 4.0]
    assert hourly.terms["energy"].tolist() == [-4.0]
    assert hourly.manifest.step_s == 3600.0
    with pytest.raises(InvalidConfig, match="9 timesteps of 900 s to 1000 s"):
        recorded().resample(timedelta(seconds=1000))


def test_trajectory__return_to_before_the_first_sample_starts_again() -> None:
    recorder = TrajectoryRecorder(OFFICE)
    for step in (3, 4, 1, 2):
        recorder.add(sample(OFFICE, step, [float(step), *VALUES[1:]]))
    assert len(recorder) == 2
    assert recorder.trajectory().values[:, 0].tolist() == [1.0, 2.0]


def test_trajectory__longer_timesteps_have_sums_of_sensors_that_are_sums() -> None:
    whole = recorded()
    hours = whole.manifest.sensors[1].model_copy(update={"aggregation": Aggregation.SUM, "unit": "h"})
    sensors = [whole.manifest.sensors[0], hours, *whole.manifest.sensors[2:]]
    hourly = replace(whole, manifest=whole.manifest.model_copy(update={"sensors": sensors})).resample(
        timedelta(hours=1)
    )
    assert hourly.values[1:, 0].tolist() == [2.5, 6.5]  # a mean as before
    assert hourly.values[:, 1].tolist() == [2.0, 8.0, 8.0]


def test_trajectory__table_has_rewards_in_the_rows_of_the_samples_that_close_their_timesteps() -> None:
    table = recorded(2).columns()
    assert table["step"].tolist() == [0, 1, 2]
    assert np.array_equal(table["reward.energy"], [np.nan, -1.0, -1.0], equal_nan=True)
    assert table["core_cooling_setpoint.source"].tolist() == [""] * 3


def test_trajectory__parquet_file_has_the_table_and_its_units(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    whole = recorded()
    whole.to_parquet(tmp_path / "run.parquet")
    table = parquet.read_table(tmp_path / "run.parquet")
    assert table.column_names == [*whole.columns()]
    assert table["core_air_temperature"].to_pylist() == whole["core_air_temperature"].tolist()
    assert table.schema.field("core_air_temperature").metadata == {b"unit": b"degC"}


def test_trajectory__values_without_faults_are_kept_from_the_first_fault_on() -> None:
    recorder = TrajectoryRecorder(OFFICE)
    for step in range(3):
        view = sample(OFFICE, step, VALUES)
        if step == 1:
            faulty = np.array([99.0, *VALUES[1:]]).tobytes()
            both = {"values": faulty, "fault_free_values": view.message.values}
            view.message = view.message.model_copy(update=both)
        recorder.add(view)
    trajectory = recorder.trajectory()
    assert trajectory["core_air_temperature"].tolist() == [24.0, 99.0, 24.0]
    assert trajectory.fault_free_values[:, 0].tolist() == [24.0] * 3


def test_trajectory__run_under_baseline_control_has_its_values_and_no_other_source() -> None:
    of = OFFICE.model_copy(update={"baseline": True})
    recorder = TrajectoryRecorder(of)
    for step in range(2):
        view = sample(of, step, VALUES, source=1)
        below = {"baseline": np.array([20.0, *VALUES[1:]]).tobytes(), "baseline_effective": np.full(1, 25.0).tobytes()}
        view.message = view.message.model_copy(update=below)
        recorder.add(view)
    baseline = recorder.trajectory().under_baseline()
    assert baseline.fault_free_values[:, 0].tolist() == [20.0, 20.0]
    assert baseline["core_cooling_setpoint"].tolist() == [25.0, 25.0]
    assert not baseline.source_index.any()
    with pytest.raises(InvalidConfig, match="no baseline"):
        recorded().under_baseline()


def test_trajectory__copied_recorder_continues_by_itself() -> None:
    recorder = TrajectoryRecorder(OFFICE)
    for step in range(2):
        recorder.add(sample(OFFICE, step, VALUES), orders=np.full(1, 24.0))
    other = recorder.copy()
    other.add(sample(OFFICE, 2, VALUES))
    recorder.add(sample(OFFICE, 2, [*VALUES[:-1], 7.0]), orders=np.full(1, 25.0))
    assert (len(other), other.trajectory().values[2].tolist()) == (3, VALUES)
    assert np.array_equal(other.trajectory().orders, [[24.0], [24.0], [np.nan]], equal_nan=True)
    assert recorder.trajectory().orders[:, 0].tolist() == [24.0, 24.0, 25.0]


def test_trajectory__nothing_recorded_is_an_error() -> None:
    recorder = TrajectoryRecorder(OFFICE)
    with pytest.raises(UsageError, match="no timestep"):
        recorder.trajectory()
    recorder.add(sample(OFFICE, 0, VALUES))
    with pytest.raises(UsageError, match="no timestep"):
        recorder.trajectory()


def test_trajectory__weather_ends_with_the_episode_and_radiation_is_what_energyplus_takes_it_for() -> None:
    """EnergyPlus takes the radiation of a row for W/m2, also where an hour has several rows."""
    table = np.array([[10.0, 100.0], [11.0, 200.0], [12.0, 300.0]])
    columns = ["dry_bulb_temperature", "global_horizontal_radiation"]
    series = WeatherSeries(
        episode=0, columns=columns, units=["degC", "Wh/m2"], step_s=1800.0, values=table.astype("<f8").tobytes()
    )  # fmt: skip
    weather = read_weather(series, timedelta(hours=1))
    assert weather.temperature.tolist() == [10.0, 11.0]
    assert weather.solar.tolist() == [100.0, 200.0]


def test_trajectory__no_point_replaces_a_column_of_the_table() -> None:
    whole = recorded(2)
    names = ("time", "core_cooling_setpoint.source", "reward", "step", "time_2", "reward.energy", "slot")
    points = tuple(
        point.model_copy(update={"name": name, "unit": f"u{place}"})
        for place, (point, name) in enumerate(zip(whole.manifest.points, names, strict=True))
    )
    count = len(whole.manifest.sensors)
    of = whole.manifest.model_copy(update={"sensors": points[:count], "meters": points[count:]})
    odd = replace(whole, manifest=of)
    table = odd.columns()
    assert np.array_equal(table["time"], whole.time)
    assert (table["step"].tolist(), table["slot"].tolist()) == ([0, 1, 2], [0, 0, 0])
    assert np.array_equal(table["reward.energy"], [np.nan, -1.0, -1.0], equal_nan=True)
    assert table["core_cooling_setpoint.source_2"].tolist() == [""] * 3
    renamed = {"time_3": "time", "reward_2": "reward", "step_2": "step", "reward.energy_2": "reward.energy"}
    assert odd.renamed == renamed | {"slot_2": "slot"}
    for column, name in {**odd.renamed, "time_2": "time_2"}.items():
        assert table[column].tolist() == whole.values[:, names.index(name)].tolist()
        assert odd.column_units[column] == f"u{names.index(name)}"
    assert not {"time", "reward.energy"} & odd.column_units.keys()


def test_trajectory__time_without_a_year_is_in_the_year_that_has_it() -> None:
    recorder = TrajectoryRecorder(of := office(("core",), steps=4 * 96, begin="2017-12-30T00:00:00"))
    for step in range(4 * 96 + 1):
        recorder.add(sample(of, step, VALUES))
    part = recorder.trajectory().between("01-01", "01-01T12:00")
    assert (part.step[0], part.step[-1]) == (2 * 96, 2 * 96 + 48)
    assert recorder.trajectory().between("12-31", "01-02").steps == 2 * 96


def test_trajectory__times_without_a_sample_between_them_are_an_error() -> None:
    with pytest.raises(InvalidConfig, match=r"no sample from 07-03T01:00 to 07-03T00:30: .* 2017-07-03 00:00:00 to "):
        recorded().between("07-03T01:00", "07-03T00:30")
    with pytest.raises(InvalidConfig, match="no sample from 07-04 to 2017-07-03 02:15:00"):
        recorded().between("07-04")


def test_trajectory__timesteps_that_lack_a_value_are_counted() -> None:
    whole = recorded()
    values = whole.values.copy()
    values[3, 2] = values[5:7, 0] = np.nan
    values[:, 4] = np.nan  # never measured
    assert (replace(whole, fault_free_values=values).incomplete_steps, whole.incomplete_steps) == (3, 0)
