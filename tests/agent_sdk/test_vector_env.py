"""Several engines of one node as a vector environment: slot i is what a single environment is, to the bit."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.typing import NDArray
from support import data_packs as packs
from support.engine_forks import kill
from support.nodes import SMALL, NodeProgram, engines_of, runs, until

import zenostat
from zenostat import wrappers as w
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.agent_sdk.testing import Climate, FakeEnv
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.topics.errors import (
    EngineDied,
    EpisodeChanged,
    InvalidAction,
    InvalidConfig,
    RequestRejected,
    SimulatorError,
    ZenostatError,
)
from zenostat.topics.messages import State

MODES = list(AutoresetMode)
each_mode = pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)

HOT = {"points": ["zone_1_air_temperature"], "low": 17.0, "high": 26.0, "duration_h": 2.0}
NIGHT = {"points": ["outdoor_temperature"], "low": 18.0, "duration_h": 3.0}  # outside at sample 0, which does not count
COLD = {"points": ["zone_1_air_temperature"], "low": 21.1}  # a zone begins at 21 degC
WIDE = {"points": ["zone_2_air_temperature", "outdoor_temperature"], "low": 5.0, "high": 28.5}
DAY: dict[str, Any] = {"zones": 2, "steps_per_hour": 1, "climate": Climate(noise_k=3.0)}
"""24 timesteps, with another weather each time."""

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


def fakes(count: int, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **arguments: Any) -> FakeVectorEnv:
    return FakeVectorEnv(count, autoreset_mode=mode, **{**DAY, **arguments})


def apart(count: int, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **arguments: Any) -> SyncVectorEnv:
    return SyncVectorEnv([lambda: FakeEnv(**{**DAY, **arguments}) for _ in range(count)], autoreset_mode=mode)


def differ(one: Any, other: Any, where: str = "") -> str:
    """Return the path at which two infos, or two arrays, differ; empty if they are equal."""
    if isinstance(one, dict) and isinstance(other, dict):
        if set(one) != set(other):
            return f"{where}: {sorted(set(one) ^ set(other))} only in one of them"
        return next((difference for key in one if (difference := differ(one[key], other[key], f"{where}.{key}"))), "")
    if type(one) is not type(other):
        return f"{where}: {type(one)} and {type(other)}"
    if isinstance(one, np.ndarray):
        if (one.dtype, one.shape) != (other.dtype, other.shape):
            return f"{where}: {one.dtype} {one.shape} and {other.dtype} {other.shape}"
        if one.flags.writeable != other.flags.writeable:
            return f"{where}: one is read-only"
        if one.dtype == object:
            pairs = zip(one.tolist(), other.tolist(), strict=True)
            return next((difference for a, b in pairs if (difference := differ(a, b, where))), "")
        same = one.tobytes() == other.tobytes()
    else:
        same = one == other
    return "" if same else f"{where}: {one!r} and {other!r}"


def step_both(envs: Sequence[VectorEnv[Any, Any, Any]], actions: Any, but: Sequence[str] = ()) -> NDArray[np.bool_]:
    """Steps both and compares all but these keys of the infos; which slots have ended."""
    ours, theirs = (without(env.step(actions), but) for env in envs)
    for name, one, other in zip(
        ("observations", "rewards", "terminated", "truncated", "infos"), ours, theirs, strict=True
    ):
        assert differ(one, other, name) == ""
    return np.asarray(ours[2] | ours[3])


def without(step: tuple[Any, ...], keys: Sequence[str]) -> tuple[Any, ...]:
    return *step[:-1], {key: value for key, value in step[-1].items() if key.removeprefix("_") not in keys}


def reset_both(envs: Sequence[VectorEnv[Any, Any, Any]], but: Sequence[str] = (), **arguments: Any) -> None:
    ours, theirs = (
        without(env.reset(**{key: _copied(value) for key, value in arguments.items()}), but) for env in envs
    )
    assert differ(ours[0], theirs[0], "observations") == ""
    assert differ(ours[1], theirs[1], "infos") == ""


def _copied(value: Any) -> Any:
    return dict(value) if isinstance(value, dict) else value  # Gymnasium takes the mask out of the options


def run_both(
    envs: Sequence[VectorEnv[Any, Any, Any]],
    mode: AutoresetMode,
    steps: int,
    seed: Any = 3,
    but: Sequence[str] = (),
) -> list[NDArray[np.bool_]]:
    """Resets, steps, and in mode `Disabled` resets the slots that have ended; compares all; who ended when."""
    assert envs[0].observation_space == envs[1].observation_space
    assert envs[0].action_space == envs[1].action_space
    envs[0].action_space.seed(1)
    reset_both(envs, but, seed=seed)
    ends = []
    for _ in range(steps):
        ends.append(step_both(envs, envs[0].action_space.sample(), but))
        if mode is AutoresetMode.DISABLED and ends[-1].any():
            reset_both(envs, but, options={"reset_mask": ends[-1]})
    return ends


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
    run_both([fakes(3, mode), apart(3, mode)], mode, 30, seed)


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


def test_vector_env__all_ids_have_a_vector_of_their_own() -> None:
    ours = [spec for name, spec in gym.registry.items() if name.startswith("zenostat/")]
    assert len(ours) > 100
    assert all(spec.vector_entry_point for spec in ours)


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
        ({"num_envs": 0}, "num_envs = 0; a number from 1 to 256"),
        ({"num_envs": 257}, "num_envs = 257; a number from 1 to 256"),
        ({"autoreset_mode": "Never"}, "autoreset_mode 'Never'; there are: NextStep, SameStep, Disabled"),
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

ONE_DAY: dict[str, Any] = {"begin": "07-03", "end": "07-03", "affinity": "off"}
CLOSE = {"points": ["air_temperature"], "low": 15.0, "high": 25.5, "duration_h": 0.5}
SCENARIOS: dict[str, dict[str, Any]] = {
    "5zone-hot-continuous-v1": {},
    "5zone-mixed-discrete-v1": {},
    "5zone-cool-continuous-stochastic-v1": {},
    "5zone-hot-continuous-stochastic-v1": {"terminate": [CLOSE], "reward": {"kind": "exponential"}},
}


@pytest.fixture(scope="module", params=SCENARIOS)
def real(request: pytest.FixtureRequest) -> Iterator[list[VectorEnv[Any, Any, Any]]]:
    """A scenario's slots on one node, and as many single environments."""
    packs.sinergym()
    form = {**ONE_DAY, **SCENARIOS[request.param]}
    name = f"zenostat/{request.param}"
    envs: list[VectorEnv[Any, Any, Any]] = []
    try:
        envs.append(gym.make_vec(name, num_envs=2, vectorization_mode="vector_entry_point", **form))
        envs.append(gym.make_vec(name, num_envs=2, vectorization_mode="sync", **form))
        yield envs
    finally:
        for env in envs:
            env.close()


