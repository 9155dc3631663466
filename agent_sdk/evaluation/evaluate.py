"""What episodes came to, and controllers compared on the same weather."""

from __future__ import annotations

import importlib
import inspect
import statistics
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym

from agent_sdk.controllers import Agent, BaselineController, ControllerProtocol, load_controller, make_controller
from agent_sdk.controllers.parameters import ControllerMismatch
from agent_sdk.envs.arguments import of_scenario
from agent_sdk.envs.building_env import BuildingEnv
from agent_sdk.evaluation.metrics import EpisodeMetrics, MetricsAccumulator
from topics.errors import InvalidAction, InvalidConfig, UsageError, did_you_mean
from topics.messages import Manifest

Maker = Callable[..., ControllerProtocol]
"""Makes a controller from a node's manifest and parameters by name: a class, or what `load_policy` gives."""

Progress = Callable[[str, int, int, int], None]
"""Told of each timestep: the controller's name, the episode's number, the step, the steps of an episode."""


def run_episode(
    env: gym.Env[Any, Any],
    act: Callable[[Any], Any],
    *,
    seed: int | None,
    progress: Callable[[int], None] | None = None,
) -> tuple[EpisodeMetrics, str]:
    """One episode, and the weather that it had.

    Args:
        env: a `BuildingEnv`, wrapped or not. The reward that counts is the building's, as no wrapper changed it.
        act: the observation to the action.
        seed: of `reset`.
        progress: told the number of each step.
    """
    observation, info = env.reset(seed=seed)
    building: Any = env.unwrapped
    tally, weather, terminated, ended = (
        MetricsAccumulator(building.manifest, building.reward),
        info.get("weather", ""),
        False,
        False,
    )
    tally.add(building.sample)
    while not ended:
        observation, _, terminated, truncated, info = env.step(act(observation))
        tally.add(building.sample, info.get("reward_terms"))
        ended = terminated or truncated
        if progress is not None:
            progress(building.sample.step)
    return tally.result(terminated=bool(terminated)), weather


# Several controllers


@dataclass(frozen=True, slots=True)
class EpisodeRecord:
    """One episode of one controller."""

    controller: str
    episode: int
    seed: int
    weather: str
    result: EpisodeMetrics


@dataclass(frozen=True, slots=True)
class MetricSummary:
    """A metric over the episodes of a controller.

    Attributes:
        count: how many.
        mean: over them.
        deviation: the sample's standard deviation, divided by count - 1; None for one episode.
        interval: the ends of the mean's 95 % confidence interval by Student's t; None for one episode, or where
            SciPy is not installed.
    """

    count: int
    mean: float
    deviation: float | None
    interval: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Episodes of some controllers in the same scenario and weathers.

    Attributes:
        rows: by controller, then by episode.
        sources: by metric, what it is measured by.
        unfit: by controller that was left out, since it does not fit the scenario, why.
    """

    rows: tuple[EpisodeRecord, ...]
    sources: dict[str, str]
    unfit: dict[str, str] = field(default_factory=dict)

    def table(self) -> list[dict[str, Any]]:
        """A dictionary of the same keys for each row; None where a metric is not known."""
        metrics = [row.result.metrics() for row in self.rows]
        names = dict.fromkeys(name for one in metrics for name in one)
        return [
            {"controller": row.controller, "episode": row.episode, "seed": row.seed, "weather": row.weather}
            | {name: one.get(name) for name in names}
            for row, one in zip(self.rows, metrics, strict=True)
        ]

    def summary(self) -> dict[str, dict[str, MetricSummary]]:
        """By controller and metric; metrics that some episode does not know are left out."""
        values: dict[str, dict[str, list[float | None]]] = {}
        for row in self.rows:
            for name, value in row.result.metrics().items():
                values.setdefault(row.controller, {}).setdefault(name, []).append(value)
        return {
            controller: {name: _spread(known) for name, known in of.items() if None not in known}
            for controller, of in values.items()
        }


def _spread(values: Sequence[Any]) -> MetricSummary:
    count, mean = len(values), statistics.fmean(values)
    if count == 1:
        return MetricSummary(1, mean, None, None)
    deviation = statistics.stdev(values)
    quantile = _student(count - 1)
    half = None if quantile is None else quantile * deviation / count**0.5
    return MetricSummary(count, mean, deviation, None if half is None else (mean - half, mean + half))


def _student(freedom: int) -> float | None:
    """The 97.5 % quantile of Student's t; None without SciPy."""
    try:
        return float(importlib.import_module("scipy.stats").t.ppf(0.975, freedom))
    except ImportError:
        return None


