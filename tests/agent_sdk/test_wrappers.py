"""Wrappers on a building without EnergyPlus, by hand-computed values."""

import copy
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import (
    FlattenObservation,
    FrameStackObservation,
    NormalizeObservation,
    NormalizeReward,
    OrderEnforcing,
    PassiveEnvChecker,
    RescaleAction,
    TimeAwareObservation,
    TimeLimit,
    TransformObservation,
)
from support.fakes import NAMES
from support.wrapped_fakes import DRY, MIDDLE, WIND, episode, fake, fakes

from zenostat import wrappers as w
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.agent_sdk.time_series import HourlySeries
from zenostat.agent_sdk.wrappers.base import Infos
from zenostat.topics.errors import InvalidConfig

PRICE = {"hourly": list(range(8760)), "unit": "EUR/MWh"}

CHAINS: dict[str, list[dict[str, Any]]] = {
    "CyclicTime": [{"wrapper": "CyclicTime"}],
    "PreviousObservation": [{"wrapper": "PreviousObservation", "names": ["core", "electricity"]}],
    "MetricObservation": [{"wrapper": "MetricObservation", "metrics": ["joules"]}],
    "WeatherForecast": [
        {"wrapper": "WeatherForecast", "columns": [DRY, "relative_humidity", WIND], "n": 3, "spacing_h": 0.5}
    ],
    "WeatherForecast with errors": [
        {"wrapper": "WeatherForecast", "columns": [DRY, "relative_humidity"],
         "errors": {DRY: 2.0, "relative_humidity": {"sigma": 80.0, "tau_h": 4.0}}}
    ],
    "TimeSeriesObservation": [{"wrapper": "TimeSeriesObservation", "signals": {"price": PRICE}, "hours": [0, 2]}],
    "SetpointDifference": [{"wrapper": "SetpointDifference", "pairs": {"core_excess": ["core", "core_setpoint"]}}],
    "ReducedObservation": [{"wrapper": "ReducedObservation", "keep": ["humidity", "core"]}],
    "IncrementalAction": [
        {"wrapper": "IncrementalAction", "increments": {"cool": [1.0, 0.25]}, "initial": {"cool": 26.0}}
    ],
    "DiscreteIncrementalAction": [
        {"wrapper": "DiscreteIncrementalAction", "steps": {"cool": 0.5}, "initial": {"heat": 20.0, "cool": 26.0}}
    ],
    "ChangingContext": [
        {"wrapper": "ChangingContext", "schedule": {"07:00": {"occupants": 1.0}, "18:00": {"occupants": 0.25}}}
    ],
    "RewardVector": [{"wrapper": "RewardVector", "terms": ["comfort", "energy"]}],
    "RewardVector within another": [
        {"wrapper": "RewardVector", "terms": ["comfort", "energy"]},
        {"wrapper": "PreviousObservation", "names": ["core"]},
    ],
    "NumericInfos": [{"wrapper": "NumericInfos"}],
    "many": [
        {"wrapper": "CyclicTime", "fields": ["hour"], "replace": False},
        {"wrapper": "SetpointDifference", "pairs": {"excess": ["core", "core_setpoint"]}},
        {"wrapper": "PreviousObservation", "names": ["excess"]},
        {"wrapper": "WeatherForecast", "columns": [DRY], "errors": {DRY: 1.0}},
        {"wrapper": "ReducedObservation", "keep": ["previous_excess", "hour_sin", f"{DRY}_in_5h"]},
        {"wrapper": "IncrementalAction", "increments": {"heat": 0.5}, "initial": {"heat": 20.0}},
        {"wrapper": "NormalizeReward", "gamma": 0.9},
    ],
}  # fmt: skip
each_chain = pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)


# What holds for all


@each_chain
@pytest.mark.filterwarnings("ignore:.*Box (observation|action) space (minimum|maximum) value is (-)?infinity.*")
@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space.*")
@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version.*")
@pytest.mark.filterwarnings("ignore:.*The reward returned by `step.*")
@pytest.mark.filterwarnings("ignore:.*Not able to test alternative render modes.*")
def test_wrappers__gymnasiums_checker_passes(chain: list[dict[str, Any]]) -> None:
    fixed = [one for one in chain if one["wrapper"] != "NormalizeReward"]  # statistics go on over a reset
    check_env(w.apply_wrappers(fake(), fixed))