@pytest.mark.variants
@each_mode
def test_vector_env__each_slot_of_a_node_is_what_a_single_environment_is(
    real: list[VectorEnv[Any, Any, Any]], mode: AutoresetMode
) -> None:
    """Through the ends of episodes, with the weather that comes next; only how an engine began may differ."""
    ours, theirs = real
    ours.autoreset_mode = theirs.autoreset_mode = mode
    ends = run_both(real, mode, 106, seed=11, but=("engine_start",))
    assert np.sum(ends, axis=0).min() >= 1
    if ours.manifest.task.terminate:
        assert any(end.any() and not end.all() for end in ends), "some ended alone"


@pytest.fixture
def small(scratch: Path) -> Iterator[BuildingVectorEnv]:
    """Three slots of the small building."""
    env = gym.make_vec("zenostat/Building-v1", num_envs=3, **SMALL, affinity="off")
    assert isinstance(env, BuildingVectorEnv)
    yield env
    env.close()


def test_vector_env__engine_that_dies_ends_the_step_and_not_the_environment(small: BuildingVectorEnv) -> None:
    small.reset(seed=1)
    first = small.step(small.action_space.sample())
    assert small.local_node is not None
    victim = engines_of(small.local_node.pid)[-1]
    victim.kill()
    with pytest.raises(SimulatorError):
        small.step(small.action_space.sample())
    small.reset(seed=1)
    again = small.step(first[4]["action"])
    assert again[4]["step"].tolist() == [1, 1, 1]


