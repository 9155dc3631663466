"""A vector environment as stable-baselines3 takes it: equal to its own vector of single environments."""

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import NormalizeReward, RecordEpisodeStatistics
from support.nodes import SMALL
from support.run_cli import run_python

import zenostat  # noqa: F401  # registers the environments
from zenostat import wrappers as w
from zenostat.agent_sdk.testing import Climate, FakeEnv
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.agent_sdk.wrappers import CyclicTime
from zenostat.topics.errors import EpisodeChanged, InvalidConfig

pytest.importorskip("stable_baselines3")
torch = pytest.importorskip("torch")

from stable_baselines3 import PPO, SAC  # noqa: E402
from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.monitor import Monitor  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize  # noqa: E402

from zenostat.agent_sdk.envs.sb3_vec_env import SlotsVecEnv, as_sb3  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")

SAME = AutoresetMode.SAME_STEP
WARM = {"points": ["zone_1_air_temperature"], "low": 17.0, "high": 26.0, "duration_h": 2.0}
LAST = {"points": ["outdoor_temperature"], "low": 90.0, "duration_h": 24.0}  # broken with an episode's last step
DAY: dict[str, Any] = {"zones": 2, "steps_per_hour": 1, "climate": Climate(noise_k=3.0), "control": "building"}


def fakes(count: int = 3, **arguments: Any) -> SlotsVecEnv:
    return as_sb3(FakeVectorEnv(count, autoreset_mode=SAME, **{**DAY, **arguments}))


def apart(count: int = 3, **arguments: Any) -> DummyVecEnv:
    return DummyVecEnv([lambda: FakeEnv(**{**DAY, **arguments}) for _ in range(count)])


