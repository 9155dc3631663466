"""Several engines of one node as a vector environment: slot i is what a single environment is, to the bit."""

import re
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from support.vector_envs import DAY, apart, differ, each_mode, fakes, reset_both, run_both, step_both

from zenostat import wrappers as w
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.topics.errors import (
    EpisodeChanged,
    InvalidAction,
    InvalidConfig,
    SimulatorError,
    UnknownArgument,
    ZenostatError,
)

HOT = {"points": ["zone_1_air_temperature"], "low": 17.0, "high": 26.0, "duration_h": 2.0}
NIGHT = {"points": ["outdoor_temperature"], "low": 18.0, "duration_h": 3.0}  # outside at sample 0, which does not count
COLD = {"points": ["zone_1_air_temperature"], "low": 21.1}  # a zone begins at 21 degC
WIDE = {"points": ["zone_2_air_temperature", "outdoor_temperature"], "low": 5.0, "high": 28.5}

FORMS: dict[str, dict[str, Any]] = {
    "continuous": {},
    "clock": {"time": ("month", "day_of_week", "hour", "minutes", "current_time")},
    "one choice": {"control": "building", "discrete": 5},
    "discrete_actions": {"control": "zone", "discrete": 4, "time": ("hour",)},
    "limits": {"terminate": [HOT, WIDE]},
    "patience": {"terminate": [NIGHT]},
    "outside at once": {"terminate": [COLD]},
    "remembers": {"reward": {"kind": "peak", "lambda_peak": 2.0}, "terminate": [HOT]},
    "by the hour": {"reward": {"kind": "hourly"}, "terminate": [HOT]},
    "by zone": {"reward": {"kind": "multi_zone", "zones": {"zone_1_air_temperature": "outdoor_temperature"}}},
    "no reward": {"reward": None, "terminate": [WIDE]},
    "beside": {"equipment_control": True, "actions": {"cooling": ["zone_1_cooling_setpoint"]}, "terminate": [HOT]},
}


# Equal to Gymnasium's own, on fake buildings


@each_mode
@pytest.mark.parametrize("form", FORMS)
def test_vector_env__each_slot_is_what_a_single_environment_is(form: str, mode: AutoresetMode) -> None:
    ends = run_both([fakes(4, mode, **FORMS[form]), apart(4, mode, **FORMS[form])], mode, 80)
    assert sum(end.sum() for end in ends) >= 8, "each slot has ended twice"
    if "terminate" in FORMS[form]:
        assert any(end.any() and not end.all() for end in ends), "some ended alone"


@each_mode
def test_vector_env__one_slot_is_a_vector_too(mode: AutoresetMode) -> None:
    run_both([fakes(1, mode, **FORMS["limits"]), apart(1, mode, **FORMS["limits"])], mode, 60)


@each_mode
@pytest.mark.parametrize("seed", [None, 0, [5, None, 5]], ids=str)
def test_vector_env__seeds_are_a_slots_own(seed: Any, mode: AutoresetMode) -> None:
    envs = [fakes(3, mode), apart(3, mode)]
    reset_both(envs, seed=1)  # without a seed, that of each slot continues
    run_both(envs, mode, 30, seed)


@each_mode
def test_vector_env__slots_begin_anew_in_the_middle_of_their_episodes(mode: AutoresetMode) -> None:
    form = {**FORMS["remembers"], "terminate": []}
    envs = [fakes(3, mode, **form), apart(3, mode, **form)]
    reset_both(envs, seed=1)
    for mask, seed in (([True, False, True], None), ([False, True, False], 7), ([True, True, True], [1, 2, None])):
        for _ in range(5):
            step_both(envs, envs[0].action_space.sample())
        reset_both(envs, options={"reset_mask": np.array(mask)}, seed=seed)
    for _ in range(40 if mode is not AutoresetMode.DISABLED else 20):
        step_both(envs, envs[0].action_space.sample())


