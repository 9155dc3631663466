"""stable-baselines3 on buildings: its algorithms, the evaluation that leaves a training alone, its models."""

import random
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.builders import manifest
from support.nodes import SMALL
from support.run_cli import run_python

import zenostat  # noqa: F401  # registers the environments
from zenostat.agent_sdk.testing import Climate, FakeBuilding, FakeEnv, FakeLink
from zenostat.lab.evaluate import evaluate
from zenostat.topics.errors import InvalidConfig, UnknownName

pytest.importorskip("stable_baselines3")
torch = pytest.importorskip("torch")

from stable_baselines3 import A2C, DQN, PPO, SAC, TD3  # noqa: E402
from stable_baselines3.common.env_checker import check_env  # noqa: E402
from stable_baselines3.common.logger import KVWriter, Logger  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnvWrapper, VecNormalize  # noqa: E402

from zenostat.lab.training import EvaluationCallback, PolicyController, evaluate_model, load_policy  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")

NET = {"net_arch": [8, 8]}  # given as a copy: SAC and TD3 write into it
OFF_POLICY = {"learning_starts": 32, "batch_size": 16, "buffer_size": 1000, "train_freq": 8}
ALGORITHMS: dict[str, tuple[Any, dict[str, Any]]] = {
    "ppo": (PPO, {"n_steps": 64, "batch_size": 32, "n_epochs": 2}),
    "a2c": (A2C, {"n_steps": 16}),
    "sac": (SAC, OFF_POLICY),
    "td3": (TD3, OFF_POLICY),
    "dqn": (DQN, OFF_POLICY),
}


def weights(model: Any) -> dict[str, Any]:
    return {name: value.clone() for name, value in model.policy.state_dict().items()}


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return list(one) == list(other) and all(torch.equal(one[name], other[name]) for name in one)


def real(name: str, **arguments: Any) -> gym.Env[Any, Any]:
    form = {"discrete": 5} if name == "dqn" else {}
    return gym.make("zenostat/Building-v1", **{**SMALL, **form, "control": "building", "affinity": "off", **arguments})


def fake(**arguments: Any) -> gym.Env[Any, Any]:
    """A day of two rooms, in steps of an hour, with noise on the weather."""
    settings = {"zones": 2, "begin": "07-03", "steps_per_hour": 1, "climate": Climate(noise_k=2.0)}
    return FakeEnv(**{**settings, **arguments})


def scaled(**arguments: Any) -> gym.Env[Any, Any]:
    """Scale the actions to -1 to 1: an untrained PPO draws around 0, which in degC is always the lower bound."""
    env = fake(**arguments)
    low, high = env.action_space.low, env.action_space.high
    wider = gym.spaces.Box(np.float32(-1.0), np.float32(1.0), low.shape)
    return gym.wrappers.TransformAction(env, lambda a: np.clip(low + 0.5 * (a + 1) * (high - low), low, high), wider)


def ppo(env: Any, **arguments: Any) -> Any:
    settings = {"n_steps": 48, "batch_size": 24, "n_epochs": 2, "policy_kwargs": dict(NET), "seed": 3, "device": "cpu"}
    return PPO("MlpPolicy", env, **{**settings, **arguments})


@pytest.mark.slow
@pytest.mark.parametrize("name", ALGORITHMS)
def test_training__algorithms_learn_on_a_real_building(name: str, scratch: Path) -> None:
    algorithm, settings = ALGORITHMS[name]
    with real(name) as env:
        model = algorithm("MlpPolicy", env, policy_kwargs=dict(NET), seed=0, device="cpu", **settings)
        before = weights(model)
        model.learn(250)
        assert model.num_timesteps >= 250  # more than two episodes of 96 timesteps
        assert len(model.ep_info_buffer) >= 2
        after = weights(model)
        assert not same(before, after)
        assert all(bool(torch.isfinite(value).all()) for value in after.values())
        observation, _ = env.reset(seed=1)
        for _ in range(8):
            action, _ = model.predict(observation, deterministic=True)
            assert env.action_space.contains(action.item() if name == "dqn" else action)
            observation, *_ = env.step(action)
        model.save(scratch / "model.zip")
        (own,) = evaluate_model(model, env, seed=1)
    building = {**SMALL, "control": "building", "affinity": "off"} | ({"discrete": 5} if name == "dqn" else {})
    (row,) = evaluate(building, {"trained": f"{name}:{scratch / 'model.zip'}"}, seed=1).rows
    # `evaluate` also measures what this environment has no points for: end uses, gas and unmet hours.
    more = dict.fromkeys(("hvac_kwh", "kpis", "unmet_heating_h", "unmet_cooling_h"))
    assert replace(row.result, **more) == replace(own, **more)
    assert row.result.hvac_kwh["electricity"] == own.hvac_kwh["electricity"]
    measured = {kpi: value for kpi, value in own.kpis.items() if value is not None}
    assert {kpi: row.result.kpis[kpi] for kpi in measured} == measured


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ppo", "dqn"])
def test_training__checker_of_stable_baselines3_passes(name: str, scratch: Path) -> None:
    with real(name) as env, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=True)
    # Setpoints are in degC, not between -1 and 1: gymnasium.wrappers.RescaleAction makes them so.
    texts = [str(one.message) for one in warned if "symmetric and normalized Box action space" not in str(one.message)]
    assert texts == []
    assert len(warned) == (1 if name == "ppo" else 0)


