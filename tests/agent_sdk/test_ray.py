"""Environments in RLlib's new API stack, in Tune, and on a Ray cluster; run by `make test-ray`."""

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from support.nodes import SMALL, command_of, runs, until
from support.run_cli import run_python

import zenostat.agent_sdk.ray
from zenostat.agent_sdk.envs.zone_agents import ZonesEnv
from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.agent_sdk.testing.fake_link import FakeLink

ray = pytest.importorskip("ray", reason="Ray has an environment of its own: make test-ray")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.filterwarnings("ignore")]

EXAMPLES = Path(__file__).parents[2] / "examples"
BUILDING = {**SMALL, "control": "building", "affinity": "off"}
PATIENT = {"RAY_raylet_start_wait_time_s": "180", "RAY_worker_register_timeout_seconds": "180"}
"""For machines on which other programs use all cores."""


@pytest.fixture(scope="module")
def cluster(module_folder: Path) -> Iterator[None]:
    """A Ray of this test's own."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in PATIENT.items():
            patch.setenv(name, value)
        ray.init(
            num_cpus=4, object_store_memory=100_000_000, include_dashboard=False, _temp_dir=str(module_folder / "ray")
        )
        yield
        ray.shutdown()


def ppo(runners: int, cores: int, **env_config: Any) -> Any:
    from ray.rllib.algorithms.ppo import PPOConfig

    config = PPOConfig().environment(zenostat.agent_sdk.ray.register(), env_config=env_config)
    config.training(train_batch_size_per_learner=192, minibatch_size=64, num_epochs=2)
    return zenostat.agent_sdk.ray.set_env_runners(config, runners=runners, cores=cores).debugging(seed=3)


def pids(algorithm: Any) -> list[int]:
    return algorithm.env_runner_group.foreach_env_runner(lambda runner: os.getpid(), local_env_runner=False)


def nodes_of(pid: int) -> list[psutil.Process]:
    """The nodes that a process has started."""
    return [child for child in psutil.Process(pid).children() if "zenostat.eplus_node" in command_of(child)]


def test_ray__ppo_trains_and_survives_a_killed_worker(cluster: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """An EnvRunner is one node with as many slots as cores; another one replaces it, and no node is left of it."""
    monkeypatch.setattr("support.nodes.PATIENCE_S", 600.0)  # a worker of Ray's takes a minute where cores are busy
    algorithm = ppo(runners=1, cores=2, **BUILDING).build_algo()
    try:
        steps = [algorithm.train()["env_runners"]["num_env_steps_sampled_lifetime"] for _ in range(2)]
        assert steps[1] > steps[0] >= 192
        (worker,) = pids(algorithm)
        (node,) = nodes_of(worker)
        slots = algorithm.env_runner_group.foreach_env_runner(
            lambda runner: (runner.env.num_envs, runner.env.unwrapped.manifest.slots), local_env_runner=False
        )
        assert slots == [(2, 2)]
        os.kill(worker, signal.SIGKILL)
        until(lambda: not runs(node), "the node ends with its worker")
        until(lambda: algorithm.train() and pids(algorithm) not in ([], [worker]), "another worker replaces it")
        after = algorithm.train()["env_runners"]
        assert after["num_env_steps_sampled_lifetime"] >= steps[1] + 192
        (worker,) = pids(algorithm)
        (node,) = nodes_of(worker)
    finally:
        algorithm.stop()
    until(lambda: not runs(node), "the node ends with the algorithm")


def test_ray__single_environment_samples(cluster: None) -> None:
    """In the algorithm's own process, made one by one as Gymnasium's `sync` does."""
    config = ppo(runners=0, cores=1, id="Fake-v1", zones=1)
    algorithm = config.env_runners(num_envs_per_env_runner=2, gym_env_vectorize_mode="sync").build_algo()
    try:
        assert algorithm.train()["env_runners"]["num_env_steps_sampled_lifetime"] >= 192
    finally:
        algorithm.stop()


def test_ray__agents_of_zones_pass_rllibs_check() -> None:
    """RLlib 2.60 has a check for several agents only."""
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.rllib.utils.pre_checks.env import check_multiagent_environments

    env = ParallelPettingZooEnv(ZonesEnv(link=FakeLink(FakeBuilding(3))))
    check_multiagent_environments(env)
    env.close()


def run_example(name: str, *options: str, folder: Path) -> str:
    environment = {**os.environ, **PATIENT, "PYTHONWARNINGS": "ignore", "RAY_TMPDIR": str(folder), "HOME": str(folder)}
    done = run_python(str(EXAMPLES / name), *options, env=environment, cwd=folder, timeout=800)
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


def test_ray__tune_finds_the_better_of_two_trials(folder: Path) -> None:
    options = [
        "--env", "Fake-v1", "--begin", "07-03", "--end", "07-03", "--iterations", "1", "--batch", "256", "--cores",
        "1",
    ]  # fmt: skip
    text = run_example("ray_tune.py", *options, folder=folder)
    returns = dict(re.findall(r"lr ([\d.]+): return (-[\d.]+) after \d+ steps", text))
    assert sorted(returns) == ["0.0001", "0.001"]
    best = max(returns, key=lambda rate: float(returns[rate]))
    assert f"best: lr {best}" in text


def test_ray__two_raylets_with_a_token(folder: Path) -> None:
    text = run_example("ray_cluster.py", "--iterations", "1", "--batch", "192", folder=folder)
    assert "2 EnvRunners on 2 raylets" in text
    (steps,) = re.findall(r"^(\d+) steps, return -\d", text, re.MULTILINE)
    assert int(steps) >= 192
