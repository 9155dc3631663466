"""Bounds: the best known score of each task and seed, by search on its true model.

The search simulates whole episodes with the weather and noise of the task, in branches of its first sample. It begins
with the best of some controllers' sequences. Actions are absolute, as those of the task, or offsets to the baseline
control, which 0 leaves as it is to the bit: the form is that in which the best controller was recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from zenostat.agent_sdk.controllers import Agent, load_controller
from zenostat.agent_sdk.controllers.action_roles import setpoint_pairs
from zenostat.agent_sdk.controllers.base import BaselineController
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.lab.benchmark.bound_file import Bound, bound_path, definition_of, load_bound, packed
from zenostat.lab.benchmark.bound_moves import Actions, SequenceSpace
from zenostat.lab.benchmark.bound_search import Best, Simulated, search
from zenostat.lab.benchmark.definition import BASELINE, BASELINES, SETS, TUNED, Task, is_prepared
from zenostat.lab.benchmark.episodes import LinearReward, make_task_controller
from zenostat.lab.benchmark.prepared import Preparation, check_published
from zenostat.lab.benchmark.results import NEEDED_VERSIONS, changed_versions, current_versions
from zenostat.lab.benchmark.selection import Selection
from zenostat.lab.evaluate import run_episode
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.file_lock import locked

RELATIVE_K = 8.0
"""Bound of the offsets to the baseline control, K; they are clipped to the actuators' bounds as well."""

CONTROLLERS = ("baseline", "fixed", "rbc", "oracle")
"""Controllers with whose sequences the search can begin."""

SIMULATIONS = 1000

_TIE = 1e-6
"""Relative difference below which sequences are equal but for rounding; then the first one, of offsets, is kept."""

Progress = Callable[[int, float], None]
"""Callback with the number of simulations so far and the best total reward."""


@dataclass(frozen=True)
class BoundTask:
    """A task and seed whose bound is searched.

    Attributes:
        set: name of the set.
        task: the task.
        seed: seed of the episode.
        folder: folder of the bounds.
        controllers: names of controllers of the benchmark, or others as for `load_controller`.
        hashes: sha256 of models and weather files by name.
        policies: folder with the tuned rules and trained policies (of the training 0) among the controllers.
    """

    set: str
    task: Task
    seed: int
    folder: Path
    controllers: Sequence[str] = CONTROLLERS
    hashes: Mapping[str, str] = field(default_factory=dict)
    policies: Path | None = None

    def __str__(self) -> str:
        return f"{self.task}/{self.seed}"

    def prepared(self, controller: str) -> Path | None:
        """Return the file of a controller that is trained or tuned for each task; None of any other one.

        Raises:
            InvalidConfig: the folder of policies does not have it, or one of another definition.
        """
        if not is_prepared(controller):
            return None
        training_seed = None if controller == TUNED else 0
        return check_published(
            Preparation(
                self.folder, self.set, controller, self.task.building, self.task.season, training_seed, self.policies
            )
        )

    @property
    def path(self) -> Path:
        """Its file."""
        return bound_path(self.folder, self.task, self.seed)

    def arguments(self, relative_k: float | None) -> dict[str, Any]:
        """Return the arguments of its environment, with absolute actions or offsets within ±`relative_k`."""
        arguments = SETS[self.set].arguments(*self.task.key)
        return arguments if relative_k is None else arguments | {"relative": relative_k}


def tasks_of(set_name: str, **conditions: Sequence[Any] | None) -> list[tuple[Task, int]]:
    """Return the tasks and seeds of a set that meet conditions.

    Args:
        set_name: a key of `SETS`.
        conditions: allowed values by `building`, `season`, `weather` and `seed`; None: all.

    Raises:
        UnknownName: there is no such set or value, or nothing meets all conditions.
    """
    if set_name not in SETS:
        raise UnknownName(f"there is no set {set_name!r}; {did_you_mean(set_name, SETS, limit=len(SETS))}")
    selection, episodes = Selection(**conditions), SETS[set_name].episodes([BASELINE])
    selection.check(episodes, f"the set {set_name!r}")
    return [(episode.task, episode.seed) for episode in episodes if selection.has(episode)]


def check_starts(jobs: Sequence[BoundTask]) -> None:
    """Check the controllers with which searches begin, and that new ones have those that are prepared.

    Raises:
        UnknownName, InvalidConfig: see `load_controller` and `BoundTask.prepared`.
    """
    new = [job for job in jobs if not job.path.exists()]
    for name in dict.fromkeys(name for job in jobs for name in job.controllers):
        if name not in BASELINES:
            load_controller(name)
        for job in new:
            job.prepared(name)