# The callback


def steps_and_draws(env: gym.Env[Any, Any]) -> list[Any]:
    """Record a training's steps and draws in the list that is returned."""
    seen: list[Any] = []
    step, reset = env.step, env.reset

    def recorded(action: Any) -> Any:
        out = step(action)
        seen.append((np.asarray(action).tobytes(), out[0].tobytes(), out[1]))
        return out

    def begun(**arguments: Any) -> Any:
        out = reset(**arguments)
        seen.append(out[0].tobytes())
        return out

    env.step, env.reset = recorded, begun  # type: ignore[method-assign]
    return seen


@pytest.mark.variants
@pytest.mark.parametrize("name", ALGORITHMS)
def test_training__training_is_the_same_with_and_without_evaluations(name: str) -> None:
    algorithm, settings = ALGORITHMS[name]
    form = {"discrete": 5, "control": "building"} if name == "dqn" else {}

    def trained(*, evaluated: bool) -> tuple[Any, list[Any], tuple[Any, ...]]:
        make_env = fake if form else scaled
        env = make_env(**form)
        seen = steps_and_draws(env)
        model = algorithm("MlpPolicy", env, policy_kwargs=dict(NET), seed=0, device="cpu", **settings)

        def drawing() -> gym.Env[Any, Any]:
            _ = random.random(), np.random.random(), torch.rand(1)  # as somebody's wrapper may do it
            return make_env(**form)

        callback = EvaluationCallback(drawing, every=30, episodes=2, seed=11, at_start=True) if evaluated else None
        model.learn(120, callback=callback)
        if callback is not None:
            assert list(callback.results) == [0, 30, 60, 90, 120]
        return weights(model), seen, (random.random(), np.random.random(), torch.rand(1).item())

    plain, evaluated = trained(evaluated=False), trained(evaluated=True)
    assert same(plain[0], evaluated[0])
    assert plain[1] == evaluated[1]
    assert plain[2] == evaluated[2]  # the global generators stand at the same place


def test_training__resumed_before_its_first_step_has_one_evaluation_at_the_start() -> None:
    for best, evaluated in ((None, [0]), (-1.0, [])):
        callback = EvaluationCallback(fake, every=10**6, at_start=True)
        callback.best_reward = best  # as a checkpoint of step 0 has it
        with callback:
            PPO("MlpPolicy", fake(), n_steps=24, batch_size=24, n_epochs=1, seed=0).learn(24, callback=callback)
        assert [*callback.results] == evaluated


class Written(KVWriter):
    """A logger's output in memory."""

    def __init__(self) -> None:
        self.entries: list[tuple[int, dict[str, Any]]] = []

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, Any], step: int = 0) -> None:
        self.entries.append((step, dict(key_values)))

    def close(self) -> None:
        pass


def test_training__evaluations_are_logged_and_the_best_model_is_kept(tmp_path: Path) -> None:
    best, written, environments = tmp_path / "best.zip", Written(), []

    def make_env() -> gym.Env[Any, Any]:
        env = fake()
        environments.append(env)
        closed = env.close
        env.close = lambda: (environments.append("closed"), closed())[1]  # type: ignore[method-assign]
        return env

    model = ppo(fake(), n_steps=24)
    model.set_logger(Logger(None, [written]))
    callback = EvaluationCallback(make_env, every=50, episodes=2, seed=4, best_model_path=best)
    assert environments == []
    model.learn(192, callback=callback)
    assert len(environments) == 2
    assert environments[1] == "closed"
    logged = {step: values for step, values in written.entries if "eval/reward" in values}
    assert list(logged) == list(callback.results) == [50, 100, 150]
    for step, results in callback.results.items():
        assert logged[step]["eval/reward"] == pytest.approx(np.mean([r.reward for r in results]))
        assert logged[step]["eval/outside_percent"] == pytest.approx(np.mean([r.outside_percent for r in results]))
        assert {"eval/reward.comfort", "eval/electricity_kwh", "eval/mean_deviation_k"} <= set(logged[step])
    means = {step: float(np.mean([r.reward for r in of])) for step, of in callback.results.items()}
    assert callback.best_reward == max(means.values())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["best.zip"]
    # The file is the model that had that reward.
    again = evaluate_model(PPO.load(best, device="cpu"), fake(), episodes=2, seed=4)
    assert again == callback.results[max(means, key=means.__getitem__)]
    model.learn(50, callback=callback, reset_num_timesteps=False)
    assert list(callback.results) == [50, 100, 150, 200, 250]  # in a new environment, at multiples of the interval


