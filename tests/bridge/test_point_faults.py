"""Faults of points: each kind by hand calculation, chance by its laws, and nothing else touched to the bit."""

import math
import pickle
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.point_faults import ACTUATORS, BEGIN, HOUR, NAMES, NAN, STEP_S, point_faults, room

from zenostat.bridge.faults import FaultTransition, PointFaults, Transition, read_plan
from zenostat.topics import codec, yaml12
from zenostat.topics.calendar import WEEKDAYS
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.fault_plan import KINDS, FaultPlan
from zenostat.topics.points import LARGEST

ROOT = Path(__file__).parents[2]


def series(faults: PointFaults, values: list[float], first: int = 0) -> list[float]:
    """Return the room's temperature that the bus gets in an episode; the other points must be untouched."""
    disturbed = []
    for step, value in enumerate(values, first):
        out = faults.apply_to_sensors(np.array([[value, 18.25, 0.1]]), [step])
        assert out[0, 1:].tolist() == [18.25, 0.1]
        disturbed.append(float(out[0, 0]))
    return disturbed


def commands(faults: PointFaults, values: list[float]) -> list[float]:
    """Return the cooling setpoints that the building gets."""
    return [float(faults.apply_to_commands(np.array([[v, 12.0, NAN]]), [k])[0, 0]) for k, v in enumerate(values)]


def cooling(kind: str, **arguments: Any) -> dict[str, Any]:
    return {"kind": kind, "actuators": "cooling", **arguments}


# Each kind by hand

SOME = {"from_step": 1, "to_step": 3}


@pytest.mark.parametrize(
    ("fault", "values", "expected"),
    [
        (room("bias", offset=1.5, when=SOME), [20.0, 21.0, 22.0, 23.0], [20.0, 22.5, 23.5, 23.0]),
        (room("gain", factor=-0.5, when=SOME), [20.0, 21.0, 22.0, 23.0], [20.0, -10.5, -11.0, 23.0]),
        # a quarter of an hour a step; the window begins at step 1
        (room("drift", rate_per_h=2.0, when={"from_step": 1}), [20.0] * 4, [20.0, 20.0, 20.5, 21.0]),
        (room("freeze", when=SOME), [20.0, 21.0, 22.0, 23.0], [20.0, 21.0, 21.0, 23.0]),
        (room("stuck", value=-3.0, when=SOME), [20.0, 21.0, 22.0, 23.0], [20.0, -3.0, -3.0, 23.0]),
        (room("quantize", resolution=0.5), [20.2, 20.3, -0.8, 20.75], [20.0, 20.5, -1.0, 21.0]),
        (room("clip", low=19.0, high=21.0), [18.0, 19.5, 30.0], [19.0, 19.5, 21.0]),
        (room("clip", high=21.0), [-90.0, 30.0], [-90.0, 21.0]),
        (room("spike", amplitude=5.0, probability=1.0, two_sided=False), [20.0, 21.0], [25.0, 26.0]),
        (room("drop", when=SOME), [20.0] * 4, [20.0, NAN, NAN, 20.0]),
        # no sensor measures an infinity, and a resolution finer than a float64's changes nothing
        (room("gain", factor=1e308), [20.0, -20.0], [LARGEST, -LARGEST]),
        (room("drift", rate_per_h=1e308), [20.0, 20.0, 20.0], [20.0, 0.25e308, 0.5e308]),
        (room("quantize", resolution=5e-324), [20.1, -0.3], [20.1, -0.3]),
        # a delay knows what was before its window
        (room("delay", steps=2, when={"from_step": 3, "to_step": 5}), [0, 1, 2, 3, 4, 5], [0, 1, 2, 1, 2, 5]),
    ],
    ids=lambda value: value.get("kind") if isinstance(value, dict) else None,
)
def test_point_faults__kind_by_hand(fault: dict[str, Any], values: list[float], expected: list[float]) -> None:
    assert np.array_equal(series(point_faults(fault), values), expected, equal_nan=True)