def test_vector_env__wrong_choice_of_slots_claims_nothing(scratch: Path) -> None:
    with NodeProgram(scratch / "node", **SMALL, slots=2) as node:
        way = {"connect": node.endpoint, "node": "office", "affinity": "off"}
        with pytest.raises(InvalidConfig, match=r"node 'office' has 2 slots, not 3: .*num_envs=2"):
            gym.make_vec("zenostat/Building-v1", num_envs=3, **way)
        with pytest.raises(InvalidConfig, match=r"node 'office' has 2 slots, not 1: .*num_envs=2"):
            gym.make("zenostat/Building-v1", **way)
        with zenostat.connect(node.endpoint, affinity="off") as bus:
            until(lambda: bus.controllers() == [], "whoever was refused has gone")
            assert bus.status("office").controllers == []
        env = gym.make_vec("zenostat/Building-v1", num_envs=2, **way)
        try:
            env.reset(seed=1)
            assert env.step(env.action_space.sample())[4]["step"].tolist() == [1, 1]
            with pytest.raises(InvalidConfig, match=r"steps_per_hour: the node at .* has its own"):
                gym.make_vec("zenostat/Building-v1", num_envs=2, **way, steps_per_hour=6)
        finally:
            env.close()


def test_vector_env__plain_node_has_one_slot(scratch: Path) -> None:
    with NodeProgram(scratch / "node", **SMALL) as node:
        way = {"connect": node.endpoint, "node": "office", "affinity": "off"}
        with pytest.raises(InvalidConfig, match="node 'office' has a single slot, not 2"):
            gym.make_vec("zenostat/Building-v1", num_envs=2, **way)
        env = gym.make_vec("zenostat/Building-v1", num_envs=1, **way)
        env.reset(seed=[1])
        assert env.step(env.action_space.sample())[4]["step"].tolist() == [1]
        env.close()


@pytest.mark.slow
def test_vector_env__scenarios_wrappers_are_around_the_vector(scratch: Path) -> None:
    file = scratch / "mine.yaml"
    wrapped = [{"wrapper": "CyclicTime", "fields": ["hour"]}, {"wrapper": "RescaleAction"}]
    wrapped[1] |= {"min_action": -1.0, "max_action": 1.0}
    file.write_text(json.dumps({**SMALL, "time": ["hour"], "control": "building", "wrappers": wrapped}))
    single = gym.make("zenostat/Scenario-v1", file=file, affinity="off")
    many = gym.make_vec("zenostat/Scenario-v1", num_envs=2, file=file, affinity="off")
    try:
        assert many.single_observation_space == single.observation_space
        assert many.single_action_space == single.action_space
        assert w.wrappers_of(many) == w.wrappers_of(single)
        assert w.names_of(many) == w.names_of(single)
        rows, _ = many.reset(seed=1)
        assert rows[0].tobytes() == single.reset(seed=1)[0].tobytes()
        action = single.action_space.sample()
        assert many.step(np.stack([action, action]))[0][1].tobytes() == single.step(action)[0].tobytes()
    finally:
        single.close()
        many.close()
    file.write_text(json.dumps({**SMALL, "wrappers": [{"wrapper": "FrameStackObservation", "stack_size": 2}]}))
    with pytest.raises(InvalidConfig, match="FrameStackObservation has no vector form"):
        gym.make_vec("zenostat/Scenario-v1", num_envs=2, file=file, affinity="off")


@pytest.mark.slow
def test_vector_env__files_that_are_kept_are_a_slots_own(scratch: Path) -> None:
    settings = {**SMALL, "steps_per_hour": 1, "affinity": "off", "output_dir": scratch / "runs"}
    env = gym.make_vec("zenostat/Building-v1", num_envs=2, autoreset_mode="SameStep", **settings)
    try:
        env.reset(seed=1)
        for _ in range(24):
            *_, infos = env.step(env.action_space.sample())
        folders = infos["final_info"]["output_dir"].tolist()
        assert len(set(folders)) == 2
        assert all((Path(folder) / "eplusout.err").is_file() for folder in folders)
    finally:
        env.close()


@pytest.mark.slow
def test_vector_env__each_slot_tells_the_weather_that_it_reads(scratch: Path) -> None:
    settings = {**ONE_DAY, "building": "ref-small-office", "weather": "USA_CO_Denver", "steps_per_hour": 4}
    settings["weather_noise"] = {"dry_bulb_temperature": {"sigma": 3.0, "mu": 0.0, "tau_h": 24.0}}
    settings |= {"reward": None}
    settings["sensors"] = {"outdoors": ("Site Outdoor Air DryBulb Temperature", "Environment")}
    env = gym.make_vec("zenostat/Building-v1", num_envs=2, **settings)
    try:
        env.reset(seed=1)
        series = env.call("weather", ["dry_bulb_temperature"])
        read = [np.frombuffer(one.values)[11] for one in series]
        for _ in range(48):
            observations = env.step(env.action_space.sample())[0]
        assert read[0] != read[1]
        assert observations[:, 0].tolist() == pytest.approx(read, abs=0.051), "at 12:00, as the file's row 12 says"
        with pytest.raises(RequestRejected, match="no slot 2"):
            env.link.weather(["dry_bulb_temperature"], 2)
    finally:
        env.close()