@pytest.mark.slow
@each_chain
def test_wrappers__observations_lie_in_their_space_for_a_year(chain: list[dict[str, Any]]) -> None:
    env = w.apply_wrappers(fake(begin="2016-01-01T00:00:00", days=366), chain)
    env.action_space.seed(1)
    for observation, _, _, _ in episode(env, env.action_space.sample):
        assert observation.dtype == np.float32
        assert env.observation_space.contains(observation)
    assert len(w.names_of(env)) == env.observation_space.shape[0]


@each_chain
def test_wrappers__episode_is_the_same_to_the_bit_with_the_same_seed(chain: list[dict[str, Any]]) -> None:
    env = w.apply_wrappers(fake(), chain)
    seen = []
    for seed in (3, 3, 4):
        env.action_space.seed(1)
        seen.append([observation.tobytes() for observation, *_ in episode(env, env.action_space.sample, seed)])
    assert seen[0] == seen[1]
    if "observation" not in str(chain) and "Action" not in str(chain[0]["wrapper"]):
        assert seen[1] != seen[2]


@each_chain
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_wrappers__vector_is_equal_to_its_slots(chain: list[dict[str, Any]], mode: AutoresetMode) -> None:
    """Through the end of an episode and into the next, for which there is no seed."""
    if chain[-1]["wrapper"] == "NormalizeReward":
        chain = chain[:-1]  # statistics of all slots together
    many = w.apply_wrappers(fakes(2, mode), chain)
    singles = [w.apply_wrappers(fake(), chain) for _ in range(2)]
    many.action_space.seed(5)
    starts = [env.reset(seed=9 + slot) for slot, env in enumerate(singles)]
    rows, infos = many.reset(seed=9)
    assert many.observation_space.contains(rows)
    assert rows.tobytes() == np.stack([observation for observation, _ in starts]).tobytes()
    over = [False, False]
    for _ in range(30):
        actions = many.action_space.sample()
        if mode is AutoresetMode.DISABLED and any(over):
            rows, infos = many.reset(options={"reset_mask": np.array(over)})
            assert rows.tobytes() == np.stack([env.reset()[0] for env in singles]).tobytes()
            over = [False, False]
        rows, rewards, _, truncated, infos = many.step(actions)
        for slot, env in enumerate(singles):
            if over[slot] and mode is AutoresetMode.NEXT_STEP:
                observation, info = env.reset()
                reward, ended = 0.0 * np.asarray(rewards[slot]), False
            else:
                observation, reward, _, ended, info = env.step(actions[slot])
            last = observation
            if ended and mode is AutoresetMode.SAME_STEP:
                assert infos["final_obs"][slot].tobytes() == last.tobytes()
                final = infos["final_info"]
                observation = env.reset()[0]
            else:
                final = infos
            assert rows[slot].tobytes() == observation.tobytes()
            assert np.array_equal(rewards[slot], reward)
            assert truncated[slot] == ended
            over[slot] = ended and mode is not AutoresetMode.SAME_STEP
            for name, value in info.get("dropped", {}).items():
                assert final["dropped"][name][slot] == value
                assert final["dropped"][f"_{name}"][slot]
    many.close()


def test_wrappers__reset_of_some_slots_leaves_the_others() -> None:
    many = w.apply_wrappers(fakes(2, AutoresetMode.DISABLED), CHAINS["PreviousObservation"])
    many.reset(seed=1)
    actions = np.stack([MIDDLE, MIDDLE])
    before, *_ = many.step(actions)
    asked = {"reset_mask": np.array([True, False])}
    rows, _ = many.reset(options=asked)
    assert list(asked) == ["reset_mask"], "the caller's options are his own"
    assert rows[1].tobytes() == before[1].tobytes()
    assert rows[0, -2:].tolist() == [23.0, 0.0]
    after, *_ = many.step(actions)
    assert after[:, -2].tolist() == [23.0, 24.5], "one step ago: 23, and 23 + (26 - 23) / 2"


