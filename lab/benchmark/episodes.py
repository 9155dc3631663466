"""Run the episodes of one task."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

from zenostat.agent_sdk.controllers import Agent, load_controller, make_controller
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.rewards import read_reward
from zenostat.bridge.client.sample import SampleView
from zenostat.lab.benchmark.definition import BASELINES, LINEAR, SETS, Task, is_trained
from zenostat.lab.benchmark.results import Row
from zenostat.lab.benchmark.trained import Training
from zenostat.lab.benchmark.two_loop_pid import TwoLoopPID
from zenostat.lab.evaluate import run_episode, without_actuators
from zenostat.metrics.episode_metrics import EpisodeMetrics
from zenostat.topics.errors import ZenostatError
from zenostat.topics.messages import Manifest

_METRICS = (
    "hvac_electricity_kwh", "electricity_kwh", "natural_gas_kwh", "peak_kw", "outside_kh", "occupied_outside_kh",
    "mean_deviation_k", "late", "rejected", "terminated",
    "kpi.tdis_tot", "kpi.ener_tot", "kpi.pele_tot",
)  # fmt: skip


@dataclass(frozen=True)
class Job:
    """Episodes of one task in one building.

    Attributes:
        set: name of the set.
        task: the task.
        episodes: pairs of controller and seed.
        cache: folder of the trainings.
    """

    set: str
    task: Task
    episodes: tuple[tuple[str, int], ...]
    cache: Path

    def __str__(self) -> str:
        return str(self.task)


class LinearReward:
    """The linear reward of the timesteps of an episode, which is measured beside the reward of the task.

    Attributes:
        total: sum over the timesteps so far.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._bound = read_reward(LINEAR).bind(manifest)
        self._step = timedelta(seconds=manifest.step_s)
        self.total = 0.0

    def add(self, sample: SampleView, terms: Mapping[str, float] | None = None) -> None:  # noqa: ARG002
        """Add the timestep that a sample closes."""
        if sample.step:
            self.total += float(self._bound(sample.fault_free_values, sample.time - self._step).reward)


def run_job(job: Job) -> tuple[list[Row], list[str]]:
    """Run the episodes of a job, those of the baseline control in a building without actuators.

    Each episode has a new controller and starts from the same state, so its row does not depend on the others.

    Returns:
        The rows, and the errors of the episodes that failed.
    """
    settings = SETS[job.set].arguments(*job.task.key)
    rows: list[Row] = []
    errors: list[str] = []
    for is_baseline in (True, False):
        episodes = [episode for episode in job.episodes if (episode[0] == "baseline") == is_baseline]
        if not episodes:
            continue
        with closing(BuildingEnv(**(without_actuators(settings) if is_baseline else settings))) as env:
            for name, seed in episodes:
                try:
                    rows.append(_run_episode(job, env, name, seed))
                except Exception as error:  # of a user's controller; the others still run
                    errors.append(f"{name}/{job.task}/{seed}: {describe_error(error)}")
    return rows, errors


def describe_error(error: Exception) -> str:
    """Return the text of an error of the product, and the type too of any other one."""
    return str(error) if isinstance(error, ZenostatError) else f"{type(error).__name__}: {error}"


def _run_episode(job: Job, env: BuildingEnv, name: str, seed: int) -> Row:
    agent = Agent(_controller(job, name, env.manifest, seed), env)
    linear = LinearReward(env.manifest)
    result, _ = run_episode(env, lambda _: agent.action(env.sample), seed=seed, recorder=linear)
    return _row(name, job.task, seed, result, linear.total)


def _controller(job: Job, name: str, manifest: Manifest, seed: int) -> Any:
    task = job.task
    if is_trained(name):
        factory = load_controller(str(Training(job.cache, job.set, name, task.building, task.season).folder))
        return make_controller(factory, manifest, {})
    if name == "pid":
        return TwoLoopPID(manifest)
    parameters = dict(BASELINES.get(name, {}))
    if name in ("random", "oracle"):
        parameters["seed"] = seed
    return make_controller(load_controller(name), manifest, parameters)


def _row(controller: str, task: Task, seed: int, result: EpisodeMetrics, linear: float) -> Row:
    metrics = result.metrics()
    assert result.reward is not None, "the tasks have a reward"
    return Row(
        controller, task.building, task.season, task.weather, seed, result.reward, dict(result.terms), linear,
        {name: float(value) for name in _METRICS if (value := metrics.get(name)) is not None},
    )  # fmt: skip
