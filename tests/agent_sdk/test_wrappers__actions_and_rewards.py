"""Wrappers of actions, rewards and contexts."""

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.fakes import FakeBuilding
from support.wrapped_fakes import MIDDLE, episode, fake

from zenostat import wrappers as w
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.agent_sdk.wrappers.incremental import rounded
from zenostat.topics.errors import EpisodeChanged, InvalidAction, InvalidConfig

HELD = {"zone_1_heating_setpoint": 18.0, "zone_1_cooling_setpoint": 26.0}

# Actions


def test_wrappers__incremental_action_by_hand() -> None:
    env = w.IncrementalAction(fake(), {"cool": [1.0, 0.25]}, {"cool": 29.0})
    assert (env.action_space.low.tolist(), env.action_space.high.tolist()) == ([15.0, -1.0], [22.5, 1.0])
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    for _ in range(2):
        env.reset(seed=1)
        for increment in (0.3, 0.9, 1.0, -0.1, -0.2):
            env.step(np.array([18.0, increment], np.float32))
        assert bare.commands == [[18.0, value] for value in (29.25, 30.0, 30.0, 30.0, 29.75)]
    assert env.get_state() == {"slots": [{"values": [29.75]}]}


def test_incremental_action__vector_step_that_is_refused_moves_nothing() -> None:
    """Slot 0 has reached its end and slot 1, which was reset at noon, goes on."""
    building = FakeVectorEnv(2, autoreset_mode="Disabled", zones=1, begin="07-03", end="07-03", steps_per_hour=1)
    env = w.IncrementalAction(building, dict.fromkeys(building.action_names, 1.0), HELD)
    none, half = (np.full((2, 2), increment, np.float32) for increment in (0.0, 0.5))
    env.reset(seed=1)
    for hour in range(24):
        if hour == 12:
            env.reset(options={"reset_mask": np.array([False, True])})
        env.step(none)
    for _ in range(3):
        with pytest.raises(EpisodeChanged, match="the episode is over in slots 0"):
            env.step(half)
    env.reset(options={"reset_mask": np.array([True, False])})
    for moved in (0.0, 0.5):
        info = env.step(none + np.float32(moved))[4]
        assert info["action"].tolist() == [[value + moved for value in HELD.values()]] * 2


def test_wrappers__rounding_is_half_to_even_and_none_without_a_step() -> None:
    most, steps = np.array([1.0, 1.0]), np.array([0.25, 0.0])
    assert rounded(np.array([[0.125, 0.125], [0.375, -0.3]]), steps, most).tolist() == [[0.0, 0.125], [0.5, -0.3]]


def test_wrappers__rounding_does_not_exceed_the_largest_increment() -> None:
    # 0.6 is 1.5 steps of 0.4: 2 steps would be 0.8
    steps = np.array([0.4, 0.3])
    increments = rounded(np.array([[0.6, 0.6], [-0.6, -0.6]]), steps, np.array([0.6, 0.6]))
    assert increments.tolist() == [[0.4, 0.6], [-0.4, -0.6]]


def test_wrappers__seed_may_be_a_numpy_integer() -> None:
    one, other = (w.PreviousObservation(FakeVectorEnv(2), ["outdoor_temperature"]) for _ in range(2))
    np.testing.assert_array_equal(one.reset(seed=np.int64(3))[0], other.reset(seed=3)[0])


def test_wrappers__what_two_reductions_dropped_is_in_the_info_together() -> None:
    def reduced(env: Any) -> Any:
        names = env.unwrapped.manifest.names
        return w.ReducedObservation(w.ReducedObservation(env, names[:3]), names[:1])

    one, many = reduced(FakeEnv()), reduced(FakeVectorEnv(1))
    dropped, rows = one.reset(seed=1)[1]["dropped"], many.reset(seed=1)[1]["dropped"]
    assert set(dropped) == {*one.unwrapped.manifest.names[1:]}
    assert dropped == {name: rows[name][0] for name in dropped}