def test_training__evaluations_are_of_the_reward_that_a_wrapper_pays() -> None:
    def doubled() -> gym.Env[Any, Any]:
        return gym.wrappers.TransformReward(scaled(), lambda reward: 3.0 - 2.0 * float(reward))

    model = ppo(scaled())
    (own,) = evaluate_model(model, scaled(), seed=5)
    (paid,) = evaluate_model(model, doubled(), seed=5)
    assert paid.reward == pytest.approx(3.0 * 24 - 2.0 * own.reward)
    assert paid.terms == own.terms
    (helped,) = evaluate_model(model, gym.wrappers.NormalizeReward(scaled()), seed=5)
    assert helped.reward == own.reward


def test_training__what_a_training_has_learnt_of_its_observations_is_used_and_kept(tmp_path: Path) -> None:
    best = tmp_path / "best.zip"
    training = VecNormalize(DummyVecEnv([scaled]), norm_reward=True)
    model = ppo(training)
    callback = EvaluationCallback(scaled, every=48, best_model_path=best)
    model.learn(48, callback=callback)
    statistics = VecNormalize.load(str(tmp_path / "best.vecnormalize.pkl"), DummyVecEnv([scaled]))
    np.testing.assert_array_equal(statistics.obs_rms.mean, training.obs_rms.mean)
    loaded = PPO.load(best, env=statistics, device="cpu")
    assert evaluate_model(loaded, scaled()) == callback.results[48]
    with pytest.raises(InvalidConfig, match="loaded without its normalization"):
        evaluate_model(PPO.load(best, device="cpu"), scaled())


def test_training__what_wrappers_have_learnt_is_used_and_kept(tmp_path: Path) -> None:
    from zenostat.agent_sdk.wrappers import restore_wrappers

    def make_env() -> gym.Env[Any, Any]:
        return gym.wrappers.NormalizeObservation(scaled())

    best, training = tmp_path / "best.zip", make_env()
    model = ppo(training)
    callback = EvaluationCallback(make_env, every=48, best_model_path=best)
    model.learn(48, callback=callback)
    env = make_env()
    restore_wrappers(env, tmp_path / "best.wrappers.yaml")
    assert evaluate_model(PPO.load(best, device="cpu"), env) == callback.results[48]
    (blank,) = evaluate_model(PPO.load(best, device="cpu"), make_env())
    assert blank != callback.results[48][0]


class InOtherProcesses(VecEnvWrapper):
    """Hides the environments, as `SubprocVecEnv` does."""

    unwrapped = None

    def reset(self) -> Any:
        return self.venv.reset()

    def step_wait(self) -> Any:
        return self.venv.step_wait()


@pytest.mark.parametrize("vectorize", [lambda env: env, lambda env: InOtherProcesses(DummyVecEnv([lambda: env]))])
def test_training__best_model_acts_within_the_wrappers_of_its_training(tmp_path: Path, vectorize: Any) -> None:
    """Also within those that leave the spaces as they are; stable-baselines3 adds its `Monitor` to a single one."""

    def make_env() -> gym.Env[Any, Any]:
        env = gym.wrappers.RescaleAction(fake(control="building"), np.float32(-1), np.float32(1))
        env = gym.wrappers.DelayObservation(gym.wrappers.RepeatAction(env, 4), 1)
        return gym.wrappers.TransformReward(env, lambda reward: reward)

    best = tmp_path / "best.zip"
    model = ppo(vectorize(make_env()))
    with torch.no_grad():  # a policy that reacts to what it observes
        model.policy.action_net.weight.normal_(0.0, 5.0)
    callback = EvaluationCallback(make_env, every=48, seed=4, best_model_path=best)
    model.learn(48, callback=callback)
    building = FakeBuilding(zones=2, begin="07-03", steps_per_hour=1, climate=Climate(noise_k=2.0), control="building")
    (row,) = evaluate({"link": FakeLink(building)}, {"policy": load_policy(best, "ppo")}, episodes=1, seed=4).rows
    assert row.result.reward == pytest.approx(callback.results[48][0].reward, rel=1e-12)


def test_training__callback_in_an_algorithm_that_does_not_report_ends_of_episodes() -> None:
    contrib = pytest.importorskip("sb3_contrib")
    model = contrib.ARS("LinearPolicy", fake(), n_delta=1, seed=0, device="cpu")
    with EvaluationCallback(fake, every=48) as callback:
        model.learn(48, callback=callback)
    assert callback.results
    with pytest.raises(InvalidConfig, match="ARS does not report the ends of episodes: use every= instead"):
        model.learn(48, callback=EvaluationCallback(fake, every_episodes=1))