def test_vector_env__maxima_of_a_reward_do_not_count_the_first_sample_of_a_slot_that_begins_anew() -> None:
    # Heated from the beginning, a building is coldest, and farthest from this band, at sample 0.
    form = {"reward": {"kind": "normalized", "summer": [25.0, 30.0], "winter": [25.0, 30.0]}, "control": "building"}
    mode = AutoresetMode.NEXT_STEP
    envs = [fakes(2, mode, **form), apart(2, mode, **form)]
    warmest = envs[0].action_space.high
    reset_both(envs, seed=1)
    for _ in range(5):
        step_both(envs, warmest)
    reset_both(envs, options={"reset_mask": np.array([True, False])})
    for _ in range(40):
        step_both(envs, warmest)


def test_vector_env__slot_that_has_ended_may_be_begun_by_hand() -> None:
    """Then it is not begun a second time by the next step."""
    envs = [fakes(2, terminate=[WIDE]), apart(2, terminate=[WIDE])]
    ends = run_both(envs, AutoresetMode.NEXT_STEP, 1)
    while not ends[-1].any():
        ends.append(step_both(envs, envs[0].action_space.sample()))
    reset_both(envs, options={"reset_mask": ends[-1]})
    step_both(envs, envs[0].action_space.sample())


@each_mode
def test_observations__are_never_overwritten(mode: AutoresetMode) -> None:
    env = fakes(2, mode, terminate=[COLD])
    seen, _ = env.reset(seed=1)
    observations, before = [seen], [seen.copy()]
    for _ in range(6):
        seen, _, terminated, truncated, _ = env.step(env.action_space.sample())
        observations.append(seen)
        before.append(seen.copy())
        ended = terminated | truncated
        env.reset(options={"reset_mask": ended if ended.any() else np.array([True, False])})
    assert differ(dict(enumerate(observations)), dict(enumerate(before))) == ""


def test_infos__belong_to_the_caller() -> None:
    env = fakes(2)
    env.reset(seed=1)
    one, other = (env.step(np.tile([16.0, 25.0], (2, 2)))[4] for _ in range(2))
    assert not any(np.shares_memory(one[key], other[key]) for key in one if isinstance(one[key], np.ndarray))


@each_mode
def test_vector_env__wrappers_of_vectors_fit(mode: AutoresetMode) -> None:
    """Forecasts ask each slot for its own weather; contexts are set in slots that stand at different times."""
    form = {**FORMS["beside"], "time": ("hour",)}
    chain = [
        {"wrapper": "WeatherForecast", "columns": ["dry_bulb_temperature"], "n": 2},
        {"wrapper": "ChangingContext", "schedule": {"00:00": {"equipment": 0.1}, "07:00": {"equipment": 0.9}}},
        {"wrapper": "PreviousObservation", "names": ["zone_1_air_temperature"]},
    ]
    envs = [w.apply_wrappers(env, chain) for env in (fakes(3, mode, **form), apart(3, mode, **form))]
    ends = run_both(envs, mode, 60)
    assert any(end.any() and not end.all() for end in ends)


def test_vector_env__what_one_slot_gets_beside_its_actions_is_its_own() -> None:
    form = {**FORMS["beside"], "terminate": []}
    ours, theirs = envs = [fakes(2, **form), apart(2, **form)]
    reset_both(envs, seed=1)
    for env in envs:
        env.envs[1].set_context({"equipment": 0.5, "zone_1_heating_setpoint": 20.0})
    actions = np.full((2, 1), 24.0, np.float32)
    step_both(envs, actions)
    _, _, _, _, infos = ours.step(actions)
    theirs.step(actions)
    assert infos["effective"][:, -1].tolist() == [0.1, 0.5], "it lasts, in slot 1 alone"
    for env in envs:
        env.envs[0].set_context({"zone_1_heating_setpoint": 21.0})
        env.envs[1].set_context({"zone_1_heating_setpoint": None})
    step_both(envs, actions)
    ours.set_context({"equipment": 1.0})
    assert ours.step(actions)[4]["effective"][:, -1].tolist() == [1.0, 1.0]