def test_wrappers__reset_at_an_episodes_end_is_no_autoreset() -> None:
    many = w.PreviousObservation(fakes(2), ["core"])
    actions = np.stack([MIDDLE, MIDDLE])
    many.reset(seed=1)
    for _ in range(24):
        many.step(actions)
    many.reset()
    seen = [many.step(actions)[0][:, -1].tolist() for _ in range(2)]
    assert seen == [[23.0, 23.0], [24.5, 24.5]]


def test_wrappers__infos_of_a_vector_are_read_by_their_masks() -> None:
    terms = {"energy": np.array([1.0, 2.0]), "_energy": np.array([True, False]), "_own": np.array([3.0, 4.0])}
    infos = Infos({"reward_terms": terms, "step": np.array([5, 6]), "_step": np.array([False, True])}, [1, 0])
    assert [infos.get(row, "step") for row in (0, 1)] == [6, None]
    assert [infos.get(row, "reward_terms") for row in (0, 1)] == [{"_own": 4.0}, {"energy": 1.0, "_own": 3.0}]
    assert infos.get(0, "time") is None


@each_chain
def test_wrappers__chains_are_data(chain: list[dict[str, Any]]) -> None:
    env = w.apply_wrappers(OrderEnforcing(PassiveEnvChecker(fake())), chain)
    assert w.wrappers_of(env) == chain == json.loads(json.dumps(w.wrappers_of(env)))
    again = w.apply_wrappers(fake(), w.wrappers_of(env))
    assert again.observation_space == env.observation_space
    ours = [one for one in chain if one["wrapper"] != "NormalizeReward"]
    assert w.wrappers_of(w.apply_wrappers(fakes(), ours)) == ours


def test_wrappers__what_was_wrapped_by_hand_is_data_too() -> None:
    env = w.CyclicTime(
        FrameStackObservation(RescaleAction(fake(), np.float32(-1.0), np.array([1, 2], np.float32)), 3).env, ("hour",)
    )
    rescaled = {"wrapper": "RescaleAction", "min_action": -1.0, "max_action": [1, 2]}
    assert w.wrappers_of(env) == [rescaled, {"wrapper": "CyclicTime", "fields": ["hour"]}]
    stack = {"wrapper": "FrameStackObservation", "stack_size": 3}
    assert w.wrappers_of(FrameStackObservation(fake(), 3)) == [stack]
    assert w.wrappers_of(w.CyclicTime(fake())) == [{"wrapper": "CyclicTime"}]  # made without arguments
    limited = gym.make("zenostat/Fake-v1", max_episode_steps=3)
    assert w.wrappers_of(limited) == [{"wrapper": "TimeLimit", "max_episode_steps": 3}]
    price = HourlySeries(hourly=tuple(range(8760)), unit="g/kWh")
    (wrapper,) = w.wrappers_of(w.TimeSeriesObservation(fake(), {"carbon": price}))
    assert w.apply_wrappers(fake(), [wrapper]).reset()[0][-1] == 24 * (31 + 28 + 31 + 30 + 31 + 30 + 2)


