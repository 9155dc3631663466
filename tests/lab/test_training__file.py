"""A training from a file equals stable-baselines3 driven by hand and resumes to the bit; its folder is a controller."""

import json
import math
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.csv_files import csv_rows

import zenostat  # noqa: F401  # registers the environments
from zenostat.agent_sdk.testing import Climate, FakeEnv
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.file_lock import locked

pytest.importorskip("stable_baselines3")
torch = pytest.importorskip("torch")

from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize  # noqa: E402
from support.trainings import check_resumed, model_content, same  # noqa: E402

from zenostat.agent_sdk.controllers import Agent, load_controller  # noqa: E402
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch  # noqa: E402
from zenostat.agent_sdk.envs.sb3_vec_env import as_sb3  # noqa: E402
from zenostat.lab.evaluate import evaluate, run_episode  # noqa: E402
from zenostat.lab.training import ALGORITHMS, load_policy, read_training, resume_training, train  # noqa: E402
from zenostat.lab.training.checkpoint import Checkpoint, checkpoints  # noqa: E402
from zenostat.lab.training.horizon import horizon_warning, scale_warning  # noqa: E402
from zenostat.lab.training.parameters import make_model  # noqa: E402
from zenostat.lab.training.run import check_training  # noqa: E402
from zenostat.topics import yaml12  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")

NET = {"net_arch": [8]}
OFF_POLICY = {"learning_starts": 40, "batch_size": 16, "buffer_size": 150, "train_freq": 4, "policy_kwargs": NET}
NOISE = {"kind": "ornstein-uhlenbeck", "sigma": 0.2}
PARAMETERS: dict[str, dict[str, Any]] = {
    "sac": OFF_POLICY,
    "ppo": {"n_steps": 32, "batch_size": 32, "n_epochs": 2, "use_sde": True, "policy_kwargs": NET},
    "a2c": {"n_steps": 5, "policy_kwargs": NET},
    "td3": {**OFF_POLICY, "action_noise": NOISE},
    "ddpg": OFF_POLICY,
    "dqn": OFF_POLICY,
    "recurrent-ppo": {"n_steps": 32, "batch_size": 32, "n_epochs": 1, "policy_kwargs": {**NET, "lstm_hidden_size": 8}},
}
DAY: dict[str, Any] = {"zones": 2, "begin": "07-03", "end": "07-03", "steps_per_hour": 1}
LIMIT = {"points": ["zone_1_air_temperature"], "low": 19.0, "high": 26.5}