def test_vector_env__context_that_was_not_used_ends_with_the_episode() -> None:
    ours = fakes(2, **{**FORMS["beside"], "terminate": []})
    ours.reset(seed=1)
    ours.set_context({"equipment": 0.5})
    ours.reset(options={"reset_mask": np.array([True, False])})
    assert ours.step(np.full((2, 1), 24.0))[4]["effective"][:, -1].tolist() == [0.1, 0.5]


def test_vector_env__own_reward_gets_arrays_and_a_time_for_each_slot() -> None:
    seen = []

    def reward(values: Any, begin: Any) -> Any:
        seen.append((values["outdoor_temperature"].shape, [moment.hour for moment in begin]))
        return {"heat": -values["outdoor_temperature"], "always": 1.0}

    ours = fakes(2, reward=reward)
    observations, _ = ours.reset(seed=1)
    assert [shape for shape, _ in seen] == [(2,)]  # for the names of its terms, once
    seen.clear()
    ours.step(ours.action_space.sample())
    ours.reset(options={"reset_mask": np.array([False, True])})
    observations, rewards, _, _, infos = ours.step(ours.action_space.sample())
    assert seen == [((2,), [0, 0]), ((2,), [1, 0])]
    outdoors = infos["reward_terms"]["heat"]
    assert (-outdoors).astype(np.float32).tolist() == observations[:, 0].tolist()
    assert rewards.tolist() == (outdoors + 1.0).tolist()
    assert infos["reward_terms"]["always"].tolist() == [1.0, 1.0]
    assert infos["reward_terms"]["always"].flags.writeable


# Gymnasium's make_vec


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mode", [None, "vector_entry_point"])
def test_vector_env__make_vec(mode: str | None) -> None:
    env = gym.make_vec("zenostat/Fake-v1", num_envs=3, vectorization_mode=mode, autoreset_mode="SameStep", **DAY)
    assert isinstance(env, FakeVectorEnv)
    assert (env.num_envs, env.metadata["autoreset_mode"]) == (3, AutoresetMode.SAME_STEP)
    assert env.spec is not None
    assert env.spec.id == "zenostat/Fake-v1"
    again = gym.make_vec(env.spec)
    assert (again.num_envs, again.metadata["autoreset_mode"]) == (3, AutoresetMode.SAME_STEP)
    for vector in (env, again):
        vector.close()
        vector.close()


def test_vector_env__limit_of_gymnasium_needs_environments_of_their_own() -> None:
    with pytest.raises(UnknownArgument, match=r"max_episode_steps, but a vector environment .*begin= and end="):
        gym.make_vec("zenostat/Fake-v1", num_envs=2, max_episode_steps=3)
    with closing(gym.make_vec("zenostat/Fake-v1", 2, "sync", max_episode_steps=3)) as env:
        env.reset(seed=0)
        truncated = [env.step(env.action_space.sample())[3].tolist() for _ in range(3)]
    assert truncated == [[False] * 2] * 2 + [[True] * 2]
    with pytest.raises(UnknownArgument, match="'zone'; did you mean 'zones'"):
        gym.make("zenostat/Fake-v1", zone=2)


def test_vector_env__all_ids_but_that_of_districts_have_a_vector_of_their_own() -> None:
    ours = [spec for name, spec in gym.registry.items() if name.startswith("zenostat/")]
    assert len(ours) > 100
    assert [spec.id for spec in ours if not spec.vector_entry_point] == ["zenostat/District-v1"]