@pytest.mark.parametrize(
    ("chain", "text"),
    [
        ([{"wrapper": "CyclicTim"}], r"wrappers\[0\]: there is no wrapper 'CyclicTim'; did you mean 'CyclicTime'"),
        ([{"wrapper": "os.system"}], "there is no wrapper"),
        (["CyclicTime"], r"wrappers\[0\]: 'CyclicTime' is not a wrapper; write"),
        ([{"wrapper": "CyclicTime", "field": ["hour"]}], "CyclicTime has no argument 'field'; did you mean 'fields'"),
        ([{"wrapper": "PreviousObservation"}], "missing a required argument: 'names'"),
        ([{"wrapper": "RescaleAction", "min_action": 0}], "RescaleAction: .*'max_action'"),
        ([{"wrapper": "RewardVector", "terms": ["energy"]}, {"wrapper": "NormalizeReward"}],
            r"wrappers\[1\]: NormalizeReward needs a scalar reward; apply it before RewardVector"),
        ([{"wrapper": "NormalizeObservation"}, *CHAINS["SetpointDifference"]],
            "SetpointDifference needs values in their units; apply it before NormalizeObservation"),
        ([{"wrapper": "FrameStackObservation", "stack_size": 2}, {"wrapper": "CyclicTime"}],
            "after FrameStackObservation values have no names; apply it after the wrappers that need them"),
        ([{"wrapper": "RescaleAction", "min_action": -1, "max_action": 1}, *CHAINS["IncrementalAction"]],
            "IncrementalAction changes values in their units; apply it before RescaleAction"),
        ([*CHAINS["DiscreteIncrementalAction"], *CHAINS["IncrementalAction"]],
            "apply it before DiscreteIncrementalAction"),
        ([{"wrapper": "RepeatAction", "num_repeats": 2}, {"wrapper": "RewardVector", "terms": ["energy"]}],
            "RewardVector needs each timestep, but RepeatAction skips some; remove one of them"),
        ([{"wrapper": "RewardVector", "terms": ["energy"]}, {"wrapper": "RepeatAction", "num_repeats": 2}],
            "RepeatAction needs a scalar reward; apply it before RewardVector"),
        ([{"wrapper": "MaxAndSkipObservation"}, {"wrapper": "EpisodeLog", "folder": "log"}],
            "EpisodeLog needs each timestep, but MaxAndSkipObservation skips some; apply it before Max"),
        ([{"wrapper": "RepeatAction", "num_repeats": 2}, {"wrapper": "TensorBoardLog", "folder": "log"}],
            "TensorBoardLog needs each timestep"),
        ([{"wrapper": "RepeatAction", "num_repeats": 2}, {"wrapper": "ChangingContext", "schedule": {"00:00": {}}}],
            "ChangingContext needs each timestep"),
        ([{"wrapper": "NumericInfos"}, {"wrapper": "CyclicTime"}],
            "CyclicTime needs infos that NumericInfos leaves out; apply it before NumericInfos"),
    ],
)  # fmt: skip
def test_wrappers__chains_that_cannot_be(chain: list[Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        w.apply_wrappers(fake(), chain)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (lambda env: w.PreviousObservation(env, variables=["core"]),
            "PreviousObservation has no argument 'variables'; "),
        (lambda env: w.CyclicTime(env, field=["hour"]), "CyclicTime has no argument 'field'; did you mean 'fields'"),
        (w.PreviousObservation, "PreviousObservation: missing a required argument: 'names'"),
        (lambda env: w.PreviousObservation(env, "core"),
            r"PreviousObservation: a list of names expected, such as \['core'\], got 'core'"),
        (lambda env: w.PreviousObservation(env, 3), "PreviousObservation: a list of names expected, got 3"),
        (lambda env: w.MetricObservation(env, "power"), r"a list of names expected, such as \['power'\], got 'power'"),
        (lambda env: w.RewardVector(env, [3]), r"RewardVector: a list of names expected, got \[3\]"),
        (lambda env: w.SetpointDifference(env, [["core", "cool"]]),
            r"SetpointDifference: pairs: {name: \[temperature, setpoint\]} expected, got \[\['core', 'cool'\]\]"),
        (lambda env: w.SetpointDifference(env, {"core": 3}), "'core' should be a pair"),
        (lambda env: w.TimeSeriesObservation(env, ["price"]), "signals: {name: number or time series} expected"),
        (lambda env: w.apply_wrappers(env, [{"wrapper": "SetpointDifference", "pairs": ["core", "cool"]}]),
            "SetpointDifference: pairs: {name:"),
    ],
)  # fmt: skip
def test_wrappers__arguments_that_cannot_be(wrong: Callable[[Any], Any], text: str) -> None:
    for env in (fake(), fakes()):
        with pytest.raises(InvalidConfig, match=text):
            wrong(env)