@pytest.mark.parametrize("action", [[18.0, 1.5], [14.0, 0.0], [18.0, np.nan], [0.0]])
def test_wrappers__increment_out_of_the_space_changes_nothing(action: list[float]) -> None:
    env = w.IncrementalAction(fake(), {"cool": 1.0}, {"cool": 29.0})
    env.reset()
    with pytest.raises(InvalidAction, match=r"IncrementalAction: action .* is not in Box"):
        env.step(np.array(action, np.float32))
    assert env.get_state() == {"slots": [{"values": [29.0]}]}
    assert env.unwrapped.commands == []  # type: ignore[attr-defined]


def test_wrappers__several_step_sizes_are_sinergyms_default_of_seventeen_choices() -> None:
    steps = [0.5, 1.0, 1.5, 2.0]
    env = w.DiscreteIncrementalAction(fake(), {"heat": steps, "cool": steps}, {"heat": 19.0, "cool": 26.0})
    assert env.action_space == gym.spaces.Discrete(17)
    moves = [0.0, *steps, *(-step for step in steps)]
    for number in range(17):
        env.reset(seed=0)
        effective = env.step(number)[4]["effective"]
        heat = moves[number] if number < 9 else 0.0
        cool = moves[number - 8] if number >= 9 else 0.0
        assert list(effective)[:2] == pytest.approx([19.0 + heat, 26.0 + cool])


