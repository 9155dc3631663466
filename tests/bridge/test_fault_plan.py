"""Fault plans: what does not fit the node or is no plan is refused, with all its errors."""

from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.point_faults import BEGIN, NAN, plan_of, point_faults, room

from zenostat.bridge.faults import read_plan
from zenostat.bridge.faults.schedule import StepGrid, check, clock, span
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.fault_plan import When

WRONG = {
    "faults: [": ["is not valid YAML"],
    "fault: []": ["fault: there is no such field; did you mean 'faults'"],
    "seed: -1": ["seed: Input should be greater than or equal to 0, got -1"],
    "faults: [{points: a, offset: 1}]": ["faults.0: the kind is missing: one of bias, gain"],
    "faults: [{kind: biass, points: a}]": ["faults.0: no kind 'biass'; did you mean 'bias'"],
    "faults: [bias]": ["faults.0: a fault is a map with a kind"],
    "faults: [{kind: bias, points: a}]": ["faults.0.bias.offset: it is missing"],
    "faults: [{kind: bias, points: a, offset: '1'}]": ["faults.0.bias.offset: Input should be a valid number"],
    "faults: [{kind: bias, points: a, offset: .nan}]": ["faults.0.bias.offset: Input should be a finite number"],
    "faults: [{kind: bias, points: a, offset: 1, factor: 2}]": ["faults.0.bias.factor: there is no such field"],
    "faults: [{kind: bias, offset: 1}]": ["name points (sensors and meters) or actuators"],
    "faults: [{kind: loss, probability: 0.1}]": ["give samples: true, or commands"],
    "faults: [{kind: loss, points: a, probability: 0.1}]": ["faults.0.loss.points: there is no such field"],
    "faults: [{kind: clip, points: a}]": ["give low, high or both"],
    "faults: [{kind: clip, points: a, low: 2, high: 1}]": ["low 2 is not below high 1"],
    "faults: [{kind: noise, points: a, sigma: 0}]": ["faults.0.noise.sigma: Input should be greater than 0"],
    "faults: [{kind: spike, points: a, amplitude: 1, probability: 1.5}]": ["probability: Input should be less than"],
    "faults: [{kind: delay, points: a, steps: 1.5}]": ["faults.0.delay.steps: Input should be a valid integer"],
    "faults: [{kind: drop, points: a, when: {from_step: 5, to_step: 5}}]": ["from_step 5 is not before to_step 5"],
    "faults: [{kind: drop, points: a, when: {lasts_steps: 5}}]": ["lasts_steps requires a probability"],
    "faults: [{kind: drop, points: a, when: {from_time: noon}}]": ["expected a date and time such as 2017-07-03T08:00"],
    "faults: [{kind: drop, points: a, when: {from_time: 02-30}}]": ["'02-30' is not a valid date and time"],
    "faults: [{kind: drop, points: a, when: {hours: [9, 9]}}]": ["such as [9, 20] or [22, 6]"],
    "faults: [{kind: drop, points: a, when: {weekdays: [Monday]}}]": ["Input should be 'mon', 'tue'"],
    "faults: [{kind: drop, points: a, name: x}, {kind: freeze, points: a, name: x}]": ["used more than once: 'x'"],
    "faults: [{kind: drop, points: a b}, {kind: gain, points: c}]": ["faults.0.drop.points.0", "faults.1.gain.factor"],
}


@pytest.mark.parametrize("text", WRONG)
def test_point_faults__wrong_file_states_all_that_is_wrong(text: str, tmp_path: Path) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text(text)
    with pytest.raises(InvalidConfig) as error:
        read_plan(path)
    assert str(path) in str(error.value)
    for message in WRONG[text]:
        assert message in str(error.value)


def test_point_faults__file_that_is_not_there_is_a_mistake_of_the_users(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"there is no file .*nowhere\.yaml"):
        read_plan(tmp_path / "nowhere.yaml")


def test_point_faults__plan_that_does_not_fit_the_node_is_refused_with_all_its_mistakes() -> None:
    with pytest.raises(InvalidConfig) as error:
        point_faults(
            room("bias", name="far", offset=1.0, when={"from_time": "2018-07-03"}),
            {"kind": "drop", "points": ["room_temprature", "cooling", "*_temperature"]},
            {"kind": "stuck", "actuators": ["*", "power"], "value": 45.0},
            {"kind": "drop", "name": "between", "points": "power", "when": {"hours": [0.1, 0.2]}},
            end=BEGIN + timedelta(days=7),
        )
    assert str(error.value).splitlines() == [
        "fault 'drop 2': no sensor or meter 'room_temprature'; did you mean 'room_temperature' or 'hall_temperature'?",
        "fault 'drop 2': no sensor or meter 'cooling'; name it under actuators",
        "fault 'stuck 3': no actuator 'power'; name it under points",
        "fault 'stuck 3': cooling cannot be stuck at 45; its bounds are 10 to 30 degC",
        "fault 'stuck 3': heating cannot be stuck at 45; its bounds are 10 to 30 degC",
        "fault 'far' is never active: no sample is in its window; samples are every 900 s from 2017-07-03T00:00 to "
        "2017-07-10T00:00",
        "fault 'between' is never active: no sample is in its window; samples are every 900 s from 2017-07-03T00:00 to "
        "2017-07-10T00:00",
    ]