def same(one: Any, other: Any) -> bool:
    """Infos of both, with their arrays."""
    if isinstance(one, dict):
        return set(one) == set(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    if isinstance(one, float) and np.isnan(one):  # as within arrays
        return isinstance(other, float) and bool(np.isnan(other))
    return (type(one) is type(other) and one == other) or (isinstance(other, np.generic) and one == other.item())


@pytest.mark.variants
@pytest.mark.parametrize(
    "form", [{}, {"terminate": [WARM]}, {"discrete": 4, "terminate": [WARM]}, {"terminate": [LAST]}], ids=str
)
def test_sb3_vec_env__it_is_equal_to_a_dummy_vec_env(form: dict[str, Any]) -> None:
    """Observations, rewards, dones and infos, through the ends of episodes; some cut by time, some by a limit."""
    ours, theirs = fakes(**form), apart(**form)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.seed(5) == theirs.seed(5)
    ours.action_space.seed(1)
    assert np.array_equal(ours.reset(), theirs.reset())
    assert all(map(same, ours.reset_infos, theirs.reset_infos))
    ends, cut = 0, []
    for _ in range(60):
        actions = np.array([ours.action_space.sample() for _ in range(3)])
        one, other = ours.step(actions), theirs.step(actions)
        for mine, its in zip(one[:3], other[:3], strict=True):
            assert mine.dtype == its.dtype
            assert mine.tobytes() == its.tobytes()
        assert all(map(same, one[3], other[3]))
        assert all(map(same, ours.reset_infos, theirs.reset_infos))
        ends += one[2].sum()
        cut += [info["TimeLimit.truncated"] for info, done in zip(one[3], one[2], strict=True) if done]
    assert ends == len(cut) >= 6
    whose = form.get("terminate", [None])[0]
    assert set(cut) == ({True} if whose is None else {False} if whose is LAST else {True, False})
    assert ours.reset().tobytes() == theirs.reset().tobytes(), "seeds serve once"


def test_sb3_vec_env__attributes_and_methods_of_slots() -> None:
    ours, theirs = fakes(equipment_control=True), apart(equipment_control=True)
    for env in (ours, theirs):
        env.seed(1)
        env.reset()
    assert ours.get_attr("observation_names") == theirs.get_attr("observation_names")
    assert ours.get_attr("action_space", [0, 2]) == theirs.get_attr("action_space", [0, 2])
    assert [m.building for m in ours.get_attr("manifest")] == ["fake"] * 3
    assert not ours.has_attr("colour")
    ours.set_attr("colour", "red", 1)
    assert ours.get_attr("colour", 1) == ["red"]
    weather = [env.env_method("weather", ["dry_bulb_temperature"], indices=[2]) for env in (ours, theirs)]
    assert weather[0] == weather[1]
    for name in ("observation_names", "colour"):
        has = [env.env_method("has_wrapper_attr", name, indices=[0, 2]) for env in (ours, theirs)]
        assert has[0] == has[1] == [name == "observation_names"] * 2
    names = [env.env_method("get_wrapper_attr", "observation_names") for env in (ours, theirs)]
    assert names[0] == names[1]
    assert ours.metadata == ours.env.metadata
    assert ours.env_is_wrapped(Monitor) == [False] * 3
    assert (ours.render_mode, ours.num_envs) == (None, 3)


def test_sb3_vec_env__attributes_of_wrappers_are_set_where_they_are_read() -> None:
    """Around the vector, or around each environment of a vector of single ones; as in a DummyVecEnv."""

    def single() -> Any:
        return gym.wrappers.NormalizeReward(w.CyclicTime(FakeEnv(time=("hour",), **DAY), ["hour"]))

    inner = FakeVectorEnv(2, autoreset_mode=SAME, time=("hour",), **DAY)
    around = as_sb3(NormalizeReward(w.CyclicTime(inner, ["hour"])))
    theirs, within = DummyVecEnv([single] * 2), as_sb3(SyncVectorEnv([single] * 2, autoreset_mode=SAME))
    for env in (around, within, theirs):
        assert env.get_attr("observation_names", 1)[0][-1] == "hour_cos"
        assert [manifest.building for manifest in env.get_attr("manifest")] == ["fake"] * 2
        assert env.env_method("has_wrapper_attr", "manifest") == [True] * 2
        env.set_attr("update_running_mean", False)
        assert env.get_attr("update_running_mean") == [False] * 2
        env.reset()
        counts = [statistics.count for statistics in env.get_attr("return_rms")]
        env.step(np.stack([env.action_space.sample()] * 2))
        assert [statistics.count for statistics in env.get_attr("return_rms")] == counts
        assert env.env_method("set_wrapper_attr", "gamma", 0.5) == [True] * 2
        assert env.env_method("set_wrapper_attr", "colour", "red", force=False) == [False] * 2
        assert env.get_attr("gamma") == [0.5] * 2
        assert not env.has_attr("colour")
    for env in (within, theirs):
        env.set_attr("gamma", 0.25, 1)
        assert env.get_attr("gamma") == [0.5, 0.25]
    for setter in (around.set_attr, partial(around.env_method, "set_wrapper_attr")):
        with pytest.raises(InvalidConfig, match="'gamma' belongs to NormalizeReward, which is around all slots"):
            setter("gamma", 0.25, indices=[1])
    assert around.get_attr("gamma") == [0.5] * 2


def test_sb3_vec_env__gymnasiums_own_statistics_stand_in_the_info_of_the_end() -> None:
    envs = RecordEpisodeStatistics(FakeVectorEnv(2, zones=1, steps_per_hour=1, autoreset_mode=AutoresetMode.SAME_STEP))
    env = as_sb3(envs)
    env.reset()
    earned = np.zeros(2)
    for _ in range(24):
        _, rewards, ended, infos = env.step(np.array([env.action_space.sample()] * 2))
        earned += rewards
    assert ended.all()
    for slot, info in enumerate(infos):
        assert info["episode"]["l"] == 24
        assert info["episode"]["r"] == pytest.approx(earned[slot], rel=1e-5)
        assert "episode" not in env.reset_infos[slot]
    env.close()


def test_sb3_vec_env__wrappers_around_the_vector_are_seen() -> None:
    inner = FakeVectorEnv(2, autoreset_mode=SAME, time=("hour",), **DAY)
    env = as_sb3(CyclicTime(inner, ["hour"]))
    assert env.get_attr("observation_names", 1)[0][-1] == "hour_cos"
    assert env.env_is_wrapped(CyclicTime, 0) == [True]
    assert env.observation_space == env.get_attr("observation_space")[0]
    single = DummyVecEnv([lambda: w.CyclicTime(FakeEnv(time=("hour",), **DAY), ["hour"])] * 1)
    for one in (env, single):
        one.seed(3)
    assert env.reset()[0].tobytes() == single.reset()[0].tobytes()
    for _ in range(25):
        action = env.action_space.sample()
        seen, _, ended, infos = env.step(np.stack([action, action]))
        alone, _, _, single_infos = single.step(action[None])
        assert seen[0].tobytes() == alone[0].tobytes()
        assert same(infos[0], single_infos[0])
    assert not ended.any()


def test_sb3_vec_env__pictures() -> None:
    pytest.importorskip("matplotlib")
    ours, theirs = fakes(2, render_mode="rgb_array"), apart(2, render_mode="rgb_array")
    for env in (ours, theirs):
        env.seed(1)
        env.reset()
    assert np.array_equal(ours.render(), theirs.render())


def test_sb3_vec_env__what_cannot_be() -> None:
    with pytest.raises(InvalidConfig, match=r"autoreset_mode is AutoresetMode\.NEXT_STEP: make it with"):
        as_sb3(FakeVectorEnv(2, **DAY))
    env = fakes(2)
    with pytest.raises(EpisodeChanged, match=r"step_async\(\)"):
        env.step_wait()
    env.set_options([{"a": 1}, {}])
    with pytest.raises(InvalidConfig, match="differ between slots"):
        env.reset()
    env.set_options({"a": 1})
    with pytest.raises(InvalidConfig, match="unknown reset options"):
        env.reset()
    env.set_options()
    env.reset()
    env.close()
    env.close()


def test_sb3_vec_env__without_stable_baselines_it_states_what_to_install() -> None:
    program = "import sys; sys.modules['stable_baselines3'] = None\nimport zenostat.agent_sdk.envs.sb3_vec_env"
    done = run_python("-c", program)
    assert "[train]'" in done.stderr


# Algorithms


def test_sb3_vec_env__ppo_learns_the_same_weights_as_on_a_dummy_vec_env() -> None:
    learnt = []
    for env in (fakes(4, terminate=[WARM]), apart(4, terminate=[WARM])):
        scaled = VecNormalize(VecMonitor(env))
        model = PPO("MlpPolicy", scaled, n_steps=32, batch_size=32, n_epochs=2, seed=0, device="cpu")
        before = {name: value.clone() for name, value in model.policy.state_dict().items()}
        model.learn(256)
        after = model.policy.state_dict()
        assert any(not torch.equal(before[name], after[name]) for name in before)
        assert len(model.ep_info_buffer) >= 8
        learnt.append(after)
    assert all(torch.equal(learnt[0][name], learnt[1][name]) for name in learnt[0])


def test_sb3_vec_env__evaluation_by_stable_baselines() -> None:
    model = SAC("MlpPolicy", fakes(2), learning_starts=16, batch_size=16, buffer_size=200, device="cpu", seed=0)
    model.learn(40)
    evaluations = []
    for env in (VecMonitor(fakes(2)), VecMonitor(apart(2))):
        env.seed(1)
        evaluations.append(evaluate_policy(model, env, n_eval_episodes=4, return_episode_rewards=True))
    assert evaluations[0] == evaluations[1]
    assert evaluations[0][1] == [24] * 4


@pytest.mark.slow
def test_sb3_vec_env__ppo_learns_on_the_slots_of_a_node(scratch: Path) -> None:
    """Through the end of an episode; the same seed gives the same weights."""
    learnt = []
    for _ in range(2):
        env = gym.make_vec(
            "zenostat/Building-v1",
            num_envs=2,
            **{**SMALL, "steps_per_hour": 1},
            affinity="off",
            control="building",
            autoreset_mode="SameStep",
        )
        scaled = as_sb3(gym.wrappers.vector.RescaleAction(env, np.float32(-1.0), np.float32(1.0)))
        model = PPO("MlpPolicy", VecNormalize(VecMonitor(scaled)), n_steps=32, batch_size=32, seed=0, device="cpu")
        try:
            model.learn(64)
        finally:
            env.close()
        assert [episode["l"] for episode in model.ep_info_buffer] == [24, 24]
        learnt.append(model.policy.state_dict())
    assert all(torch.equal(learnt[0][name], learnt[1][name]) for name in learnt[0])
