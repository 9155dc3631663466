"""Run the episodes of one task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

from zenostat.agent_sdk.controllers import Agent, load_controller, make_controller
from zenostat.agent_sdk.controllers.training_folder import is_training, read_training_fields
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.rewards import read_reward
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.runtime.processor_time import tree_processor_s
from zenostat.lab.benchmark.definition import (
    BASELINE,
    BASELINES,
    LINEAR,
    SETS,
    TUNED,
    Episode,
    Task,
    digest_of,
    is_prepared,
)
from zenostat.lab.benchmark.prepared import preparation_of, read_record
from zenostat.lab.benchmark.recipes import rule_of
from zenostat.lab.benchmark.results_file import Row
from zenostat.lab.benchmark.two_loop_pid import TwoLoopPID
from zenostat.lab.evaluate import run_episode, without_actuators
from zenostat.lab.workers import describe_error
from zenostat.metrics.episode_metrics import EpisodeMetrics
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
        episodes: the episodes, whose controllers all have an environment with the same arguments.
        cache: folder of the trainings and tunings.
    """

    set: str
    task: Task
    episodes: tuple[Episode, ...]
    cache: Path

    def __str__(self) -> str:
        return str(self.task)


def jobs(set_name: str, episodes: Sequence[Episode], cache: Path) -> list[Job]:
    """Return a job for each task and each form of its environment; its building is started once for all its episodes.

    The forms are that of the baseline control, without actuators, that of the task, and those of learning controllers.
    """
    groups: dict[tuple[Task, str], list[Episode]] = {}
    for episode in episodes:
        groups.setdefault((episode.task, digest_of(_arguments(set_name, episode))), []).append(episode)
    return [Job(set_name, task, tuple(group), cache) for (task, _), group in groups.items()]


def _arguments(set_name: str, episode: Episode) -> dict[str, Any]:
    """Return the arguments of an episode's environment."""
    arguments = SETS[set_name].controller_arguments(episode.controller, episode.task)
    return without_actuators(arguments) if episode.controller == BASELINE else arguments | _own_form(episode.controller)


def _own_form(controller: str) -> dict[str, Any]:
    """Return the argument `relative` of a user's training, if the controller is the folder of one that has it."""
    folder = Path(controller).expanduser()
    if not is_training(folder):
        return {}
    relative = read_training_fields(folder).get("arguments", {}).get("relative")
    return {} if relative is None else {"relative": relative}


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
    """Run the episodes of a job.

    Each episode has a new controller and starts from the same state, so its row does not depend on the others.

    Returns:
        The rows, and the errors of the episodes that failed.
    """
    rows: list[Row] = []
    errors: list[str] = []
    with closing(BuildingEnv(**_arguments(job.set, job.episodes[0]))) as env:
        for episode in job.episodes:
            try:
                rows.append(_run_episode(job, env, episode))
            except Exception as error:  # of a user's controller; the others still run
                errors.append(f"{episode}: {describe_error(error)}")
    return rows, errors


def _run_episode(job: Job, env: BuildingEnv, episode: Episode) -> Row:
    begin = tree_processor_s()
    agent = Agent(_controller(job, env.manifest, episode), env)
    agent.seed_episode(episode.seed)
    linear = LinearReward(env.manifest)
    result, _ = run_episode(env, lambda _: agent.action(env.sample), seed=episode.seed, recorder=linear)
    return _row(episode, result, linear.total, tree_processor_s() - begin)


def _controller(job: Job, manifest: Manifest, episode: Episode) -> Any:
    name = episode.controller
    file = preparation_of(episode, job.set, job.cache).file if is_prepared(name) else None
    return make_task_controller(name, manifest, episode.task, episode.seed, file)


def make_task_controller(name: str, manifest: Manifest, task: Task, seed: int, file: Path | None = None) -> Any:
    """Return a controller of the benchmark, or another one, for an episode.

    Args:
        name: its name in the benchmark, or as for `load_controller`.
        manifest: the environment's.
        task: what is controlled.
        seed: seed of the episode, which controllers that draw or plan have as well.
        file: the finished training or tuning of one that is trained or tuned for each task.

    Raises:
        ControllerMismatch: it cannot control this environment.
        UnknownName, InvalidConfig: see `load_controller`.
    """
    if file is not None and name == TUNED:
        factory = load_controller(rule_of(task.building)["controller"])
        return make_controller(factory, manifest, read_record(file)["parameters"])
    if file is not None:
        return make_controller(load_controller(str(file)), manifest, {})
    if name == "pid":
        return TwoLoopPID(manifest)
    parameters = dict(BASELINES.get(name, {}))
    if name in ("random", "oracle"):
        parameters["seed"] = seed
    return make_controller(load_controller(name), manifest, parameters)


def _row(episode: Episode, result: EpisodeMetrics, linear: float, seconds: float) -> Row:
    metrics = result.metrics()
    assert result.reward is not None, "the tasks have a reward"
    return Row(
        episode.controller, *episode.task.key, episode.seed, float(result.reward),
        {name: float(value) for name, value in result.terms.items()}, linear,
        {name: float(value) for name in _METRICS if (value := metrics.get(name)) is not None},
        episode.training_seed, round(seconds, 2),
    )  # fmt: skip