@pytest.mark.parametrize("n", [1, 3, 7])
def test_point_faults__delay_is_the_shifted_series(n: int) -> None:
    values = np.random.default_rng(0).normal(size=40).tolist()
    delayed = series(point_faults(room("delay", steps=n)), values)
    assert np.isnan(delayed[:n]).all()
    assert delayed[n:] == values[:-n]


@given(st.floats(), st.lists(st.floats(), min_size=1, max_size=5))
def test_point_faults__what_is_frozen_holds_to_the_bit(value: float, later: list[float]) -> None:
    faults = point_faults({"kind": "freeze", "points": "*"})
    raw = np.full((1, 3), value).tobytes()
    for step, other in enumerate([value, *later]):
        assert faults.apply_to_sensors(np.full((1, 3), other), [step]).tobytes() == raw


def test_point_faults__fault_that_comes_again_begins_anew() -> None:
    # every day from 0:30 to 1:00, two steps: frozen at the first of them, and drift from zero
    when = {"hours": [0.5, 1]}
    values = [float(k) for k in range(24 * HOUR + 4)]
    frozen = series(point_faults(room("freeze", when=when)), values)
    drifted = series(point_faults(room("drift", rate_per_h=4.0, when=when)), values)
    for first in (2, 24 * HOUR + 2):
        assert frozen[first : first + 2] == [first, first]
        assert drifted[first : first + 2] == [first, first + 2]
    assert frozen[4 : 24 * HOUR + 2] == values[4 : 24 * HOUR + 2]


def test_point_faults__faults_of_a_point_act_one_on_the_other_in_order() -> None:
    bias, gain = room("bias", offset=1.0), room("gain", factor=2.0)
    assert series(point_faults(bias, gain), [20.0]) == [42.0]
    assert series(point_faults(gain, bias), [20.0]) == [41.0]


# Actuators


@pytest.mark.parametrize(
    ("fault", "sent", "expected"),
    [
        # a command that does not arrive leaves the former one; where there was none, the building goes on
        (cooling("drop", when={"from_step": 2, "to_step": 4}), [24, 25, 26, NAN, 28], [24, 25, 25, 25, 28]),
        (cooling("drop"), [24.0, 25.0], [NAN, NAN]),
        # commands come later, and so does a release
        (cooling("delay", steps=2), [24.0, 25.0, NAN, 26.0, 27.0], [NAN, NAN, 24.0, 25.0, NAN]),
        # what is frozen is not released
        (cooling("freeze", when={"from_step": 1}), [24.0, 25.0, NAN], [24.0, 25.0, 25.0]),
        # what is disturbed stays within the bounds
        (cooling("bias", offset=8.0), [20.0, 25.0], [28.0, 30.0]),
        (cooling("bias", offset=-8.0), [20.0, 11.0], [12.0, 10.0]),
    ],
    ids=lambda value: value.get("kind") if isinstance(value, dict) else None,
)
def test_point_faults__commands_by_hand(fault: dict[str, Any], sent: list[float], expected: list[float]) -> None:
    assert np.array_equal(commands(point_faults(fault), sent), expected, equal_nan=True)


def test_point_faults__what_is_released_stays_so_unless_it_is_stuck() -> None:
    relinquished = [NAN, NAN]
    for kind in (
        {"kind": "bias", "offset": 1.0},
        {"kind": "gain", "factor": 2.0},
        {"kind": "drift", "rate_per_h": 2.0},
        {"kind": "noise", "sigma": 1.0},
        {"kind": "quantize", "resolution": 0.5},
        {"kind": "spike", "amplitude": 2.0, "probability": 1},
        {"kind": "clip", "low": 20.0},
        {"kind": "freeze"},
    ):
        assert np.isnan(commands(point_faults({"actuators": "cooling", **kind}), relinquished)).all(), kind
    assert commands(point_faults(cooling("stuck", value=22.0)), relinquished) == [22.0, 22.0]


def test_point_faults__disturbed_command_without_bounds_has_none() -> None:
    damper = point_faults({"kind": "bias", "actuators": "damper", "offset": 1e6})
    assert damper.apply_to_commands(np.array([[20.0, 20.0, 1.0]]), [0]).tolist() == [[20.0, 20.0, 1000001.0]]