def evaluate(
    scenario: str | Path | Mapping[str, Any],
    controllers: Sequence[str] | Mapping[str, str | Maker],
    *,
    episodes: int = 1,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    **given: Any,
) -> Evaluation:
    """Runs controllers one after the other, each through the same episodes.

    Episode k is reset with `seed + k`, whoever controls, so that all have the same weather; a controller that takes a
    `seed` is made with `seed`. Each controller has an environment of its own, so that nothing of another one's
    episodes is left in it. The same call gives the same numbers. A controller that does not fit the scenario, or whose
    answers no action can say, is left out, and `Evaluation.unfit` says why; the others go on.

    Args:
        scenario: an id, a scenario file (.yaml), or arguments of `BuildingEnv` by name.
        controllers: as `load_controller` takes them, or `ppo:model.zip` (see `load_policy`); or these, or classes, by
            the names that they get in the tables. `building` is evaluated without actuators.
        episodes: for each controller.
        seed: at least 0.
        parameters: of the controllers; each has those that it takes.
        progress: told of each timestep.
        given: arguments of `BuildingEnv` that go before those of the scenario.

    Raises:
        UsageError: a controller, a parameter or a scenario that cannot be, or none of the controllers fits it.
    """
    if episodes < 1 or seed < 0:
        raise InvalidConfig(f"episodes={episodes}, seed={seed}: at least one episode and a seed of at least 0 expected")
    settings = {**of_scenario(scenario), **given}
    makers = _makers(controllers)
    shares = _shares(makers, parameters or {}, seed)
    rows: dict[str, list[EpisodeRecord]] = {}
    sources: dict[str, str] = {}
    ready: dict[str, ControllerProtocol] = {}
    unfit: dict[str, UsageError] = {}
    for name in sorted(makers, key=lambda one: _is_the_buildings(makers[one])):
        own = _is_the_buildings(makers[name])
        with closing(BuildingEnv(**(_without_actuators(settings) if own else settings))) as env:
            if name not in ready and name not in unfit:
                same = [one for one in makers if _is_the_buildings(makers[one]) == own]
                ready |= _fitting({one: makers[one] for one in same}, env.manifest, shares, unfit)
            if name not in unfit:
                try:
                    rows[name] = _episodes(name, ready[name], env, range(seed, seed + episodes), progress)
                except InvalidAction as error:
                    unfit[name] = error
            sources = MetricsAccumulator(env.manifest, env.reward).sources | sources
    if not rows:
        raise next(iter(unfit.values()))
    told = {name: str(unfit[name]) for name in makers if name in unfit}
    return Evaluation(tuple(row for name in makers for row in rows.get(name, ())), sources, told)


def _fitting(
    makers: Mapping[str, Maker],
    manifest: Manifest,
    shares: Mapping[str, dict[str, Any]],
    unfit: dict[str, UsageError],
) -> dict[str, ControllerProtocol]:
    """The controllers that the node has all for; the others are put into `unfit`."""
    ready = {}
    for name, maker in makers.items():
        try:
            ready[name] = make_controller(maker, manifest, shares[name])
        except ControllerMismatch as error:
            unfit[name] = error
    return ready


def _episodes(
    name: str, controller: ControllerProtocol, env: BuildingEnv, seeds: Sequence[int], progress: Progress | None
) -> list[EpisodeRecord]:
    agent, steps = Agent(controller), env.manifest.steps
    rows = []
    for number, seed in enumerate(seeds):
        told = None if progress is None else partial(progress, name, number)
        result, weather = run_episode(
            env,
            lambda _: agent.action(env.sample),
            seed=seed,
            progress=None if told is None else lambda step, told=told: told(step, steps),  # type: ignore[misc]
        )
        rows.append(EpisodeRecord(name, number, seed, weather, result))
    return rows


def _is_the_buildings(maker: Maker) -> bool:
    return isinstance(maker, type) and issubclass(maker, BaselineController)


def _without_actuators(settings: Mapping[str, Any]) -> dict[str, Any]:
    """An action sets its actuators always, so the building's own control has none."""
    return {name: value for name, value in settings.items() if name not in ("actions", "control", "discrete")} | {
        "actuators": {}
    }


def _makers(controllers: Sequence[str] | Mapping[str, str | Maker]) -> dict[str, Maker]:
    if isinstance(controllers, str) or not controllers:
        raise InvalidConfig(f"controllers: a list of names expected, as ['building', 'rbc'], got {controllers!r}")
    named = controllers if isinstance(controllers, Mapping) else dict(zip(controllers, controllers, strict=True))
    if len(named) < len(controllers):
        twice = next(name for name in controllers if list(controllers).count(name) > 1)
        raise InvalidConfig(f"the controller {twice} stands twice; the same controller gives the same numbers")
    return {name: _maker(given) if isinstance(given, str) else given for name, given in named.items()}


def _maker(text: str) -> Maker:
    if text.casefold().endswith(".zip"):
        from agent_sdk.training import load_policy  # torch takes seconds to import

        return load_policy(text)
    return load_controller(text)


def _shares(makers: Mapping[str, Maker], parameters: Mapping[str, Any], seed: int) -> dict[str, dict[str, Any]]:
    """The parameters of each controller: those that it names, or, if none names it, that any takes."""
    signatures = {name: list(inspect.signature(maker).parameters.values())[1:] for name, maker in makers.items()}
    takes = {
        name: [p.name for p in of if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD)]
        for name, of in signatures.items()
    }
    takes_any = [name for name, of in signatures.items() if any(p.kind is p.VAR_KEYWORD for p in of)]
    shares: dict[str, dict[str, Any]] = {name: {} for name in makers}
    for parameter, value in parameters.items():
        takers = [name for name, known in takes.items() if parameter in known] or takes_any
        if not takers:
            all_known = [known for of in takes.values() for known in of]
            raise InvalidConfig(
                f"none of the controllers takes the parameter {parameter!r}; {did_you_mean(parameter, all_known)}"
            )
        for name in takers:
            shares[name][parameter] = value
    for name, maker in makers.items():
        if "seed" in takes[name] and "seed" not in getattr(maker, "keywords", {}):
            shares[name].setdefault("seed", seed)
    return shares