def test_vector_env__answers_call_and_get_attr_of_its_slots() -> None:
    env = fakes(3, time=("hour",))
    env.reset(seed=1)
    single = FakeEnv(**DAY, time=("hour",))
    assert env.observation_names == single.observation_names == env.get_attr("observation_names")[2]
    assert env.call("action_names") == (single.action_names,) * 3
    series = env.call("weather", ["dry_bulb_temperature"])
    assert len({one.values for one in series}) == 3, "each has a weather of its own"
    single.reset(seed=3)
    assert series[2].values == single.weather(["dry_bulb_temperature"]).values
    env.set_attr("colour", ["red", "green", "blue"])
    assert env.get_attr("colour") == ("red", "green", "blue")
    with pytest.raises(AttributeError, match="colour_of"):
        env.get_attr("colour_of")
    with pytest.raises(InvalidConfig, match="2 values for 3 slots"):
        env.set_attr("colour", [1, 2])
    with pytest.raises(AttributeError, match="'reward' belongs to the vector environment"):
        env.set_attr("reward", None)


@pytest.mark.variants
@each_mode
def test_vector_env__pictures(mode: AutoresetMode) -> None:
    pytest.importorskip("matplotlib")
    envs = [fakes(2, mode, render_mode="rgb_array"), apart(2, mode, render_mode="rgb_array")]
    reset_both(envs, seed=1)
    for _ in range(26):
        ended = step_both(envs, envs[0].action_space.sample())
        if mode is AutoresetMode.DISABLED and ended.any():
            reset_both(envs, options={"reset_mask": ended})
    ours, theirs = (env.render() for env in envs)
    assert [differ(one, other) for one, other in zip(ours, theirs, strict=True)] == ["", ""]
    assert fakes(2).render() == apart(2).render() == (None, None)


# What cannot be


def test_vector_env__actions_that_cannot_be_name_their_slot() -> None:
    env = fakes(3)
    env.reset(seed=1)
    before = env.step(env.action_space.sample())[4]["step"]
    right = np.tile(np.array([15.0, 30.0, 20.0, 25.0]), (3, 1))
    wrong = right.copy()
    wrong[1, 0], wrong[2, 3] = 14.0, np.nan
    with pytest.raises(InvalidAction) as raised:
        env.step(wrong)
    assert str(raised.value) == (
        "slot 1: zone_1_heating_setpoint = 14; its bounds are 15 to 22.5 degC; "
        "slot 2: zone_2_cooling_setpoint = nan; its bounds are 22.5 to 30 degC"
    )
    with pytest.raises(
        InvalidAction, match=re.escape("action of shape (4,); (3, 4) expected: zone_1_heating_setpoint")
    ):
        env.step(right[0])
    assert env.step(right)[4]["step"].tolist() == (before + 1).tolist(), "nothing was simulated"


@pytest.mark.parametrize("form", ["one choice", "discrete_actions"])
def test_vector_env__choices_that_cannot_be_name_their_slot(form: str) -> None:
    env = fakes(3, **FORMS[form])
    env.reset(seed=1)
    wrong = env.action_space.sample()
    np.moveaxis(wrong, 0, -1)[..., 2] = 9
    with pytest.raises(InvalidAction, match=r"slot 2: choice 9 of .*; 0 to [34] expected"):
        env.step(wrong)
    for shape in ((3, 7), (2, *wrong.shape[1:])):
        with pytest.raises(InvalidAction, match="expected of each of 3 slots"):
            env.step(np.zeros(shape, int))
    with pytest.raises(InvalidAction, match="expected of each of 3 slots"):
        env.step(np.full(wrong.shape, 0.5))


def test_vector_env__nobody_reads_the_action_of_a_slot_that_begins_anew() -> None:
    for form in ("limits", "one choice"):
        env = fakes(2, **{**FORMS[form], "terminate": [WIDE]})
        env.action_space.seed(0)
        env.reset(seed=3)
        ended = np.zeros(2, np.bool_)
        while not ended.any() or ended.all():
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            ended = terminated | truncated
        actions = env.action_space.sample()
        actions[ended] = -1
        _, rewards, _, _, infos = env.step(actions)
        assert (infos["step"] == 0).tolist() == ended.tolist()
        assert not rewards[ended].any()
        assert np.isnan(infos["action"]).all(axis=-1).tolist() == ended.tolist()