def test_fault__is_on_for_points_and_actuators_together_and_reported_once() -> None:
    faults = point_faults(
        {"name": "x", "kind": "bias", "offset": 1.0, "points": "power", "actuators": "cooling", "when": SOME}
    )
    for step in range(4):
        on = step in (1, 2)
        assert faults.apply_to_sensors(np.array([[0.0, 0.0, 5.0]]), [step])[0, 2] == 5.0 + on
        assert faults.apply_to_commands(np.array([[20.0, 20.0, 20.0]]), [step])[0, 0] == 20.0 + on
    assert faults.drain_transitions() == [
        FaultTransition(Transition.BEGAN, "x", 0, 1),
        FaultTransition(Transition.ENDED, "x", 0, 3),
    ]


# Windows


def on_at(when: dict[str, Any], steps: int = 8 * 24 * HOUR, **arguments: Any) -> set[int]:
    faults = point_faults({"kind": "stuck", "value": 1.0, "points": "power", "when": when}, **arguments)
    return {k for k in range(steps) if faults.apply_to_sensors(np.zeros((1, 3)), [k])[0, 2]}


def moments(on: set[int], begin: datetime = BEGIN) -> list[datetime]:
    return [begin + timedelta(seconds=STEP_S * k) for k in sorted(on)]


@pytest.mark.parametrize(
    ("when", "first", "end"),
    [
        ({"from_s": 1800, "to_s": 3600}, 2, 4),
        ({"from_s": 1700, "to_s": 3601}, 2, 5),  # samples at 1800, 2700 and 3600 s
        ({"from_time": "2017-07-03T06:00", "to_time": "07-03T07:00:00"}, 24, 28),
        ({"from_time": "07-04", "to_time": "07-05"}, 96, 192),
        ({"from_time": "2016-01-01", "to_step": 3}, 0, 3),
        ({"from_step": 5, "to_s": 9000}, 5, 10),  # all that is said holds
    ],
)
def test_point_faults__windows_have_their_begin_and_not_their_end(when: dict[str, Any], first: int, end: int) -> None:
    assert on_at(when) == set(range(first, end))


def test_point_faults__no_window_is_always() -> None:
    assert on_at({}, 50) == set(range(50))


@pytest.mark.parametrize("begin", [BEGIN, datetime(2017, 7, 7, 13, 45)])
@pytest.mark.parametrize(
    ("hours", "weekdays"),
    [((9, 17), None), ((22, 6), None), ((8.25, 8.5), ("tue",)), (None, ("sat", "sun")), ((23, 24), ("mon", "fri"))],
)
def test_point_faults__clock_is_that_of_the_simulated_time(begin: datetime, hours: Any, weekdays: Any) -> None:
    when = {name: value for name, value in (("hours", hours), ("weekdays", weekdays)) if value}
    steps_on = on_at(when, begin=begin)

    def expected(moment: datetime) -> bool:
        hour = moment.hour + moment.minute / 60
        first, end = hours or (0, 24)
        in_hours = first <= hour < end if first < end else hour >= first or hour < end
        return in_hours and WEEKDAYS[moment.weekday()] in (weekdays or WEEKDAYS)

    assert moments(steps_on, begin) == [m for m in moments(set(range(8 * 24 * HOUR)), begin) if expected(m)]
    assert steps_on


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(("probability", "lasts"), [(0.05, 1), (0.02, 6), (0.5, 3), (1, 2)])
def test_point_faults__bursts_take_the_share_of_the_time_that_theory_states(probability: float, lasts: int) -> None:
    # a renewal process: n steps on, then on average (1 - p) / p steps until it begins again
    steps = 40_000
    on = on_at({"probability": probability, "lasts_steps": lasts}, steps)
    expected = lasts * probability / (lasts * probability + 1 - probability)
    # of about steps·share/n bursts; lengths of the gaps have a standard deviation of about their mean
    deviation = expected * (1 - expected) / math.sqrt(steps * expected / lasts)
    assert len(on) / steps == pytest.approx(expected, abs=4 * deviation + 1e-9)
    if lasts > 1 and probability < 1:
        begins = sorted(k for k in on if k - 1 not in on)
        runs = [next(n for n in range(1, steps) if k + n not in on) for k in begins[:-1]]
        assert {run % lasts for run in runs} == {0}