def fields(name: str, output: Path, **changes: Any) -> dict[str, Any]:
    """A training of some days with noise on the weather, whose episodes end at different times."""
    arguments = {**DAY, "climate": Climate(noise_k=2.0), "terminate": [LIMIT]}
    if name == "dqn":
        arguments |= {"discrete": 5, "control": "building"}
    return {
        "algorithm": name, "scenario": "Fake-v1", "arguments": arguments, "steps": 160, "seed": 3, "threads": 1,
        "parameters": PARAMETERS[name], "evaluation": False, "output": str(output), **changes,
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("name", PARAMETERS)
def test_training__weights_are_those_of_stable_baselines3_driven_by_hand(name: str, tmp_path: Path) -> None:
    training = fields(
        name, tmp_path / "file", normalization=False, evaluation={"every_episodes": 2}, checkpoint_steps=30
    )
    train(read_training(training))
    parameters = json.loads(json.dumps(PARAMETERS[name]))  # the algorithms write into `policy_kwargs`
    if "action_noise" in parameters:
        from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise

        actions = FakeEnv(**training["arguments"]).action_space.shape
        parameters["action_noise"] = OrnsteinUhlenbeckActionNoise(np.zeros(actions), np.full(actions, 0.2))
    policy = "MlpLstmPolicy" if name == "recurrent-ppo" else "MlpPolicy"
    env = gym.make("zenostat/Fake-v1", **training["arguments"])
    model = ALGORITHMS[name](policy, env, seed=3, device="cpu", **parameters)
    model.learn(160)
    model.save(tmp_path / "hand.zip")
    assert same(model_content(tmp_path / "file" / "model.zip"), model_content(tmp_path / "hand.zip"))


def test_training__slots_and_normalization_are_those_of_the_documented_program(tmp_path: Path) -> None:
    training = fields("ppo", tmp_path / "file", slots=3, steps=96)
    train(read_training(training))
    mode = gym.VectorizeMode.VECTOR_ENTRY_POINT
    envs = gym.make_vec("zenostat/Fake-v1", 3, mode, autoreset_mode="SameStep", **training["arguments"])
    scaled = gym.wrappers.vector.RescaleAction(envs, np.float32(-1), np.float32(1))
    env = VecNormalize(VecMonitor(as_sb3(scaled)), gamma=0.99)
    parameters = json.loads(json.dumps(PARAMETERS["ppo"]))
    model = ALGORITHMS["ppo"]("MlpPolicy", env, seed=3, device="cpu", **parameters)
    model.learn(96)
    model.save(tmp_path / "hand.zip")
    assert same(model_content(tmp_path / "file" / "model.zip"), model_content(tmp_path / "hand.zip"))


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(("name", "slots"), [(name, slots) for name in PARAMETERS for slots in (1, 3)])
def test_training__resumed_training_equals_an_uninterrupted_one(name: str, slots: int, tmp_path: Path) -> None:
    changes: dict[str, Any] = {"slots": slots, "evaluation": {"every_steps": 50}, "checkpoint_steps": 70}
    if slots == 1:
        changes["wrappers"] = [{"wrapper": "NormalizeObservation"}]
    check_resumed(lambda output: fields(name, output, **changes), tmp_path)


STACKED = [
    {"wrapper": "NormalizeObservation"},
    {"wrapper": "FrameStackObservation", "stack_size": 5},
    {"wrapper": "FlattenObservation"},
]


@pytest.mark.parametrize(
    ("wrappers", "slots"),
    [([], 1), ([], 3), (STACKED, 1), ([STACKED[0], {"wrapper": "DelayObservation", "delay": 3}], 1)],
    ids=["reward", "reward of slots", "frames", "delay"],
)
def test_training__what_earlier_episodes_have_left_is_resumed(
    wrappers: list[dict[str, Any]], slots: int, tmp_path: Path
) -> None:
    """The maxima of a reward, and observations of the running episode that were scaled by statistics of then."""
    arguments = {**DAY, "climate": Climate(noise_k=2.0), "reward": {"kind": "normalized"}}
    changes = {"arguments": arguments, "wrappers": wrappers, "slots": slots, "checkpoint_steps": 70}
    changes |= {"normalization": {"rewards": False}, "evaluation": False}
    check_resumed(lambda output: fields("a2c", output, **changes), tmp_path)


def test_training__damaged_checkpoint_is_replaced_by_the_one_before_it(tmp_path: Path) -> None:
    """The training goes on to the same weights; so does one whose number of steps or interval changes what is kept."""
    training = fields("a2c", tmp_path, checkpoint_steps=60)
    train(read_training(training))
    expected = model_content(tmp_path / "model.zip")
    before, last = checkpoints(tmp_path / "checkpoints")
    for file in ("state.pkl", "model.zip"):
        (last / file).write_bytes((last / file).read_bytes()[:100])
        (tmp_path / "model.zip").unlink()
        with pytest.warns(UserWarning, match=rf"{last} is not a checkpoint: .*; it is removed, .* goes on at step 120"):
            train(read_training(training), resume=True)
        assert same(model_content(tmp_path / "model.zip"), expected)
        assert checkpoints(tmp_path / "checkpoints") == [before, last]
    for path in (before, last):
        (path / "state.pkl").unlink()
    with pytest.raises(InvalidConfig, match=rf"{last} is not a checkpoint: .* no other one that can be read"):
        train(read_training(training), resume=True)


KILLED = """
import os
import sys
from pathlib import Path
from zenostat.lab.training.checkpoint import Checkpoint

class Kill:
    def __reduce__(self):
        os._exit(9)

Checkpoint(4, b"model", b"", "", {"pickled": Kill()}).write(Path(sys.argv[1]))
"""


def test_checkpoint__what_a_killed_process_has_left_is_removed(tmp_path: Path) -> None:
    killed = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    assert killed.returncode == 9
    assert len([*tmp_path.iterdir()]) == 1
    Checkpoint(5, b"model", b"", "", {}).write(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["step-000000000005"]


def test_training__is_not_resumed_with_another_scenario_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    scenario = {"building": "ref-small-office", "weather": ["USA_CO_Denver"], "begin": "07-03", "end": "07-03"}
    scenario |= {"steps_per_hour": 1, "reward": {"kind": "linear"}}
    file.write_text(yaml12.dump(scenario))
    training = fields("a2c", tmp_path / "run", scenario=str(file), arguments={}, steps=5)
    train(read_training(training))
    longer = training | {"steps": 10}
    for changed in ({"reward": {"kind": "exponential"}}, {"end": "07-04"}):
        file.write_text(yaml12.dump({**scenario, **changed}))
        with pytest.raises(InvalidConfig, match=rf"another scenario.*{next(iter(changed))}"):
            train(read_training(longer), resume=True)
    file.write_text(yaml12.dump(scenario))
    assert train(read_training(longer), resume=True).step == 10


def test_training__evaluations_are_counted_in_episodes(tmp_path: Path) -> None:
    train(read_training(fields("a2c", tmp_path, evaluation={"every_episodes": 2}, arguments=DAY, steps=130)))
    steps = [[int(row["step"]) for row in csv_rows(tmp_path / name)] for name in ("evaluations.csv", "curve.csv")]
    assert steps == [[48, 96], [24, 48, 72, 96, 120]]  # an episode has 24 steps


def test_training__folder_of_a_training_behind_wrappers_is_a_controller(tmp_path: Path) -> None:
    wrappers = [
        {"wrapper": "PreviousObservation", "names": ["zone_1_air_temperature"]},
        {"wrapper": "NormalizeObservation"},
    ]
    evaluation = {"every_steps": 96, "seed": 5}
    training = fields("ppo", tmp_path, wrappers=wrappers, evaluation=evaluation, arguments=DAY, steps=96)
    result = train(read_training(training))
    factories = (load_controller(str(tmp_path)), load_policy(tmp_path / "best.zip"))
    for factory, branch_of in product(factories, ("", "office")):  # the questions "what if" ask it on a branch
        with FakeEnv(**DAY) as env:
            agent = Agent(factory(env.manifest.model_copy(update={"branch_of": branch_of})))
            for _ in range(2):  # a second episode begins anew
                metrics, _ = run_episode(env, lambda _, agent=agent, env=env: agent.action(env.sample), seed=5)
                assert metrics.reward == result.best_reward


def test_training__behind_wrappers_with_a_state_is_no_controller_of_other_observations(tmp_path: Path) -> None:
    changes = {"wrappers": [{"wrapper": "NormalizeObservation"}], "evaluation": False, "arguments": DAY, "steps": 32}
    train(read_training(fields("a2c", tmp_path, **changes)))
    with (
        FakeEnv(**{**DAY, "zones": 4}) as env,
        pytest.raises(ControllerMismatch, match=r"trained on other observations .* scenario of its training"),
    ):
        load_controller(str(tmp_path))(env.manifest)


def test_training__evaluations_write_no_logs(tmp_path: Path) -> None:
    log = {"wrapper": "EpisodeLog", "folder": str(tmp_path / "log")}
    evaluation = {"every_steps": 64, "references": []}
    changes = {"wrappers": [{"wrapper": "CyclicTime"}, log], "evaluation": evaluation, "steps": 64, "arguments": DAY}
    train(read_training(fields("ppo", tmp_path / "run", **changes)))
    episodes = [path.name for path in sorted((tmp_path / "log").iterdir())]
    assert episodes == ["episode-000001.csv", "episode-000002.csv", "episode-000003-left.csv"]
    with (tmp_path / "run" / "evaluations.csv").open() as file:
        assert len(file.readlines()) == 2


def test_training__default_folder_has_the_whole_id() -> None:
    ids = ["office-USA_CO.Denver-continuous-v1", "office-USA_CO.Boulder-continuous-v1", "my/own.office.yaml"]
    folders = [read_training({"algorithm": "ppo", "scenario": name, "steps": 1}).folder.name for name in ids]
    assert len(set(folders)) == 3
    assert [folder.endswith("v1-ppo-0") for folder in folders] == [True, True, False]


def test_training__folder_of_an_older_version_is_one_sentence(tmp_path: Path) -> None:
    training = fields("a2c", tmp_path, arguments=DAY, steps=5)
    train(read_training(training))
    versions = json.loads((tmp_path / "versions.json").read_text())
    (tmp_path / "versions.json").write_text(json.dumps({**versions, "format": 0, "zenostat": "0.0.9"}))
    with pytest.raises(InvalidConfig, match=r"written by Zenostat 0\.0\.9 in format 0"):
        load_policy(tmp_path)


def test_training__folder_is_neither_overwritten_nor_resumed_with_another_training(tmp_path: Path) -> None:
    training = fields("a2c", tmp_path, arguments=DAY, steps=5)
    train(read_training(training))
    with pytest.raises(InvalidConfig, match="already has a training"):
        train(read_training(training))
    other = {**training, "parameters": {**PARAMETERS["a2c"], "gamma": 0.5}}
    with pytest.raises(InvalidConfig, match=r"parameters\.gamma was not set, now 0\.5"):
        train(read_training(other), resume=True)
    longer = train(resume_training(tmp_path, 10), resume=True)
    assert (longer.step, longer.finished) == (10, True)
    with pytest.raises(InvalidConfig, match="has 10 steps already; steps=5 would be fewer"):
        train(resume_training(tmp_path, 5), resume=True)
    assert resume_training(tmp_path).steps == 10


@pytest.mark.parametrize(
    ("name", "changes", "text"),
    [
        ("ppo", {"algorithm": "pro"}, "there is no 'pro'; did you mean 'ppo'"),
        ("ppo", {"parameters": {"n_stepz": 3}}, "ppo has no 'n_stepz'; did you mean 'n_steps'"),
        ("ppo", {"parameters": {"learning_rate": "fast"}}, r"parameters\.learning_rate: float | schedule expected"),
        ("ppo", {"parameters": {"gamma": 1.5}}, r"parameters\.gamma: a number from 0 to 1"),
        ("ppo", {"parameters": {"seed": 1}}, "use the field `seed`"),
        ("ppo", {"parameters": {"n_steps": 1, "batch_size": 1}}, "batch_size"),
        ("ppo", {"wrappers": [{"wrapper": "CyclicTim"}]}, "CyclicTime"),
        ("ppo", {"scenario": "5zone"}, "there is no scenario '5zone'"),
        ("sac", {"parameters": {"train_freq": [1, "episode"]}, "slots": 2}, "count steps"),
        ("ppo", {"policy": "MlpLstmPolicy"}, "ppo has no 'MlpLstmPolicy'"),
        ("ppo", {"policy": "MultiInputPolicy"}, "MultiInputPolicy is not for observations that are vectors"),
        ("ppo", {"parameters": {"ent_coef": math.nan}}, r"parameters\.ent_coef: finite numbers expected, got nan"),
        ("ppo", {"parameters": {"policy_kwargs": {"log_std_init": math.inf}}}, "policy_kwargs: finite numbers"),
        ("ppo", {"parameters": {"gamma": {"linear": [0.9, 0.99]}}}, r"parameters\.gamma: a constant expected"),
        ("ppo", {"parameters": {"clip_range": -0.1}}, r"parameters\.clip_range: a number of at least 0"),
        ("ppo", {"parameters": {"policy_kwargs": {"net_arch": [64, 0]}}}, r"net_arch: sizes .*, or \{pi: .*, vf: "),
        ("sac", {"parameters": {"policy_kwargs": {"net_arch": {"vf": [8]}}}}, r"net_arch: sizes .*, or \{pi: .*, qf: "),
        ("dqn", {"parameters": {"policy_kwargs": {"net_arch": {"pi": [8]}}}}, r"net_arch: sizes of layers such as "),
        ("sac", {"parameters": {"buffer_size": 10**15}}, "sac: Unable to allocate"),
        ("td3", {"parameters": {"action_noise": {"kind": ["normal"]}}}, "kind: normal or ornstein-uhlenbeck"),
        ("td3", {"parameters": {"action_noise": {"kind": "normal", "sigma": -1.0}}}, "sigma is negative"),
        ("ppo", {"arguments": {"reward": None}}, r"arguments\.reward: a training needs a reward"),
        ("ppo", {"threads": 10**9}, "threads: Input should be less than or equal to 1024"),
        ("ppo", {"evaluation": {"seed": 2**64 - 1, "episodes": 2}}, "the last of 2 episodes from seed"),
    ],
)
def test_training__bad_input_is_reported_before_anything_starts(
    name: str, changes: dict[str, Any], text: str, tmp_path: Path
) -> None:
    with pytest.raises((InvalidConfig, UnknownName), match=text):
        check_training(read_training({**fields(name, tmp_path / "output"), **changes}))
    assert not (tmp_path / "output").exists()


def test_training__algorithm_that_cannot_have_the_actions_states_what_can(tmp_path: Path) -> None:
    dqn = {**fields("dqn", tmp_path / "dqn"), "arguments": DAY}
    with pytest.raises(InvalidConfig, match="dqn needs one discrete action, and Fake-v1 has continuous actions"):
        train(read_training(dqn))
    sac = {**fields("sac", tmp_path / "sac"), "arguments": {**DAY, "discrete": 5, "control": "building"}}
    with pytest.raises(InvalidConfig, match="sac needs continuous actions, and Fake-v1 has discrete actions"):
        train(read_training(sac))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"wrappers": [{"wrapper": "RewardVector", "terms": ["energy", "comfort"]}]}, "reward; remove RewardVector"),
        ({"wrappers": [{"wrapper": "NumericInfos"}], "evaluation": {}}, "NumericInfos leaves out .*evaluations need"),
        ({"output": "/proc/here"}, "output: cannot create the folder '/proc/here'"),
        ({"output": "a\0b"}, "output: cannot create the folder"),
    ],
)
def test_training__what_only_its_environment_and_folder_show_is_one_error(
    changes: dict[str, Any], text: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidConfig, match=text):
        train(read_training({**fields("ppo", tmp_path / "run"), "arguments": DAY, **changes}))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_training__device_that_is_missing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match="device: PyTorch has no cuda on this machine"):
        check_training(read_training({**fields("ppo", tmp_path), "device": "cuda"}))