def test_training__mistakes_in_a_callback(tmp_path: Path) -> None:
    for arguments in ({"every": 0}, {"every": 1, "episodes": 0}):
        with pytest.raises(InvalidConfig, match="numbers of at least 1 expected"):
            EvaluationCallback(fake, **arguments)
    for path in (tmp_path / "best.pt", tmp_path / "nowhere" / "best.zip"):
        with pytest.raises(InvalidConfig, match=r"a .zip file in an existing folder expected"):
            EvaluationCallback(fake, every=1, best_model_path=path)
    with pytest.raises(InvalidConfig, match="a function that makes the environment expected"):
        EvaluationCallback(fake(), every=1)
    model = ppo(fake())
    with pytest.raises(InvalidConfig, match="an evaluation needs a single environment"):
        model.learn(48, callback=EvaluationCallback(lambda: DummyVecEnv([fake]), every=48))
    for make, message in (
        (lambda: DummyVecEnv([fake]), "a single environment, of gymnasium.make"),
        (lambda: gym.make("CartPole-v1"), "has no 'manifest'; wrap an environment with an id under zenostat/"),
        (lambda: fake(zones=3), "other observations than those of the evaluation: 8 of them, now 10"),
        (lambda: fake(discrete=5, control="building"), "other actions than those of the evaluation"),
    ):
        with pytest.raises(InvalidConfig, match=message):
            evaluate_model(model, make())
    with pytest.raises(InvalidConfig, match="episodes=0; a number of at least 1 expected"):
        evaluate_model(model, fake(), episodes=0)
    env = fake()
    with pytest.raises(InvalidConfig, match="returned an environment of the training"):
        ppo(env).learn(48, callback=EvaluationCallback(lambda: env, every=48))
    with pytest.raises(InvalidConfig, match="has no reward"):
        ppo(fake()).learn(48, callback=EvaluationCallback(lambda: fake(reward=None), every=48))


# Models as controllers


def test_training__model_as_a_controller_acts_as_in_its_environment(tmp_path: Path) -> None:
    settings = {"zones": 2, "begin": "07-03", "time": ("month", "hour", "day_of_week")}
    env = FakeEnv(**settings)
    model = SAC("MlpPolicy", env, policy_kwargs=dict(NET), seed=1, device="cpu", **OFF_POLICY)
    model.save(tmp_path / "model.zip")
    expected = evaluate_model(model, env, episodes=2, seed=7)
    assert expected[0] != expected[1]
    state = np.random.get_state()[1].tobytes(), torch.random.get_rng_state().numpy().tobytes()
    for trained in (f"sac:{tmp_path / 'model.zip'}", load_policy(tmp_path / "model.zip", SAC)):
        evaluation = evaluate({"link": FakeLink(FakeBuilding(**settings))}, {"trained": trained}, episodes=2, seed=7)
        assert tuple(row.result for row in evaluation.rows) == expected
    # The file has a seed, and loading it seeds nothing here.
    assert state == (np.random.get_state()[1].tobytes(), torch.random.get_rng_state().numpy().tobytes())


def test_training__model_of_other_observations_is_refused() -> None:
    model = ppo(gym.wrappers.NormalizeObservation(fake()))
    with pytest.raises(InvalidConfig, match=r"other observations than those of 'fake'.*behind wrappers"):
        PolicyController(fake().unwrapped.manifest, model)
    with pytest.raises(InvalidConfig, match="other observations"):
        PolicyController(manifest(), ppo(fake()))


def test_training__files_that_are_no_models(tmp_path: Path) -> None:
    (tmp_path / "text.zip").write_text("nothing")
    ppo(fake()).save(tmp_path / "model.zip")
    for text, error, message in (
        (f"ppo:{tmp_path}/none.zip", UnknownName, "there is no model file"),
        (f"pop:{tmp_path}/model.zip", UnknownName, "no algorithm 'pop'; did you mean 'ppo'"),
        (f"{tmp_path}/model.zip", InvalidConfig, "the algorithm of .* is missing"),
        (f"ppo:{tmp_path}/text.zip", InvalidConfig, "is not a model of PPO, or of another version"),
        (f"sac:{tmp_path}/model.zip", InvalidConfig, "is not a model of SAC"),
    ):
        with pytest.raises(error, match=message):
            load_policy(text)


def test_training__without_the_extra_it_is_one_sentence() -> None:
    program = "import sys; sys.modules['stable_baselines3'] = None; import zenostat.lab.training"
    done = run_python("-c", program, timeout=60)
    assert "MissingExtra: training needs stable-baselines3" in done.stderr
    assert "[train]'" in done.stderr.splitlines()[-1]
