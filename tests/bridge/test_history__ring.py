"""The history of a node: a ring of samples gives what a list of all samples gives, as far back as it reaches."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.bridge.node import history as module
from zenostat.bridge.node.history import History
from zenostat.bridge.node.plant import PlantDescription, RunPeriod
from zenostat.topics.errors import RequestRejected, UnknownName
from zenostat.topics.messages import Actuator, HistoryQuery, HistorySeries, Meter, Sensor, Versions

NAMES = ("air", "power", "setpoint")


def plant(steps: int = 100, *, actuators: int = 1) -> PlantDescription:
    return PlantDescription(
        "x",
        RunPeriod(datetime(2017, 7, 3), 900.0, steps),
        (Sensor(name="air", unit="degC"),),
        (Meter(name="power", unit="J"),),
        (Actuator(name="setpoint", unit="K"),)[:actuators],
        Versions(zenostat="1"),
    )


def filled(samples: int, *, room: int = 1000, episode: int = 0, first: int = 0) -> History:
    """A history of one slot whose values at step k are k, -k and 1000 + k."""
    history = History(plant(), 1, 40 * room)
    for step in range(first, first + samples):
        values = np.array([step, -step], float).tobytes()
        history.add(values, np.array([1000.0 + step]).tobytes(), [episode], [step])
    return history


def table(reply: HistorySeries, field: str = "values") -> np.ndarray:
    return np.frombuffer(getattr(reply, field)).reshape(-1, len(reply.points))


def test_values__are_those_of_the_named_points_in_their_order() -> None:
    reply = filled(3).answer(HistoryQuery(points=["setpoint", "air"]))
    assert table(reply).tolist() == [[1000.0, 0.0], [1001.0, 1.0], [1002.0, 2.0]]
    assert (reply.units, reply.first_step, reply.stride, reply.remaining) == (["K", "degC"], 0, 1, 0)


def test_values__a_name_of_a_sensor_and_an_actuator_is_the_sensors() -> None:
    history = History(replace(plant(), actuators=(Actuator(name="air", unit="K"),)), 1, 4000)
    history.add(np.array([21.0, 0.0]).tobytes(), np.array([15.0]).tobytes(), [0], [0])
    reply = history.answer(HistoryQuery(points=["air", "actuator/air"]))
    assert (table(reply).tolist(), reply.units) == ([[21.0, 15.0]], ["degC", "K"])


def test_history__plant_without_actuators_has_a_history() -> None:
    history = History(plant(actuators=0), 1, 4000)
    history.add(np.array([1.0, 2.0]).tobytes(), b"", [0], [0])
    assert table(history.answer(HistoryQuery(points=["power"]))).tolist() == [[2.0]]


def test_memory__is_that_of_the_samples_that_fit() -> None:
    row = 8 * 3 + 16  # two values, an effective value; number of the episode, and step
    history = History(plant(), 1, 10 * row + 39)
    assert (history.samples, history.size_bytes) == (10, 10 * row)
    assert History(plant(steps=5), 1, 1 << 20).samples == 6  # an episode has no more
    assert History(plant(), 1, row - 1).samples == 0


def test_oldest_samples__are_replaced() -> None:
    reply = filled(25, room=10).answer(HistoryQuery(points=["air"]))
    assert table(reply)[:, 0].tolist() == [*range(15, 25)]
    assert (reply.first_step, reply.oldest_step, reply.latest_step) == (15, 15, 24)


def test_a_new_episode__hides_the_previous_one() -> None:
    history = filled(10)
    history.add(np.array([7.0, 8.0]).tobytes(), np.array([9.0]).tobytes(), [1], [0])
    reply = history.answer(HistoryQuery(points=["air"]))
    assert (reply.episode, table(reply).tolist(), reply.oldest_step) == (1, [[7.0]], 0)


def test_an_episode_that_continues_from_a_snapshot__begins_at_its_step() -> None:
    assert filled(3, first=40).answer(HistoryQuery(points=["air"])).first_step == 40


def test_slots__have_their_own_steps_and_episodes() -> None:
    history = History(plant(), 2, 10_000)
    marks = [([0, 0], [0, 0]), ([0, 0], [1, 1]), ([0, 0], [1, 2]), ([1, 0], [0, 2]), ([1, 0], [1, 3])]
    for number, (episode, step) in enumerate(marks):
        values = np.array([[10.0 + number, 0], [20.0 + number, 0]])
        history.add(values.tobytes(), np.zeros((2, 1)).tobytes(), episode, step)
    first, second = (history.answer(HistoryQuery(points=["air"], slot=slot)) for slot in (0, 1))
    assert (first.episode, table(first)[:, 0].tolist()) == (1, [13.0, 14.0])
    assert (second.episode, table(second)[:, 0].tolist()) == (0, [20.0, 21.0, 22.0, 24.0])  # each step once


@given(
    count=st.integers(1, 60),
    room=st.integers(1, 80),
    bounds=st.tuples(st.none() | st.integers(0, 70), st.none() | st.integers(0, 70)),
    limit=st.none() | st.integers(2, 70),
    extremes=st.booleans(),
)
def test_any_request__agrees_with_a_list_of_all_samples(
    count: int, room: int, bounds: tuple[int | None, int | None], limit: int | None, extremes: bool
) -> None:
    low, high = bounds
    kept = list(range(count))[-room:]
    expected = [step for step in kept if (low is None or step >= low) and (high is None or step <= high)]
    query = HistoryQuery(points=["power", "air"], from_step=low, to_step=high, max_samples=limit, extremes=extremes)
    history = filled(count, room=room)
    if not expected:
        with pytest.raises(RequestRejected, match=f"steps {kept[0]} to {kept[-1]}"):
            history.answer(query)
        return
    reply = history.answer(query)
    steps = [reply.first_step + reply.stride * k for k in range(len(table(reply)))]
    assert table(reply).tolist() == [[-step, step] for step in steps]
    assert steps[-1] == expected[-1]
    assert limit is None or len(steps) <= limit
    if limit is None or len(expected) <= limit:
        assert steps == expected
    assert steps[0] - expected[0] < reply.stride  # a row stands for itself and at most `stride - 1` before it
    if extremes:
        begins = [expected[0], *(step + 1 for step in steps[:-1])]
        assert table(reply, "lows").tolist() == [[-s, b] for b, s in zip(begins, steps, strict=True)]
        assert table(reply, "highs").tolist() == [[-b, s] for b, s in zip(begins, steps, strict=True)]


def test_a_peak_between_the_samples_that_are_sent__is_in_the_extremes() -> None:
    history = History(plant(), 1, 40_000)
    for step in range(10):
        air = np.nan if step == 2 else 99.0 if step == 6 else 20.0
        history.add(np.array([air, 0.0]).tobytes(), np.zeros(1).tobytes(), [0], [step])
    reply = history.answer(HistoryQuery(points=["air"], max_samples=2, extremes=True))
    assert table(reply).tolist() == [[20.0], [20.0]]
    assert table(reply, "highs").tolist() == [[20.0], [99.0]]
    assert table(reply, "lows").tolist() == [[20.0], [20.0]]  # NaN is left aside


def test_a_large_reply__is_divided_or_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_REPLY_BYTES", 8 * 2 * 10)
    history = filled(25)
    reply = history.answer(HistoryQuery(points=["air", "power"]))
    assert (len(table(reply)), reply.remaining) == (10, 15)
    thinned = history.answer(HistoryQuery(points=["air", "power"], max_samples=20))
    assert (len(table(thinned)), thinned.stride, thinned.remaining) == (9, 3, 0)


def test_history__unknown_point_is_named_with_a_near_one() -> None:
    with pytest.raises(UnknownName, match="no point 'setpont'; did you mean 'setpoint'"):
        filled(1).answer(HistoryQuery(points=["air", "setpont"]))