def test_training__folder_has_one_training_at_a_time(tmp_path: Path) -> None:
    ppo = {**fields("ppo", tmp_path / "ppo"), "arguments": DAY}
    (tmp_path / "ppo").mkdir()
    with locked(tmp_path / "ppo" / ".lock", "not raised"), pytest.raises(InvalidConfig, match="is training there"):
        train(read_training(ppo))


def test_training__two_intervals_exclude_each_other() -> None:
    with pytest.raises(InvalidConfig, match="every_steps and every_episodes exclude each other"):
        read_training(
            {"algorithm": "ppo", "scenario": "x", "steps": 1, "evaluation": {"every_steps": 1, "every_episodes": 1}}
        )


@pytest.mark.parametrize(
    ("normalization", "arguments", "log_std"),
    [({}, {}, -1.5), ({}, {"log_std_init": -2.0}, -2.0), ({"actions": False}, {}, 0.0), (False, {}, 0.0)],
)
def test_make_model__exploration_is_scaled_to_rescaled_actions(
    normalization: Any, arguments: dict[str, float], log_std: float, tmp_path: Path
) -> None:
    parameters = {"policy_kwargs": arguments, "n_steps": 8, "batch_size": 8}
    config = read_training(fields("ppo", tmp_path, normalization=normalization) | {"parameters": parameters})
    env = DummyVecEnv([lambda: gym.make("zenostat/Fake-v1")])
    assert make_model(config, env).policy.log_std.tolist() == [log_std] * env.action_space.shape[0]