@pytest.mark.parametrize("low", [-1, -1.0, [-1.0, -0.5]])
def test_wrappers__bounds_of_gymnasiums_wrappers_are_plain_numbers(low: Any) -> None:
    chain = [{"wrapper": "RescaleAction", "min_action": low, "max_action": 1.0}]
    for bare in (fake(), fakes()):
        env = w.apply_wrappers(bare, chain)
        assert env.action_space.dtype == np.float32
        assert np.broadcast_to(env.action_space.low, (2, 2))[1].tolist() == np.broadcast_to(low, 2).tolist()
        assert w.wrappers_of(env) == chain


def test_wrappers__wrapper_without_a_vector_form_and_one_that_is_no_data() -> None:
    with pytest.raises(InvalidConfig, match="FrameStackObservation has no vector form; use a single environment"):
        w.apply_wrappers(fakes(), [{"wrapper": "FrameStackObservation", "stack_size": 2}])
    plain = fake()
    lambdas = TransformObservation(plain, lambda o: o, plain.observation_space)
    with pytest.raises(InvalidConfig, match="TransformObservation cannot be written as data"):
        w.wrappers_of(lambdas)
    with pytest.raises(InvalidConfig, match="ChangingContext: schedule: function cannot be written as data"):
        w.wrappers_of(w.ChangingContext(fake(), lambda time, random: {}))


# Names


def test_wrappers__names_at_every_level() -> None:
    inner = w.PreviousObservation(fake(), ["core"])
    outer = w.ReducedObservation(NormalizeObservation(inner), ["previous_core", "hour"])
    assert inner.observation_names == (*NAMES, "previous_core")
    assert outer.get_wrapper_attr("observation_names") == ("previous_core", "hour")
    assert w.names_of(outer.env) == inner.observation_names
    assert w.names_of(outer) == w.names_of(NormalizeReward(outer)) == ("previous_core", "hour")
    assert outer.observation_dict([1.0, 2.0]) == {"previous_core": 1.0, "hour": 2.0}
    assert w.names_of(w.IncrementalAction(inner, {"cool": 1}, {"cool": 26})) == inner.observation_names
    assert w.names_of(TimeAwareObservation(TimeLimit(fake(), 99))) == (*NAMES, "time")
    assert w.names_of(FlattenObservation(inner)) == inner.observation_names
    assert w.names_of(gym.wrappers.vector.NormalizeObservation(w.CyclicTime(fakes(), ["hour"])))[-1] == "hour_cos"
    with pytest.raises(InvalidConfig, match="after FrameStackObservation values have no names"):
        w.names_of(FlattenObservation(FrameStackObservation(inner, 2)))

    class Strange(gym.ObservationWrapper[Any, Any, Any]):
        def observation(self, observation: Any) -> Any:
            return observation[::-1]

    with pytest.raises(InvalidConfig, match="after Strange values have no names; give its class `observation_names`"):
        w.names_of(Strange(inner))


def test_wrappers__action_names() -> None:
    assert w.action_names_of(w.CyclicTime(fake())) == ("heat", "cool")
    moved = w.apply_wrappers(fake(), CHAINS["DiscreteIncrementalAction"])
    assert w.action_names_of(w.CyclicTime(moved)) == ("cool",)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda env: w.PreviousObservation(env, ["cor"]),
        lambda env: w.ReducedObservation(env, ["core", "cor"]),
        lambda env: w.SetpointDifference(env, {"excess": ("cor", "core_setpoint")}),
    ],
)
def test_wrappers__name_that_is_not_there_has_near_names(wrong: Callable[[Any], Any]) -> None:
    with pytest.raises(InvalidConfig, match="no observation 'cor'; did you mean 'core'"):
        wrong(fake())


def test_wrappers__name_that_is_there_already() -> None:
    with pytest.raises(InvalidConfig, match="the observation already has 'core'"):
        w.SetpointDifference(fake(), {"core": ("core", "core_setpoint")})
    with pytest.raises(InvalidConfig, match="'core' is listed twice"):
        w.ReducedObservation(fake(), ["core", "core"])


# State


def trained(env: Any) -> Any:
    env.reset(seed=1)
    env.action_space.seed(1)
    for _ in range(30):
        *_, truncated, _ = env.step(env.action_space.sample())
        if not env.unwrapped.__class__.__name__.endswith("VectorEnv") and truncated:
            env.reset()
    return env