def test_point_faults__burst_ends_with_its_window() -> None:
    on = on_at({"probability": 1, "lasts_steps": 1000, "hours": [1, 2], "weekdays": ["mon"]})
    assert on == set(range(4, 8)) | set(range(4 + 672, 8 + 672))


@pytest.mark.slow
def test_point_faults__burst_that_its_window_ended_does_not_go_on_in_the_next() -> None:
    # one sample a day; a burst of 100 steps would reach the next day's
    days = 400
    on = on_at({"probability": 0.3, "lasts_steps": 100, "hours": [1, 1.25]}, days * 24 * HOUR)
    assert len(on) / days == pytest.approx(0.3, abs=4 * math.sqrt(0.3 * 0.7 / days))


def test_transitions__are_reported_for_each_slot() -> None:
    faults = point_faults(room("bias", name="b", offset=1, when=SOME), slots=2)
    values = np.zeros((2, 3))
    for steps in ([0, 1], [0, 2], [1, 3]):
        faults.apply_to_sensors(values, steps)
    assert faults.drain_transitions() == [
        FaultTransition(Transition.BEGAN, "b", 1, 1),
        FaultTransition(Transition.BEGAN, "b", 0, 1),
        FaultTransition(Transition.ENDED, "b", 1, 3),
    ]
    assert faults.on(0) == ("b",)
    assert faults.on(1) == ()
    faults.reset([0], [None])
    assert faults.drain_transitions() == [FaultTransition(Transition.ENDED, "b", 0, 1)]


# Chance


def noise_of(faults: PointFaults, steps: int, slots: int = 1) -> NDArray[np.float64]:
    return np.array([faults.apply_to_sensors(np.zeros((slots, 3)), [k] * slots) for k in range(steps)])


def test_point_faults__noise_has_its_mean_variance_and_shape() -> None:
    noise = noise_of(point_faults({"kind": "noise", "points": "*", "sigma": 0.5}), 20_000)[:, 0]
    n = noise.size
    assert noise.mean() == pytest.approx(0.0, abs=4 * 0.5 / math.sqrt(n))
    assert noise.var() == pytest.approx(0.25, abs=4 * 0.25 * math.sqrt(2 / n))
    assert np.mean(np.abs(noise) < 0.5) == pytest.approx(math.erf(1 / math.sqrt(2)), abs=0.01)
    # neither points nor steps depend on each other: correlations are within 4 / sqrt(n)
    assert np.abs(np.corrcoef(noise.T) - np.eye(3)).max() < 4 / math.sqrt(len(noise))
    assert abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 4 / math.sqrt(len(noise))


@pytest.mark.parametrize("two_sided", [True, False])
def test_spikes__are_as_frequent_as_configured(two_sided: bool) -> None:
    fault = {"kind": "spike", "points": "*", "amplitude": 5.0, "probability": 0.1, "two_sided": two_sided}
    noise = noise_of(point_faults(fault), 10_000)
    up, down = np.mean(noise == 5.0), np.mean(noise == -5.0)
    bound = 4 * math.sqrt(0.1 * 0.9 / noise.size)
    assert up + down == pytest.approx(0.1, abs=bound)
    assert down == pytest.approx(0.05 if two_sided else 0.0, abs=bound if two_sided else 0.0)
    assert np.mean(noise == 0.0) == pytest.approx(0.9, abs=bound)


NOISE = room("noise", name="n", sigma=1.0)


@pytest.mark.parametrize("name", ["", "n"])
def test_point_faults__another_fault_does_not_change_the_noise(name: str) -> None:
    noise = room("noise", name=name, sigma=1.0)
    other = {"kind": "noise", "name": "other", "points": ["power", "hall_temperature"], "sigma": 2.0}
    burst = {"kind": "drop", "points": "power", "when": {"probability": 0.3}}
    alone = noise_of(point_faults(noise), 200)[:, 0, 0]
    assert np.array_equal(alone, noise_of(point_faults(noise, other, burst), 200)[:, 0, 0])
    if name:  # a named one may stand anywhere
        assert np.array_equal(alone, noise_of(point_faults(other, burst, noise), 200)[:, 0, 0])