# Snapshots


@pytest.mark.slow
def test_vector_env__all_slots_go_back_exactly_any_number_of_times(scratch: Path) -> None:
    """With the weather of each, and what reward and limits remembered; slots had begun at different times."""
    packs.sinergym()
    warm = {"points": ["air_temperature"], "low": 15.0, "high": 40.0, "duration_h": 2.0}
    form = {**ONE_DAY, "terminate": [warm], "reward": {"kind": "peak"}, "autoreset_mode": AutoresetMode.DISABLED}
    envs = gym.make_vec(
        "zenostat/5zone-hot-continuous-stochastic-v1", num_envs=3, vectorization_mode="vector_entry_point", **form
    )
    assert isinstance(envs, BuildingVectorEnv)
    rng = np.random.default_rng(3)
    low, high = envs.single_action_space.low, envs.single_action_space.high
    actions = rng.uniform(low, high, (60, 3, len(low))).astype(np.float32)
    envs.reset(seed=5)
    for row in actions[:10]:
        envs.step(row)
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    for row in actions[10:15]:
        after_step = envs.step(row)
    with envs.snapshot() as kept:
        straight = [envs.step(row) for row in actions[15:40]]
        for _ in range(2):
            seen, info = envs.reset(options={"snapshot": kept})
            np.testing.assert_array_equal(seen, after_step[0])
            assert info["step"].tolist() == [15, 5, 15]
            assert info["engine_start"].tolist() == ["snapshot"] * 3
            weather = [envs.envs[slot].weather(["dry_bulb_temperature"]).values for slot in range(3)]
            assert len(set(weather)) == 3
            for row, expected in zip(actions[15:40], straight, strict=True):
                stepped = envs.step(row)
                assert stepped[4].pop("engine_start").tolist() == ["snapshot"] * 3
                expected[4].pop("engine_start", None)
                assert [differ(*pair) for pair in zip(stepped, expected, strict=True)] == [""] * 5
            for row in actions[40:43]:
                envs.step(row)
    with pytest.raises(InvalidConfig, match="is closed; take another one"):
        envs.reset(options={"snapshot": kept})
    envs.close()


def test_vector_env__snapshots_of_slots_that_cannot_be(small: BuildingVectorEnv) -> None:
    with pytest.raises(EpisodeChanged, match=r"call reset\(\) first"):
        small.snapshot()
    small.reset(seed=1)
    kept = small.snapshot()
    with pytest.raises(InvalidConfig, match="a snapshot contains all slots; leave out reset_mask"):
        small.reset(options={"snapshot": kept, "reset_mask": np.array([True, False, False])})
    for _ in range(small.manifest.steps):
        small.step(small.action_space.sample())
    with pytest.raises(EpisodeChanged, match="each slot must be in an episode"):
        small.snapshot()
    assert small.reset(options={"snapshot": kept})[1]["step"].tolist() == [0, 0, 0]
    fake = fakes(2)
    fake.reset()
    with pytest.raises(InvalidConfig, match="has no node"):
        fake.snapshot()
    with pytest.raises(InvalidConfig, match=r"of node .*; this environment is on"):
        fake.reset(options={"snapshot": kept})


# Slots whose episodes end at different times

BOTH = {**SMALL, "affinity": "off", "control": "building"}


def _until_reaped(env: BuildingVectorEnv, count: int) -> None:
    """Its node has had every occasion to see that engines have ended: their processes are over, and it was asked."""
    assert env.local_node is not None
    own = env.local_node.pid
    until(lambda: len([engine for engine in engines_of(own) if runs(engine)]) <= count, "engines have ended")
    for _ in range(3):
        env.link.weather(["dry_bulb_temperature"])