def improve_bound(
    job: BoundTask, simulations: int = SIMULATIONS, *, search_seed: int = 0, progress: Progress | None = None
) -> Bound:
    """Search for a better sequence, and write the file of the task after each stage of the search.

    The result depends on the arguments only, not on interruptions between stages.

    Args:
        job: the task and seed; if it has a file, the search continues there.
        simulations: total number of simulated episodes, those of earlier runs included.
        search_seed: seed of a new search.
        progress: called with the controllers' best or what the file has, and after each stage.

    Raises:
        UnknownName, InvalidConfig: a controller that does not exist, or none fits the task; a file of another
            definition, of other versions, or that another process is writing.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    lock = job.path.with_name(f".{job.path.name}.lock")
    with locked(lock, f"{job.path}: another process is improving this bound"):
        if job.path.exists():
            bound = _continued(job)
        else:
            bound = _first_bound(job, search_seed)
            bound.save(job.folder)
        if progress is not None:
            progress(bound.simulations, bound.reward)
        if bound.simulations < simulations:
            for improved in _stages(job, bound, simulations):
                bound = improved
                bound.save(job.folder)
                if progress is not None:
                    progress(bound.simulations, bound.reward)
    return bound


def _continued(job: BoundTask) -> Bound:
    bound = load_bound(job.path, job.set)
    if changes := [*changed_versions(bound.versions), *bound.changed_files(job.hashes)]:
        raise InvalidConfig(f"{job.path} was made with something else ({'; '.join(changes)}): choose another folder")
    return bound


def _first_bound(job: BoundTask, search_seed: int) -> Bound:
    """Return the best sequence of the controllers."""
    best: Bound | None = None
    starts: dict[str, float] = {}
    timesteps = episode = 0
    for relative_k in (RELATIVE_K, None):
        with closing(BuildingEnv(**job.arguments(relative_k))) as env:
            episode = env.manifest.steps
            for name in job.controllers:
                planner = _CountedPlanner(env)
                recorded = _recorded(job, env, name, planner)
                if recorded is None:
                    continue
                actions, outcome = recorded
                timesteps += planner.timesteps + episode
                starts[f"{name} ({'absolute' if relative_k is None else 'relative'})"] = outcome.reward
                if best is None or outcome.reward > best.reward + _TIE * abs(best.reward):
                    best = _bound(job, relative_k, search_seed, actions, outcome)
    if best is None:
        raise InvalidConfig(f"{job.task}: none of the controllers {', '.join(job.controllers)} fits the task")
    simulations = -(-timesteps // episode)
    curve = ((simulations, best.reward),)
    return best.model_copy(update={"starts": starts, "simulations": simulations, "curve": curve})


class _CountedPlanner:
    """The environment of a controller that plans, with the number of timesteps that its branches simulate.

    Attributes:
        action_space: that of the environment.
        timesteps: simulated timesteps of all branches.
    """

    def __init__(self, env: BuildingEnv) -> None:
        self._env, self.action_space, self.timesteps = env, env.action_space, 0

    def plan(self, actions: ArrayLike, *, forecast_error: Sequence[float] = ()) -> Floats:
        """Return the reward of each timestep of several action sequences."""
        rewards = self._env.plan(actions, forecast_error=forecast_error)
        self.timesteps += rewards.size
        return rewards

    @contextmanager
    def branch(self, *, forecast_error: Sequence[float] = ()) -> Iterator[BuildingEnv]:
        """Create a copy that continues from the present sample."""
        with self._env.branch(forecast_error=forecast_error) as branch:
            first = branch.sample.step
            yield branch
            self.timesteps += branch.sample.step - first


@dataclass(frozen=True)
class _Outcome:
    reward: float
    terms: dict[str, float]
    linear: float


def _bound(job: BoundTask, relative_k: float | None, search_seed: int, actions: Actions, outcome: _Outcome) -> Bound:
    names = (job.task.building, job.task.weather)
    return Bound(
        definition=definition_of(job.set, job.task), building=job.task.building, season=job.task.season,
        weather=job.task.weather, seed=job.seed, relative_k=relative_k, reward=outcome.reward, terms=outcome.terms,
        linear=outcome.linear, starts={}, simulations=0, stages=0, search_seed=search_seed, curve=(),
        hashes={name: job.hashes[name] for name in names if name in job.hashes},
        versions={name: version for name, version in current_versions().items() if name in NEEDED_VERSIONS},
        **packed(actions),
    )  # fmt: skip


def _recorded(job: BoundTask, env: BuildingEnv, name: str, planner: _CountedPlanner) -> tuple[Actions, _Outcome] | None:
    """Return the actions of a controller and their outcome; None if it does not fit this form of actions."""
    try:
        controller = make_task_controller(name, env.manifest, job.task, job.seed, job.prepared(name))
    except ControllerMismatch:
        return None
    if isinstance(controller, BaselineController) and not all(one.relative for one in env.manifest.task.actions):
        return None  # an absolute action always sets a value
    agent = Agent(controller, planner)
    actions: list[Any] = []

    def act(_: Any) -> Any:
        actions.append(agent.action(env.sample))
        return actions[-1]

    outcome = _episode(env, act, job.seed)
    return np.array(actions, np.float32), outcome


def _episode(env: BuildingEnv, act: Callable[[Any], Any], seed: int) -> _Outcome:
    linear = LinearReward(env.manifest)
    result, _ = run_episode(env, act, seed=seed, recorder=linear)
    if result.reward is None:
        raise InvalidConfig("a bound needs a task with a reward")
    terms = {name: float(value) for name, value in result.terms.items()}
    return _Outcome(float(result.reward), terms, float(linear.total))


def _stages(job: BoundTask, bound: Bound, simulations: int) -> Iterator[Bound]:
    """Improve a bound; yield it after each stage of the search."""
    with closing(BuildingEnv(**job.arguments(bound.relative_k))) as env:
        box = env.action_space
        if not isinstance(box, gym.spaces.Box):
            raise InvalidConfig(f"{job.task}: a bound is searched for continuous actions, not for {box}")
        space = SequenceSpace.of(env.manifest, box.low, box.high, setpoint_pairs(env.manifest))
        best = Best(bound.sequence(), bound.reward, bound.simulations, bound.stages, bound.curve)
        model = _Branches(env, job.seed)
        model.begin()
        for improved in search(space, model, best, simulations=simulations, seed=bound.search_seed):
            update: dict[str, Any] = {
                "simulations": improved.simulations, "stages": improved.stages, "curve": improved.curve
            }  # fmt: skip
            if improved.value > best.value:
                outcome = replayed(env, improved.actions, job.seed)
                model.begin()
                update |= {"reward": outcome.reward, "terms": outcome.terms, "linear": outcome.linear}
                update |= packed(improved.actions)
            best, bound = improved, bound.model_copy(update=update)
            yield bound


class _Branches:
    """The model of an episode: an environment and its branches."""

    def __init__(self, env: BuildingEnv, seed: int) -> None:
        self._env, self._seed = env, seed
        self._step_h = env.manifest.step_h

    def begin(self) -> None:
        """Go to the first sample of the episode."""
        self._env.reset(seed=self._seed)

    def compare(self, plans: Actions) -> Floats:
        """Return the returns of plans from the present sample on."""
        returns: Floats = self._env.plan(plans).sum(axis=1)
        return returns

    def advance(self, actions: Actions) -> float:
        """Simulate the next timesteps, and return the sum of rewards."""
        return sum(float(self._env.step(action)[1]) for action in actions)

    def simulate(self, sequences: Sequence[Actions]) -> Simulated:
        """Simulate whole episodes in branches of the first sample."""
        if self._env.sample.step:
            self.begin()
        with self._env.branch(slots=len(sequences)) as branches:
            rollout = branches.rollout(np.stack(sequences))
        rewards, peak = rollout.rewards, rollout.terms.get("peak")
        if peak is None or "demand_kwh" not in rollout.metrics:
            return Simulated(rewards.sum(axis=1), rewards, np.zeros_like(rewards), 0.0)
        demand = rollout.metrics["demand_kwh"] / self._step_h
        highest = float(demand.max(axis=1).sum())
        charge = -float(peak.sum()) / highest if highest > 0.0 else 0.0
        return Simulated(rewards.sum(axis=1), rewards - peak, demand, charge)


def replayed(env: BuildingEnv, actions: Actions, seed: int) -> _Outcome:
    """Run an episode with a sequence of actions, and return its rewards."""
    following = iter(actions)
    return _episode(env, lambda _: next(following), seed)


def check_bound(bound: Bound, set_name: str, hashes: Mapping[str, str] | None = None) -> list[str]:
    """Run the sequence of a bound again, and return which rewards and files differ, if any with the versions that do.

    Empty if the files are the same and all rewards are equal to the bit.
    """
    job = BoundTask(set_name, bound.task, bound.seed, Path())
    with closing(BuildingEnv(**job.arguments(bound.relative_k))) as env:
        shape = (env.manifest.steps, *(env.action_space.shape or ()))
        if bound.shape != shape:
            return [f"{job}: actions of shape {bound.shape}; {shape} expected"]
        outcome = replayed(env, bound.sequence(), bound.seed)
    differences = [f"{job}: {change}" for change in bound.changed_files(hashes or {})]
    for name, value in (("reward", outcome.reward), ("linear", outcome.linear), ("terms", outcome.terms)):
        if getattr(bound, name) != value:
            differences.append(f"{job}: {name} {getattr(bound, name)!r}, now {value!r}")
    versions = [f"{job}: version of {change}" for change in changed_versions(bound.versions)]
    return [*versions, *differences] if differences else []