def test_point_faults__two_faults_alike_have_noise_of_their_own() -> None:
    noise = noise_of(point_faults(NOISE, {**NOISE, "name": "m", "points": "power"}), 5000)[:, 0]
    assert abs(np.corrcoef(noise[:, 0], noise[:, 2])[0, 1]) < 4 / math.sqrt(5000)


def test_point_faults__points_and_actuators_of_one_fault_have_noise_of_their_own() -> None:
    faults = point_faults({**NOISE, "actuators": "damper"})
    sensed = noise_of(faults, 2000)[:, 0, 0]
    commanded = np.array([faults.apply_to_commands(np.array([[20.0, 20.0, 0.0]]), [k])[0, 2] for k in range(2000)])
    assert commanded.std() == pytest.approx(1.0, rel=0.1)
    assert abs(np.corrcoef(sensed, commanded)[0, 1]) < 4 / math.sqrt(2000)


def test_point_faults__where_no_spike_is_nothing_is_touched() -> None:
    faults = point_faults({"kind": "spike", "points": "*", "amplitude": 5.0, "probability": 0.5})
    raw = np.full((1, 3), -0.0)
    values = {faults.apply_to_sensors(raw, [k])[0, c].tobytes() for k in range(100) for c in range(3)}
    assert values == {np.float64(v).tobytes() for v in (-0.0, 5.0, -5.0)}


def test_point_faults__window_does_not_change_the_noise_in_it() -> None:
    late = noise_of(point_faults({**NOISE, "when": {"from_step": 100}}), 200)[:, 0, 0]
    assert not late[:100].any()
    assert np.array_equal(late[100:], noise_of(point_faults(NOISE), 200)[100:, 0, 0])


def test_point_faults__seeds_and_episodes_give_their_own_sequences() -> None:
    def episodes(seed: int, resets: list[int | None], steps: int) -> list[bytes]:
        faults, noises = point_faults(NOISE, seed=seed), []
        for reset in resets:
            faults.reset(None, [reset])
            noises.append(noise_of(faults, steps).tobytes())
        return noises

    for steps in (1, 30, 100):
        one = episodes(1, [5, None, None, 5, None, 6], steps)
        assert one[:2] == one[3:5]
        assert len(set(one)) == 4
        assert episodes(1, [5, None], steps) == one[:2]
        assert not set(episodes(2, [5, None], steps)) & set(one)


def test_point_faults__seed_gives_the_same_in_any_slot_and_without_one_slots_differ() -> None:
    faults = point_faults(NOISE, slots=3)
    unseeded = noise_of(faults, 70, 3)
    assert len({unseeded[:, slot].tobytes() for slot in range(3)}) == 3
    faults.reset([0, 2], [8, 8])
    seeded = noise_of(faults, 70, 3)
    assert np.array_equal(seeded[:, 0], seeded[:, 2])
    assert np.array_equal(seeded[:, 1], unseeded[:, 1])


def test_point_faults__slot_that_does_not_advance_states_the_same_again() -> None:
    everything = [NOISE, room("delay", steps=1), {"kind": "freeze", "points": "power", "when": {"probability": 0.5}}]
    still, moving = point_faults(*everything, slots=2), point_faults(*everything, slots=2)
    for steps, value in (([0, 0], 1.0), ([0, 1], 2.0), ([0, 2], 3.0), ([1, 3], 4.0)):
        values = np.array([[1.0 if steps[0] == 0 else 4.0] * 3, [value] * 3])
        disturbed = still.apply_to_sensors(values, steps)
        if steps[0] != 0 or steps[1] == 0:
            expected = moving.apply_to_sensors(values, [steps[0], steps[0]])
        assert np.array_equal(disturbed[0], expected[0], equal_nan=True)


# Everything at once, over random plans