@pytest.mark.variants
@pytest.mark.parametrize("vectors", [False, True])
@each_chain
def test_wrappers__chain_goes_on_where_it_was(chain: list[dict[str, Any]], vectors: bool, tmp_path: Path) -> None:
    def make() -> Any:
        bare = fakes() if vectors else fake()
        return w.apply_wrappers(bare, [*chain, {"wrapper": "NormalizeObservation"}])

    first, second = trained(make()), make()
    w.save_wrappers(first, tmp_path / "state.yaml")
    w.restore_wrappers(second, tmp_path / "state.yaml")
    w.save_wrappers(second, tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_text() == (tmp_path / "state.yaml").read_text()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["again.yaml", "state.yaml"]
    actions = [first.action_space.sample() for _ in range(20)]
    second.reset(seed=3)
    w.restore_wrappers(second, tmp_path / "state.yaml")
    for env in (first, second):
        bases = env.unwrapped.envs if vectors else [env.unwrapped]
        for base in bases:
            base.np_random = np.random.default_rng(5)
    ends = []
    for env in (first, second):
        outputs = [env.reset()[0].tobytes()]
        for action in actions:
            observation, reward, *_ = env.step(action)
            outputs += [observation.tobytes(), np.asarray(reward).tobytes()]
        ends.append(outputs)
    assert ends[0] == ends[1]


def test_wrappers__statistics_of_a_vector_serve_one_environment(tmp_path: Path) -> None:
    chain = [*CHAINS["PreviousObservation"], {"wrapper": "NormalizeObservation"}]
    many = trained(w.apply_wrappers(fakes(3), chain))
    w.save_wrappers(many, tmp_path / "state.yaml")
    one = w.apply_wrappers(fake(), chain)
    w.restore_wrappers(one, tmp_path / "state.yaml")
    assert one.obs_rms.mean.tolist() == many.obs_rms.mean.tolist()
    assert one.obs_rms.count == many.obs_rms.count > 90
    slots = SyncVectorEnv([lambda: NormalizeObservation(fake())] * 2)
    trained(slots)
    w.save_wrappers(slots, tmp_path / "slots.yaml")
    fresh = SyncVectorEnv([lambda: NormalizeObservation(fake())] * 2)
    w.restore_wrappers(fresh, tmp_path / "slots.yaml")
    assert fresh.envs[1].obs_rms.mean.tolist() == slots.envs[1].obs_rms.mean.tolist()  # type: ignore[attr-defined]


def test_wrappers__state_of_another_chain_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "state.yaml"
    w.save_wrappers(trained(NormalizeObservation(fake())), path)
    other = NormalizeObservation(w.PreviousObservation(fake(), ["core"]))
    with pytest.raises(
        InvalidConfig, match="has the wrappers NormalizeObservation; this chain has NormalizeObservation, Prev"
    ):
        w.restore_wrappers(other, path)
    longer = NormalizeObservation(w.CyclicTime(fake()))
    before = longer.obs_rms.mean.tolist()
    path.write_text(path.read_text().replace("wrappers:", "wrappers:\n", 1))
    with pytest.raises(InvalidConfig, match="this chain has NormalizeObservation, CyclicTime"):
        w.restore_wrappers(longer, path)
    few = NormalizeObservation(TransformObservation(fake(), lambda o: o[:2], gym.spaces.Box(-np.inf, np.inf, (2,))))
    with pytest.raises(InvalidConfig, match=r"does not fit: .*shape \(2,\), not \(9,\)"):
        w.restore_wrappers(few, path)
    assert (longer.obs_rms.mean.tolist(), few.obs_rms.mean.tolist()) == (before, [0.0, 0.0])
    one, two = (NormalizeReward(w.PreviousObservation(fake(), names)) for names in (["core"], ["core", "hour"]))
    w.save_wrappers(trained(one), path)
    with pytest.raises(InvalidConfig, match="does not fit: not a state of PreviousObservation"):
        w.restore_wrappers(two, path)
    assert two.return_rms.count < 1, "what had been taken over was given back"
    with pytest.raises(InvalidConfig, match="there is no file"):
        w.restore_wrappers(few, tmp_path / "none.yaml")


def test_wrappers__help_shows_what_a_wrapper_takes() -> None:
    import inspect

    assert str(inspect.signature(w.PreviousObservation)).startswith("(env, names: ")
    assert "fields" in (w.CyclicTime.__doc__ or "")
    assert [*inspect.signature(w.WeatherForecast).parameters] == ["env", "columns", "n", "spacing_h", "errors"]


def test_wrappers__one_class_wraps_single_and_vector_environments() -> None:
    one, many = w.CyclicTime(fake(), ["hour"]), w.CyclicTime(fakes(2), ["hour"])
    assert isinstance(one, w.CyclicTime)
    assert isinstance(one, gym.Wrapper)
    assert not isinstance(one, gym.vector.VectorEnv)
    assert isinstance(many, w.CyclicTime)
    assert isinstance(many, gym.vector.VectorWrapper)
    assert not isinstance(many, gym.Env)
    assert type(one).__name__ == type(many).__name__ == "CyclicTime"
    assert type(one) is type(w.CyclicTime(fake())), "one class for each kind of environment, not one for each wrapper"
    assert isinstance(w.CyclicTime(env=fakes(1)), gym.vector.VectorWrapper)
    bases = (w.BuildingWrapper, w.MeansLog)
    ours = [kind for name in w.__all__ if isinstance(kind := getattr(w, name), type) and kind not in bases]
    assert len(ours) == 16
    assert all(issubclass(kind, w.BuildingWrapper) for kind in ours)


def test_wrappers__subclass_of_a_wrapper_wraps_both_and_overrides_both() -> None:
    class Closed(w.CyclicTime):
        def close(self, **more: Any) -> None:
            closed.append(self.env)
            super().close(**more)

    closed: list[Any] = []
    for env in (fake(), fakes(2)):
        wrapped = Closed(env, fields=["hour"])
        assert isinstance(wrapped, gym.vector.VectorWrapper) == isinstance(env, gym.vector.VectorEnv)
        wrapped.close()
        assert closed.pop() is env


def test_wrappers__wrapper_can_be_copied() -> None:
    for env in (fake(), fakes(2)):
        wrapped = w.PreviousObservation(env, ["core"])
        assert type(copy.copy(wrapped)) is type(wrapped)


def test_wrappers__environment_that_is_no_building() -> None:
    cart = gym.make("CartPole-v1")
    with pytest.raises(
        InvalidConfig, match="has no 'observation_names'; wrap an environment with an id under zenostat/"
    ):
        w.PreviousObservation(cart, ["x"])
    seen: Mapping[str, Any] = vars(w)
    assert "eval" not in seen


def test_numeric_infos__leave_numbers_in_gymnasiums_form() -> None:
    day = {"zones": 1, "steps_per_hour": 1, "begin": "07-03", "end": "07-03"}
    plain, inner = (FakeVectorEnv(2, autoreset_mode=AutoresetMode.SAME_STEP, **day) for _ in range(2))
    vector = w.NumericInfos(inner)
    _, infos = vector.reset(seed=0)
    plain.reset(seed=0)
    assert all(np.asarray(value).dtype.kind in "biuf" for value in infos.values())
    assert {"effective", "_effective", "step", "reward_terms.energy"} <= infos.keys()
    assert not infos.keys() & {"action", "time", "reward_terms", "value_source", "weather"}
    ended = False
    while not ended:
        action = plain.action_space.sample()
        *_, before = plain.step(action)
        _, _, terminated, truncated, infos = vector.step(action)
        ended = bool((terminated | truncated).all())
        assert np.array_equal(infos["reward_terms.energy"], before["reward_terms"]["energy"], equal_nan=True)
    assert np.array_equal(infos["final_obs"][1], before["final_obs"][1])
    assert np.array_equal(infos["final_info"]["effective"], before["final_info"]["effective"])
    assert "time" not in infos["final_info"]