@pytest.mark.parametrize(
    ("gamma", "step_s", "steps", "text"),
    [
        (0.99, 900.0, 672, ""),  # 25 hours of a week
        (0.5, 900.0, 672, "looks 30 minutes ahead with timesteps of 900 s"),
        (0.5, 900.0, 672, "0.9792 looks 12 h ahead"),  # 1 - 0.25 / 12
        (0.999, 900.0, 96, "looks 1000 timesteps ahead, but an episode has 96: choose at most 0.9896"),
        (0.99, 900.0, 96, ""),
        (1.0, 3600.0, 24, "looks inf timesteps ahead"),
        (0.5, 3600.0, 24, ""),
    ],
)
def test_horizon_warning__compares_discount_and_episode(gamma: float, step_s: float, steps: int, text: str) -> None:
    warning = horizon_warning(gamma, step_s, steps)
    assert text in warning
    assert bool(warning) == bool(text)


@pytest.mark.parametrize(
    ("reward", "warns"),
    [(-96.0, False), (-9600.0, True), (-0.0096, True), (0.0, False)],  # -1, -100 and -1e-4 a timestep, times 50
)
def test_scale_warning__compares_discounted_returns(reward: float, warns: bool) -> None:
    assert bool(scale_warning(0.98, reward, 96)) == warns