numbers = st.floats(-50, 50)
whens = st.fixed_dictionaries(
    {},
    optional={
        "from_step": st.integers(0, 10),
        "hours": st.sampled_from([(0, 24), (1, 3), (23, 2)]),
        "probability": st.sampled_from([0.1, 0.5, 1.0]),
    },
)
parameters = {
    "bias": {"offset": numbers},
    "gain": {"factor": numbers},
    "drift": {"rate_per_h": numbers},
    "noise": {"sigma": st.floats(0.1, 5)},
    "freeze": {},
    "stuck": {"value": st.floats(10, 30)},
    "drop": {},
    "delay": {"steps": st.integers(1, 5)},
    "quantize": {"resolution": st.sampled_from([0.1, 0.5, 2.0])},
    "spike": {"amplitude": numbers, "probability": st.sampled_from([0.1, 1.0])},
    "clip": {"low": st.floats(-5, 15), "high": st.floats(16, 25)},
}
faults_of = st.one_of(
    *(
        st.fixed_dictionaries(
            {
                "kind": st.just(kind),
                "when": whens,
                "points": st.sets(st.sampled_from(NAMES), min_size=1).map(sorted),
                "actuators": st.sets(st.sampled_from([a.name for a in ACTUATORS])).map(sorted),
                **parameter_values,
            }
        )
        for kind, parameter_values in parameters.items()
    )
)
plans = st.lists(faults_of, max_size=5)
SLOTS, STEPS = 2, 14


def inputs(seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(STEPS, SLOTS, 3)) * rng.choice([0.0, -0.0, 1.0, 1e-310, 1e12], (STEPS, SLOTS, 3))
    return values, np.where(rng.random((STEPS, SLOTS, 3)) < 0.2, NAN, rng.uniform(10, 30, (STEPS, SLOTS, 3)))


def run(faults: PointFaults, values: Any, wanted: Any, first: int = 0) -> list[tuple[bytes, bytes, Any]]:
    return [
        (
            faults.apply_to_sensors(values[k], [k] * SLOTS).tobytes(),
            faults.apply_to_commands(wanted[k], [k] * SLOTS).tobytes(),
            faults.drain_transitions(),
        )
        for k in range(first, len(values))
    ]


def test_point_faults__random_plans_have_all_kinds_of_points() -> None:
    assert set(parameters) | {"latency", "jitter", "loss", "duplicate", "reorder"} == set(KINDS)


@pytest.mark.slow
@given(plans, st.integers(0, 1000))
def test_point_faults__what_no_fault_names_is_untouched_to_the_bit(plan: list[dict[str, Any]], seed: int) -> None:
    faults = point_faults(*plan, slots=SLOTS)
    values, wanted = inputs(seed)
    kept = values.tobytes(), wanted.tobytes()
    for k in range(STEPS):
        steps = [k, k]
        for now, names, side, call in (
            (values[k], NAMES, "points", faults.apply_to_sensors),
            (wanted[k], [a.name for a in ACTUATORS], "actuators", faults.apply_to_commands),
        ):
            out = call(now, steps)
            for slot in range(SLOTS):
                on = faults.on(slot)
                labels = faults.plan.names
                hit = {n for label, f in zip(labels, plan, strict=True) if label in on for n in f[side]}
                calm = [column for column, name in enumerate(names) if name not in hit]
                assert out[slot, calm].tobytes() == now[slot, calm].tobytes()
            if not any(
                f[side] and label in faults.on(s) for s in (0, 1) for label, f in zip(labels, plan, strict=True)
            ):
                assert out is now
            if side == "actuators":
                limited = out[:, :2]
                assert (np.isnan(limited) | ((limited >= 10.0) & (limited <= 30.0))).all()
    assert (values.tobytes(), wanted.tobytes()) == kept, "the true values stay"


@pytest.mark.slow
@given(plans, st.integers(0, STEPS - 1), st.integers(0, 1000))
def test_point_faults__snapshot_goes_on_as_if_nothing_had_been(plan: list[dict[str, Any]], cut: int, seed: int) -> None:
    values, wanted = inputs(seed)
    whole = point_faults(*plan, slots=SLOTS)
    whole.reset(None, [seed, None])
    run(whole, values[:cut], wanted[:cut])
    state = pickle.loads(pickle.dumps(whole.state()))
    went_on = run(whole, values, wanted, cut)
    other = point_faults(*plan, slots=SLOTS)
    other.restore(state)
    assert run(other, values, wanted, cut) == went_on
    whole.restore(state)  # the same node goes back
    whole.drain_transitions()
    assert run(whole, values, wanted, cut) == went_on


