"""Requirements of other libraries: errors of their kind, infos of one form, and their own collectors."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from support.nodes import SMALL

import zenostat  # noqa: F401  # registers the environments
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.topics.errors import InvalidConfig
from zenostat.wrappers import NumericInfos

DAY: dict[str, Any] = {"zones": 1, "steps_per_hour": 1, "begin": "07-03", "end": "07-03"}
WARM = [{"points": ["zone_1_air_temperature"], "low": 0.0, "high": 60.0}]
HOT = [{"points": ["zone_1_air_temperature"], "low": 17.0, "high": 24.0}]
BESIDE: dict[str, Any] = {"equipment_control": True, "actions": {"cooling": ["zone_1_cooling_setpoint"]}}


def form(info: Any) -> Any:
    """The keys of an info, and types and shapes of what it holds."""
    if isinstance(info, Mapping):
        return {key: form(value) for key, value in info.items()}
    return (type(info).__name__, np.shape(info)) if isinstance(info, np.ndarray | float) else type(info).__name__


def own_reward(values: Mapping[str, Any], begin: Any) -> dict[str, Any]:
    return {"heat": -values["outdoor_temperature"]}


@pytest.mark.parametrize(
    "arguments",
    [{}, {"terminate": WARM}, {"reward": None}, {"reward": {"kind": "peak"}}, {"reward": own_reward}, BESIDE],
    ids=["plain", "limits", "no reward", "peak", "own reward", "beside"],
)
def test_environment__infos_of_reset_and_step_have_one_form(arguments: dict[str, Any]) -> None:
    env = FakeEnv(**DAY, **arguments)
    expected, ended = form(env.reset(seed=0)[1]), False
    while not ended:
        _, _, _, ended, info = env.step(env.action_space.sample())
        assert form(info) == expected
    assert form(env.reset()[1]) == expected


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
def test_environment__infos_of_a_vector_have_one_form(mode: AutoresetMode) -> None:
    env = FakeVectorEnv(3, autoreset_mode=mode, terminate=HOT, **DAY)
    env.action_space.seed(0)
    keys, ends = set(env.reset(seed=0)[1]), 0
    for _ in range(40):
        _, _, terminated, truncated, infos = env.step(env.action_space.sample())
        ended = terminated | truncated
        ends += int(ended.sum())
        assert set(infos) - {"final_obs", "_final_obs", "final_info", "_final_info"} == keys
        assert all(infos[key].all() for key in keys if key.startswith("_"))
        if mode is AutoresetMode.SAME_STEP and ended.any():
            assert set(infos["final_info"]) == keys
        if mode is AutoresetMode.DISABLED and ended.any():
            assert set(env.reset(options={"reset_mask": ended})[1]) == keys
    assert ends > 3


@pytest.mark.slow
def test_environment__infos_of_a_real_building_have_one_form(scratch: Path) -> None:
    settings = {**SMALL, "end": SMALL["begin"], "output_dir": scratch / "kept", "affinity": "off"}
    with gym.make("zenostat/Building-v1", **settings) as env:
        expected, ended = form(env.reset(seed=0)[1]), False
        while not ended:
            _, _, _, ended, info = env.step(env.action_space.sample())
            assert form(info) == expected
    assert (Path(info["output_dir"]) / "eplusout.err").is_file()


def test_info_action__is_nan_for_actuators_that_no_action_sets() -> None:
    """A context shows in the effective values, in the step that first has it as in all others."""
    env, vector = FakeEnv(**DAY, **BESIDE), FakeVectorEnv(2, **DAY, **BESIDE)
    at = [actuator.name for actuator in env.manifest.actuators].index
    assert np.isnan(env.reset(seed=0)[1]["action"]).all()
    assert np.isnan(vector.reset(seed=0)[1]["action"]).all()
    for context in (None, 0.5, None):
        if context is not None:
            env.set_context({"equipment": context})
            vector.envs[1].set_context({"equipment": context})
        *_, info = env.step(np.array([27.0], np.float32))
        *_, infos = vector.step(np.full((2, 1), 27.0, np.float32))
        for row in (info["action"], *infos["action"]):
            assert row[at("zone_1_cooling_setpoint")] == 27.0
            assert np.isnan(row[[at("zone_1_heating_setpoint"), at("equipment")]]).all()
        if context is not None:
            assert info["effective"][at("equipment")] == infos["effective"][1, at("equipment")] == context


@pytest.mark.parametrize(
    "make",
    [
        lambda **arguments: gym.make(
            "zenostat/Building-v1", building="office-small", weather="USA_CO_Denver", **arguments
        ),
        lambda **arguments: gym.make("zenostat/office-small-USA_CO_Denver-continuous-v1", **arguments),
        lambda **arguments: gym.make_vec("zenostat/office-small-USA_CO_Denver-continuous-v1", num_envs=2, **arguments),
        lambda **arguments: gym.make("zenostat/Fake-v1", **arguments),
        lambda **arguments: gym.make_vec("zenostat/Fake-v1", num_envs=2, **arguments),
    ],
    ids=["building", "scenario", "vector", "fake", "fake vector"],
)
def test_environment__unknown_keyword_is_a_type_error(make: Any) -> None:
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
        make(frameskip=1)


def test_environment__unknown_keyword_is_a_usage_error_with_near_names() -> None:
    with pytest.raises(InvalidConfig, match="unexpected keyword argument 'wheather'; did you mean 'weather'"):
        gym.make("zenostat/Building-v1", building="office-small", wheather="USA_CO_Denver")


def test_environment__vector_tells_its_autoreset_mode() -> None:
    env = gym.make_vec("zenostat/Fake-v1", num_envs=2, autoreset_mode="SameStep")
    assert env.unwrapped.autoreset_mode is env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP  # type: ignore[attr-defined]


@pytest.mark.slow
def test_environment__action_is_a_list_of_actuators_on_a_real_building(scratch: Path) -> None:
    cooling = ["core_zn_cooling_setpoint", "perimeter_zn_1_cooling_setpoint"]
    settings = {**SMALL, "end": SMALL["begin"], "affinity": "off"}
    with gym.make("zenostat/Building-v1", actions={"cooling": cooling}, **settings) as env:
        env.reset(seed=0)
        *_, info = env.step(np.array([27.0], np.float32))
        commanded = zip(env.unwrapped.manifest.actuators, info["action"], strict=True)  # type: ignore[attr-defined]
        assert [actuator.name for actuator, value in commanded if value == 27.0] == cooling


def fake() -> Any:
    return FakeEnv(**DAY)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_environment__torchrl_checks_and_collects() -> None:
    envs = pytest.importorskip("torchrl.envs")
    collectors = pytest.importorskip("torchrl.collectors")
    env = envs.GymEnv("zenostat/Fake-v1", **DAY)
    envs.check_env_specs(env)
    collector = collectors.Collector(env, frames_per_batch=30, total_frames=60)
    assert [batch["next", "reward"].shape[0] for batch in collector] == [30, 30]
    collector.shutdown()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_environment__torchrl_steps_a_vector_that_it_resets_itself() -> None:
    """24 timesteps an episode: in 30 steps TorchRL has reset both slots once."""
    envs = pytest.importorskip("torchrl.envs")
    env = envs.GymWrapper(gym.make_vec("zenostat/Fake-v1", num_envs=2, autoreset_mode="Disabled", **DAY))
    envs.check_env_specs(env)
    steps = env.rollout(30, break_when_any_done=False)
    assert tuple(steps.batch_size) == (2, 30)
    assert steps["next", "done"].sum(1).flatten().tolist() == [1, 1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_environment__torchrl_steps_a_vector_that_resets_itself() -> None:
    envs = pytest.importorskip("torchrl.envs")
    vector = gym.make_vec("zenostat/Fake-v1", num_envs=2, autoreset_mode="SameStep", **DAY)
    env = envs.GymWrapper(NumericInfos(vector))
    envs.check_env_specs(env)
    steps = env.rollout(30, break_when_any_done=False)
    assert steps["next", "done"].sum(1).flatten().tolist() == [1, 1]
    assert tuple(steps["next", "reward_terms.energy"].shape) == (2, 30)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_environment__torchrl_makes_a_vector_of_its_own(tmp_path: Path) -> None:
    envs = pytest.importorskip("torchrl.envs")
    scenario = {**SMALL, "end": SMALL["begin"], "steps_per_hour": 1, "wrappers": [{"wrapper": "NumericInfos"}]}
    (tmp_path / "office.yaml").write_text(json.dumps(scenario))
    env = envs.GymEnv("zenostat:zenostat/Building-v1", num_envs=2, file=str(tmp_path / "office.yaml"))
    try:
        envs.check_env_specs(env)
        steps = env.rollout(30, break_when_any_done=False)
    finally:
        env.close()
    assert steps["next", "done"].sum(1).flatten().tolist() == [1, 1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_environment__minari_collects_with_infos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    minari = pytest.importorskip("minari")
    pytest.importorskip("jax")
    collector = minari.DataCollector(fake(), record_infos=True)
    for seed in range(2):
        collector.reset(seed=seed)
        ended = False
        while not ended:
            _, _, _, ended, _ = collector.step(collector.action_space.sample())
    dataset = collector.create_dataset(dataset_id="zenostat/fake-v0", algorithm_name="random", author="test")
    episodes = list(dataset.iterate_episodes())
    assert [len(episode) for episode in episodes] == [24, 24]
    assert len(episodes[0].infos["effective"]) == 25
    collector.close()