def test_training__warns_once_of_rewards_that_are_too_large(tmp_path: Path) -> None:
    scale = {"reward": {"kind": "linear", "lambda_energy": 1.0, "lambda_temperature": 1e5}}
    training = fields("ppo", tmp_path / "file", normalization={"rewards": False}, evaluation=False)
    training["arguments"] = {**training["arguments"], **scale}
    with pytest.warns(UserWarning, match="discounted returns are about") as caught:
        train(read_training(training))
    assert sum("discounted returns" in str(warning.message) for warning in caught) == 1


@pytest.mark.slow
@pytest.mark.process
def test_training__references_run_through_the_evaluation_episodes(tmp_path: Path) -> None:
    scenario, day = "ref-small-office-USA_CO_Denver-continuous-v1", {"begin": "07-03", "end": "07-03"}
    evaluation = {"every_steps": 24, "episodes": 2, "seed": 7, "references": ["baseline", "rbc"]}
    arguments = {**day, "steps_per_hour": 1}
    settings = {"scenario": scenario, "arguments": arguments, "evaluation": evaluation, "steps": 24}
    reported: list[dict[str, float]] = []
    train(read_training(fields("a2c", tmp_path, **settings)), on_references=reported.append)
    expected = evaluate(scenario, ["baseline", "rbc"], episodes=2, seed=7, **arguments)
    means = {name: metrics["reward"].mean for name, metrics in expected.summary().items()}
    assert reported == [pytest.approx(means, rel=1e-12)]
    rows = [(row["controller"], float(row["reward"])) for row in csv_rows(tmp_path / "references.csv")]
    assert rows == [(row.controller, row.result.reward) for row in expected.rows]