def test_point_faults__branch_of_one_slot_goes_on_in_several() -> None:
    plan = [NOISE, room("freeze", when={"probability": 0.3, "lasts_steps": 3}), room("delay", steps=2)]
    parent, branch = point_faults(*plan, slots=2), point_faults(*plan, slots=3)
    values = np.random.default_rng(3).normal(size=(40, 2, 3))
    for k in range(20):
        parent.apply_to_sensors(values[k], [k, k])
    branch.restore([parent.state()[1]] * 3)
    for k in range(20, 40):
        expected = parent.apply_to_sensors(values[k], [k, k])[1]
        disturbed = branch.apply_to_sensors(np.repeat(values[k, 1:2], 3, axis=0), [k] * 3)
        assert [row.tobytes() for row in disturbed] == [expected.tobytes()] * 3


def test_point_faults__episode_remembers_nothing_of_the_former() -> None:
    faults = point_faults(room("delay", steps=2), cooling("drop", when={"from_step": 1}))
    assert commands(faults, [24.0, 25.0]) == [24.0, 24.0]
    series(faults, [1.0, 2.0, 3.0])
    faults.reset()
    assert np.array_equal(series(faults, [7.0, 8.0, 9.0]), [NAN, NAN, 7.0], equal_nan=True)
    faults.reset()
    assert commands(faults, [NAN, 25.0])[1:] == pytest.approx([NAN], nan_ok=True)


# Files and requests


def test_point_faults__example_is_a_plan_and_the_page_shows_it() -> None:
    path = ROOT / "examples/faults.yaml"
    plan = read_plan(path)
    assert len(plan.faults) == 9
    page = (ROOT / "docs/faults.md").read_text(encoding="utf-8")
    shown = page.split("```yaml\n")[1].split("```")[0]
    assert FaultPlan.model_validate(yaml12.parse(shown, "the page")) == plan
    assert all(f"`{kind}`" in page for kind in KINDS)


def test_point_faults__plan_travels() -> None:
    plan = read_plan(ROOT / "examples/faults.yaml")
    assert codec.decode(FaultPlan, codec.encode(plan)) == plan


def test_point_faults__plan_without_faults_is_a_node_in_order() -> None:
    faults = point_faults()
    values, wanted = inputs(0)
    assert faults.apply_to_sensors(values, [0]) is values
    assert faults.apply_to_commands(wanted, [0]) is wanted
    assert not faults.disturbs_points
    assert not faults.disturbs_actuators


def test_point_faults__wildcard_leaves_unobserved_points_alone_and_draws_the_same_for_the_others() -> None:
    noise = {"kind": "noise", "points": "*_temperature", "sigma": 1.0}
    plain, monitored = (
        point_faults(noise),
        point_faults(noise, points=(*NAMES, "attic_temperature"), unobserved={"attic_temperature"}),
    )
    for faults in (plain, monitored):
        faults.reset()
    for step in range(5):
        expected = plain.apply_to_sensors(np.array([[20.0, 21.0, 5.0]]), [step])
        values = monitored.apply_to_sensors(np.array([[20.0, 21.0, 5.0, 15.0]]), [step])
        assert values[0, :3].tobytes() == expected[0].tobytes()
        assert values[0, 3] == 15.0
    named = point_faults(
        {**noise, "points": "attic_temperature"}, points=("attic_temperature",), unobserved={"attic_temperature"}
    )
    named.reset()
    assert named.apply_to_sensors(np.array([[15.0]]), [0]) != 15.0
    with pytest.raises(InvalidConfig, match=r"no sensor or meter 'attic\*'"):
        point_faults({**noise, "points": "attic*"}, points=("attic_temperature",), unobserved={"attic_temperature"})