def test_wrappers__discrete_incremental_action_by_hand() -> None:
    env = w.DiscreteIncrementalAction(fake(), {"cool": 0.5, "heat": 2.0}, {"heat": 20.0, "cool": 29.5})
    assert env.action_space == gym.spaces.Discrete(5)
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    for _ in range(2):
        env.reset(seed=1)
        for number in (1, 1, 2, 3, 3, 4, 0):
            env.step(number)
        heats, cools = [20.0, 20.0, 20.0, 22.0, 22.5, 20.5, 20.5], [30.0, 30.0, 29.5, 29.5, 29.5, 29.5, 29.5]
        assert bare.commands == [list(pair) for pair in zip(heats, cools, strict=True)]
    with pytest.raises(InvalidAction, match=r"action 5 is not in Discrete\(5\)"):
        env.step(5)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (lambda env: w.IncrementalAction(env, {"cool": 1}, {"heat": 20}), "have to name the same actions"),
        (lambda env: w.IncrementalAction(env, {"coo": 1}, {"coo": 20}), "no action 'coo'; did you mean 'cool'"),
        (lambda env: w.IncrementalAction(env, {"cool": 1}, {"cool": 20}),
            "cool starts at 20, outside its bounds 22.5 to 30"),
        (lambda env: w.IncrementalAction(env, ["cool"], {}), r"increments: {action: largest increment} expected"),
        (lambda env: w.IncrementalAction(env, {"cool": 1}, {"cool": None}), "initial: cool: a number expected"),
        (lambda env: w.DiscreteIncrementalAction(env, {"cool": 1}, ["cool"]), "initial: {action: value} expected"),
        (lambda env: w.DiscreteIncrementalAction(env, ["cool"], {}), "steps: {action: step or steps} expected"),
        (lambda env: w.IncrementalAction(env, {"cool": [1, 2]}, {"cool": 25}), "its step not above the increment"),
        (lambda env: w.DiscreteIncrementalAction(env, {"cool": 1}, {"cool": 25}),
            "initial also needs a value for heat"),
        (lambda env: w.DiscreteIncrementalAction(env, {"cool": 0}, {"cool": 25, "heat": 20}),
            "a step above 0, or several different ones"),
        (lambda env: w.DiscreteIncrementalAction(env, {"cool": [1, 1]}, {"cool": 25, "heat": 20}),
            "a step above 0, or several different ones"),
    ],
)  # fmt: skip
def test_wrappers__increments_that_cannot_be(wrong: Callable[[Any], Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        wrong(fake())


def test_discrete_incremental_action__choice_may_be_an_array_of_one() -> None:
    """A `Discrete` action of an environment may be one, too: stable-baselines3 predicts an array."""
    env = w.DiscreteIncrementalAction(fake(), {"cool": 1.0}, {"heat": 20.0, "cool": 25.0})
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    env.reset(seed=0)
    for choice in (1, np.int64(1), np.array(1), np.array([1])):
        env.step(choice)
    assert bare.commands == [[20.0, cooling] for cooling in (26.0, 27.0, 28.0, 29.0)]
    with pytest.raises(InvalidAction):
        env.step(np.array([1, 1]))


# Reward, context


def test_reward_vector__has_the_requested_order() -> None:
    env = w.RewardVector(fake(), ["comfort", "energy"])
    env.reset(seed=1)
    _, reward, _, _, _ = env.step(MIDDLE)
    assert reward.dtype == np.float64
    assert reward.tolist() == [-0.5, -4.0]
    assert env.reward_space.shape == (env.reward_dim,) == (2,)
    assert env.reward_space.contains(reward)
    wrong = w.RewardVector(fake(), ["comfor"])
    wrong.reset()
    with pytest.raises(InvalidConfig, match="no reward term 'comfor'; did you mean 'comfort'"):
        wrong.step(MIDDLE)


@pytest.mark.parametrize(
    "schedule",
    [
        {"07:00": {"occupants": 1.0}, "18:30": {"occupants": 0.25}},
        {"06-01 00:00": {"occupants": 0.25}, "07-03 07:00": {"occupants": 1.0}, "07-03 18:30": {"occupants": 0.25}},
        lambda time, random: {
            "occupants": 1.0 if timedelta(hours=7) <= time - datetime(2017, 7, 3) < timedelta(hours=18.5) else 0.25
        },
    ],
)
def test_wrappers__context_follows_its_schedule(schedule: Any) -> None:
    env = w.ChangingContext(fake(steps_per_hour=2), schedule)
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    for _ in range(2):
        steps = episode(env, lambda: MIDDLE)
        assert bare.contexts == [(0, {"occupants": 0.25}), (14, {"occupants": 1.0}), (37, {"occupants": 0.25})]
        effective = [info["effective"][2] for *_, info in steps[1:]]
        assert effective == [0.25] * 14 + [1.0] * 23 + [0.25] * 11


def test_changing_context__table_with_days_sets_nothing_before_its_first_day() -> None:
    env = w.ChangingContext(fake(), {"07-03 07:00": {"occupants": 1.0}, "07-03 18:00": {"occupants": 0.25}})
    bare: FakeBuilding = env.unwrapped  # type: ignore[assignment]
    episode(env, lambda: MIDDLE)
    assert bare.contexts == [(7, {"occupants": 1.0}), (18, {"occupants": 0.25})]


def test_random_context__depends_on_the_seed() -> None:
    env = w.ChangingContext(fake(), lambda time, random: {"occupants": float(random.random())})
    seen = [[info["effective"][2] for *_, info in episode(env, lambda: MIDDLE, seed)[1:]] for seed in (1, 1, 2)]
    assert seen[0] == seen[1] != seen[2]
    assert len(set(seen[0])) == 24


@pytest.mark.parametrize("slots", [0, 2])
def test_changing_context__action_that_is_refused_leaves_no_trace(slots: int) -> None:
    calls: list[datetime] = []

    def draw(time: datetime, random: np.random.Generator) -> dict[str, float | None]:
        calls.append(time)
        return {"equipment": float(random.random())}

    form: dict[str, Any] = {"zones": 1, "equipment_control": True, "actions": {"cooling": ["zone_1_cooling_setpoint"]}}
    seen = []
    for is_refused in (False, True):
        env: Any = w.ChangingContext(FakeVectorEnv(slots, **form) if slots else FakeEnv(**form), draw)
        action = np.full(env.action_space.shape, 26.0, np.float32)
        with pytest.raises(EpisodeChanged, match=r"call reset\(\) before step\(\)"):
            env.step(action)
        env.reset(seed=4)
        seen.append([])
        for step in range(4):
            state = env.get_state()
            for _ in range(2 * is_refused):
                with pytest.raises(InvalidAction):
                    env.step(action + 99.0)
            if step % 2:  # the state that a refused action leaves continues as well
                state = env.get_state()
            env.set_state(state)
            seen[-1].append(env.step(action)[4]["effective"].tolist())
    assert seen[0] == seen[1]
    assert len({str(values) for values in seen[0]}) == 4


@pytest.mark.parametrize("values", [3, None, ["equipment"]])
def test_context__is_values_by_actuator(values: Any) -> None:
    env = FakeEnv(equipment_control=True, actions={"cooling": ["zone_1_cooling_setpoint"]}, zones=1)
    env.reset()
    with pytest.raises(InvalidAction, match="values by actuator expected"):
        env.set_context(values)


def test_context__before_the_reset_that_would_clear_it_is_refused() -> None:
    form: dict[str, Any] = {"zones": 1, "equipment_control": True, "actions": {"cooling": ["zone_1_cooling_setpoint"]}}
    for env in (FakeEnv(**form), FakeVectorEnv(2, **form)):
        with pytest.raises(EpisodeChanged, match=r"call reset\(\) before set_context\(\)"):
            env.set_context({"equipment": 0.5})


def test_wrappers__context_that_cannot_be() -> None:
    with pytest.raises(InvalidConfig, match="'7:00' is not a time; write '07:30'"):
        w.ChangingContext(fake(), {"7:00": {}})
    with pytest.raises(InvalidConfig, match="or all like '07-01 07:30'"):
        w.ChangingContext(fake(), {"07:00": {}, "07-01 07:00": {}})
    with pytest.raises(InvalidConfig, match="'02-30 07:00' is not a time"):
        w.ChangingContext(fake(), {"02-30 07:00": {}})
    env = w.ChangingContext(fake(), {"00:00": {"cool": 25.0}})
    with pytest.raises(InvalidAction, match="'cool' is not an actuator outside the actions"):
        env.reset()


@pytest.mark.parametrize(
    ("schedule", "text"),
    [
        ({"07:00": 3}, "the entry at '07:00' is 3; values by actuator expected"),
        ({}, "the table is empty"),
        (3, r"a table of times or a function of \(time, random\) expected, got 3"),
        (lambda time: {}, r"the schedule should be a function of \(time, random\): too many positional arguments"),
    ],
)
def test_changing_context__schedule_that_cannot_be_is_refused_at_once(schedule: Any, text: str) -> None:
    with pytest.raises(InvalidConfig, match=f"ChangingContext: {text}"):
        w.ChangingContext(fake(), schedule)


def test_changing_context__function_returns_values_by_actuator() -> None:
    env = w.ChangingContext(fake(), lambda time, random: None)  # type: ignore[arg-type]
    env.reset()
    with pytest.raises(InvalidConfig, match="the schedule returned at 2017-07-03 00:00:00 None; values by actuator"):
        env.step(MIDDLE)


def test_context__set_after_the_reset_replaces_that_of_a_table() -> None:
    """Sinergym does so: its `reset(options={"initial_context": …})` replaces the configured one."""
    env = w.ChangingContext(fake(steps_per_hour=1), {"00:00": {"occupants": 0.5}, "03:00": {"occupants": 0.75}})
    for own in (0.25, None, 0.125):
        env.reset()
        if own is not None:
            env.unwrapped.set_context({"occupants": own})  # type: ignore[attr-defined]
        effective = [env.step(MIDDLE)[4]["effective"][2] for _ in range(5)]
        assert effective == [own or 0.5] * 3 + [0.75] * 2