@pytest.mark.slow
@pytest.mark.process
def test_training__evaluation_of_offsets_of_zero_has_the_metrics_of_the_baseline(tmp_path: Path) -> None:
    scenario = "ref-small-office-USA_CO_Denver-continuous-v1"
    evaluation = {"every_steps": 24, "episodes": 1, "seed": 7, "references": ["baseline"], "at_start": True}
    arguments = {"begin": "07-03", "end": "07-03", "steps_per_hour": 1, "relative": 3.0}
    settings = {"scenario": scenario, "arguments": arguments, "evaluation": evaluation, "steps": 24}
    train(read_training(fields("a2c", tmp_path, **settings, zero_start=True)))
    first = [csv_rows(tmp_path / name)[0] for name in ("evaluations.csv", "references.csv")]
    metrics = [name for name in first[0] if name in first[1] and name not in ("episode", "seed")]
    assert {"mean_power_w", "hvac_electricity_kwh", "unmet_cooling_h", "peak_kw"} <= {*metrics}
    evaluated, reference = ({name: row[name] for name in metrics} for row in first)
    assert evaluated == reference


def test_training__reference_that_is_no_bundled_controller_is_refused(tmp_path: Path) -> None:
    training = read_training(fields("a2c", tmp_path, evaluation={"references": ["baselin"]}))
    with pytest.raises(UnknownName, match=r"evaluation\.references: .* 'baselin'; did you mean 'baseline'"):
        check_training(training)