@pytest.mark.variants
@pytest.mark.parametrize("mode", [AutoresetMode.DISABLED, AutoresetMode.NEXT_STEP], ids=lambda mode: mode.value)
def test_vector_env__slot_that_has_ended_leaves_the_others_time(scratch: Path, mode: AutoresetMode) -> None:
    """However long the agent thinks then, as a learner does: the others go on, and it begins anew."""
    env: Any = gym.make_vec("zenostat/Building-v1", num_envs=2, autoreset_mode=mode, **BOTH)
    actions = np.tile([20.0, 25.0], (2, 1)).astype(np.float32)
    env.reset(seed=1)
    straight = [env.step(actions)[0][0] for _ in range(96)]
    env.reset(seed=1)
    for _ in range(5):
        env.step(actions)
    env.reset(seed=1, options={"reset_mask": np.array([True, False])})
    for _ in range(91):
        truncated = env.step(actions)[3]
    assert truncated.tolist() == [False, True]
    _until_reaped(env, 2)  # of slot 0, and the one that waits at sample 0
    assert env.link.bus.status(env.manifest.node).state is State.WAITING
    if mode is AutoresetMode.DISABLED:
        env.reset(seed=2, options={"reset_mask": np.array([False, True])})
        observations = [env.step(actions)[0] for _ in range(5)]
        np.testing.assert_array_equal([row[1] for row in observations], straight[:5])
    else:
        observations = [env.step(actions)[0] for _ in range(5)]  # the first of them begins slot 1 anew
        np.testing.assert_array_equal([row[1] for row in observations[1:]], straight[:4])
    np.testing.assert_array_equal([row[0] for row in observations], straight[91:])
    env.close()


@pytest.mark.slow
def test_vector_env__rewards_and_limits_know_the_truth_of_what_faults_disturb(scratch: Path) -> None:
    """They equal those of the single environment, to the bit."""
    plan = scratch / "faults.yaml"
    bias = {"kind": "bias", "points": "core_zn_air_temperature", "offset": 9.0}
    plan.write_text(
        yaml.safe_dump(
            {
                "seed": 3,
                "faults": [
                    bias,
                    {"kind": "drop", "points": "core_zn_occupants", "when": {"from_step": 10, "to_step": 20}},
                ],
            }
        )
    )
    limit = {"points": ["core_zn_air_temperature"], "high": 33.0}
    form = {**BOTH, "faults": plan, "terminate": [limit], "disable_env_checker": True}
    one: Any = gym.make("zenostat/Building-v1", **form)
    form.pop("disable_env_checker")
    many: Any = gym.make_vec("zenostat/Building-v1", num_envs=2, vectorization_mode="vector_entry_point", **form)
    one.reset(seed=1)
    many.reset(seed=[1, 1])
    action = np.array([20.0, 25.0], np.float32)
    for _ in range(60):
        seen, reward, terminated, _, info = one.step(action)
        rows, rewards, ends, _, infos = many.step(np.tile(action, (2, 1)))
        for slot in range(2):
            np.testing.assert_array_equal(rows[slot], seen)
            np.testing.assert_array_equal(infos["fault_free_values"][slot], info["fault_free_values"])
            assert rewards[slot] == reward
            assert ends[slot] == terminated == False  # noqa: E712
        assert np.isfinite(reward)
    one.close()
    many.close()


def test_vector_env__slots_that_cannot_go_back_go_on(scratch: Path) -> None:
    env: Any = gym.make_vec("zenostat/Building-v1", num_envs=2, **BOTH)
    actions = np.tile([20.0, 25.0], (2, 1)).astype(np.float32)
    env.reset(seed=1)
    straight = [env.step(actions)[0] for _ in range(10)]
    env.reset(seed=1)
    before = {engine.pid for engine in engines_of(env.local_node.pid)}
    with env.snapshot() as kept:
        kill(next(engine for engine in engines_of(env.local_node.pid) if engine.pid not in before))
        for _ in range(2):
            with pytest.raises(EngineDied):
                env.reset(options={"snapshot": kept})
        np.testing.assert_array_equal([env.step(actions)[0] for _ in range(10)], straight)
    env.close()


def test_vector_env__slots_that_go_back_see_the_clock_that_they_saw(scratch: Path) -> None:
    """At an hour's end, where the timestep began within the hour before."""
    fields = ("month", "day_of_month", "hour", "minutes", "current_time")
    env: Any = gym.make_vec("zenostat/Building-v1", num_envs=2, **BOTH, time=fields)
    actions = np.tile([20.0, 25.0], (2, 1)).astype(np.float32)
    env.reset(seed=1)
    begun = [env.step(actions)[0] for _ in range(4)][-1]
    assert begun[:, :5].tolist() == [[7, 3, 0, 60, 1]] * 2
    with env.snapshot() as kept:
        env.step(actions)
        np.testing.assert_array_equal(env.reset(options={"snapshot": kept})[0], begun)
    env.close()