def test_vector_env__unread_actions_are_zeros() -> None:
    rows = fakes(3)._actions.rows(np.full((3, 4), np.nan), 3, [0, 1, 2])
    assert rows.tobytes() == np.zeros((3, 4)).tobytes()


def test_vector_env__steps_that_cannot_be() -> None:
    env = fakes(2, AutoresetMode.DISABLED)
    with pytest.raises(EpisodeChanged, match=r"call reset\(\) before step\(\)"):
        env.step(env.action_space.sample())
    with pytest.raises(EpisodeChanged, match="all slots first"):
        env.reset(options={"reset_mask": np.array([True, False])})
    env.reset(seed=1)
    env.reset(options={"reset_mask": np.array([True, False])})
    for _ in range(24):
        env.step(env.action_space.sample())
    with pytest.raises(EpisodeChanged, match="over in slots 0, 1; call reset"):
        env.step(env.action_space.sample())
    env.reset()
    env.close()
    env.close()
    for call in (lambda: env.step(env.action_space.sample()), env.reset):
        with pytest.raises(EpisodeChanged, match="the environment is closed; make another one"):
            call()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"seed": -1}, "an integer from 0 to 2**64 - 2 expected"),
        ({"seed": [1]}, "each of 2 slots"),
        ({"seed": np.array(1.5)}, "an integer from 0 to 2**64 - 2 expected"),
        ({"seed": [1, -2]}, "seed = -2; an integer from 0 to 2**64 - 1 expected"),
        ({"options": {"mask": 1}}, "unknown reset options ['mask']; available: 'snapshot', 'reset_mask'"),
        ({"options": {"reset_mask": [1, 0]}}, "a bool array of shape (2,)"),
        ({"options": {"reset_mask": np.array([False, False])}}, "at least one True"),
        ({"options": {"reset_mask": np.array([True])}}, "a bool array of shape (2,)"),
    ],
)
def test_vector_env__resets_that_cannot_be(arguments: dict[str, Any], words: str) -> None:
    env = fakes(2)
    env.reset(seed=1)
    with pytest.raises(InvalidConfig, match=re.escape(words)):
        env.reset(**arguments)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"num_envs": 0}, "num_envs = 0; a whole number from 1 to 256"),
        ({"num_envs": 257}, "num_envs = 257; a whole number from 1 to 256"),
        ({"autoreset_mode": "Never"}, "autoreset_mode 'Never'; there are: 'NextStep', 'SameStep', 'Disabled'"),
        ({"bilding": "ref-small-office"}, "unexpected keyword argument 'bilding'; did you mean 'building'"),
        ({"render_mode": "human"}, "render_mode 'human'; there are: rgb_array, rerun"),
        ({"connect": "tcp/127.0.0.1:1"}, "needs the node's name"),
        ({}, "name a building and a weather"),
    ],
)
def test_vector_env__vectors_that_cannot_be(arguments: dict[str, Any], words: str, scratch: Path) -> None:
    with pytest.raises(ZenostatError, match=re.escape(words)):
        BuildingVectorEnv(**{"num_envs": 2, **arguments})


def test_vector_env__failed_step_is_not_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    env = fakes(2)
    env.reset(seed=1)

    def fail() -> Any:
        raise SimulatorError("the engine of slot 1 died")

    with monkeypatch.context() as patch:
        patch.setattr(env.link, "receive", fail)
        with pytest.raises(SimulatorError, match="slot 1"):
            env.step(env.action_space.sample())
    env.reset(seed=1)
    assert env.step(env.action_space.sample())[4]["step"].tolist() == [1, 1]


# Equal to Gymnasium's own, on real nodes


# Snapshots


# Slots whose episodes end at different times


def test_vector_env__takes_numbers_of_numpy() -> None:
    with closing(gym.make_vec("zenostat/Fake-v1", num_envs=np.int64(2))) as env:  # type: ignore[arg-type]
        expected, _ = env.reset(seed=5)
        observations, _ = env.reset(seed=np.array(5))  # type: ignore[arg-type]
        assert observations.tolist() == expected.tolist()