@pytest.mark.parametrize("bound", ["from_time", "to_time"])
def test_point_faults__day_that_the_year_of_the_run_period_does_not_have_is_refused(bound: str) -> None:
    with pytest.raises(InvalidConfig) as error:
        point_faults(
            room("bias", name="leap", offset=1.0, when={bound: "02-29T00:00"}),
            room("bias", name="far", offset=1.0, when={"from_time": "2018-07-03"}),
            end=BEGIN + timedelta(days=7),
        )
    lines = str(error.value).splitlines()
    assert lines[0] == "fault 'leap': '02-29T00:00' does not exist in 2017, the year of the run period"
    assert lines[1].startswith("fault 'far' is never active")


NEW_YEAR = (datetime(2017, 12, 30), datetime(2018, 1, 6))


@pytest.mark.parametrize(
    ("period", "when", "first", "end"),
    [
        (NEW_YEAR, {"from_time": "01-02"}, 3, 8),
        (NEW_YEAR, {"to_time": "01-02"}, 0, 3),
        (NEW_YEAR, {"from_time": "12-31", "to_time": "01-02"}, 1, 3),
        (NEW_YEAR, {"from_time": "12-01", "to_time": "01-02"}, 0, 3),
        (NEW_YEAR, {"from_time": "01-02", "to_time": "01-20"}, 3, 8),
        (NEW_YEAR, {"from_time": "2017-12-31", "to_time": "2018-01-02"}, 1, 3),
        ((datetime(2017, 6, 1), datetime(2019, 6, 1)), {"from_time": "07-01", "to_time": "06-15"}, 30, 379),
        ((datetime(2017, 1, 1), datetime(2018, 1, 1)), {"from_time": "12-01", "to_time": "01-01"}, 334, 365),
        ((datetime(2017, 7, 1), datetime(2018, 1, 1)), {"from_time": "01-01", "to_time": "07-03"}, 0, 2),
        ((datetime(2015, 12, 30), datetime(2016, 3, 3)), {"from_time": "02-29"}, 61, 65),
    ],
)
def test_fault_schedule__day_without_a_year_is_the_first_one_within_the_run_period(
    period: tuple[datetime, datetime], when: dict[str, Any], first: int, end: int
) -> None:
    assert span(When(**when), StepGrid(86_400.0, *period)) == (first, end)


@pytest.mark.parametrize("begins", [7, 8, 9, 10])
def test_point_faults__delay_that_begins_amid_an_episode_lets_no_former_command_through(begins: int) -> None:
    faults = point_faults({"kind": "delay", "actuators": "cooling", "steps": 3})
    faults.apply_to_commands(np.array([[29.0, 12.0, NAN]]), [-1])  # what had been commanded last
    commanded = [
        float(faults.apply_to_commands(np.array([[10.0 + k / 4, 12.0, NAN]]), [k])[0, 0])
        for k in range(begins, begins + 8)
    ]
    np.testing.assert_array_equal(commanded, [NAN, NAN, NAN, *(10.0 + k / 4 for k in range(begins, begins + 5))])


@pytest.mark.parametrize("step_s", [18_000.0, 780.0, 1_100.0])
def test_fault_schedule__hours_are_those_of_the_clock_for_any_timestep(step_s: float) -> None:
    """In weeks that are no whole number of timesteps, too."""
    grid = StepGrid(step_s, BEGIN)
    meets = clock(When(hours=(8, 17), weekdays=("mon", "fri")), grid)
    assert meets is not None
    steps = np.arange(int(5 * 7 * 86_400 / step_s))
    times = [BEGIN + timedelta(seconds=float(step) * step_s) for step in steps]
    expected = [8 <= time.hour < 17 and time.weekday() in (0, 4) for time in times]
    assert meets(steps).tolist() == expected


def test_point_faults__windows_that_last_longer_than_any_episode_are_refused() -> None:
    with pytest.raises(ValueError, match="less than 2147483648"):
        plan_of({"kind": "drop", "points": "power", "when": {"probability": 0.1, "lasts_steps": 2**63}})


def test_fault_schedule__looks_at_all_clock_times_of_short_timesteps() -> None:
    when = When(weekdays=["sun"])
    check("sunday", when, StepGrid(0.25, BEGIN, BEGIN + timedelta(days=7)))  # 2.4 million samples, from a Monday
    with pytest.raises(InvalidConfig, match="'sunday' is never active"):
        check("sunday", when, StepGrid(0.25, BEGIN, BEGIN + timedelta(days=5)))
