"""Conformance checks for environments."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from datetime import datetime
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env

from zenostat.agent_sdk.testing.report import Check, NotApplicable, Report, raised, run
from zenostat.agent_sdk.wrappers.checkpoint import frozen_statistics
from zenostat.agent_sdk.wrappers.gymnasium_wrappers import Trait, wrappers_with
from zenostat.agent_sdk.wrappers.names import layers, names_of, observation_dict
from zenostat.topics.errors import InvalidConfig, ZenostatError
from zenostat.topics.messages import Manifest

Env = gym.Env[Any, Any]

_PARTIAL_STEPS = 30
_RESET_KEYS = ("time", "step", "effective", "late", "rejected", "weather", "weather_noise")
_STEP_KEYS = ("time", "step", "effective", "late", "rejected")
_ROUNDING = 1e-9
_SKIP_STEPS = wrappers_with(Trait.SKIPS_STEPS)


def check_environment(env: Env, *, max_steps: int = 10_000, skip: Iterable[str] = ()) -> Report:
    """Check an environment with Zenostat's interface: one of Zenostat, wrapped or not, or your own.

    The checks reset the environment about ten times and leave it open. Running statistics of Gymnasium's wrappers stay
    as they are. A check that a wrapper makes impossible is skipped, with the reason in the report.

    Args:
        env: environment of one building.
        max_steps: maximum number of timesteps in an episode; longer episodes fail a check.
        skip: names of checks to skip.

    Returns:
        Report of all checks.

    Raises:
        ConformanceError: some checks failed; the text names each with its errors.
        InvalidConfig: not a single environment.
    """
    if not isinstance(env, gym.Env):
        raise InvalidConfig(f"check_environment checks a single environment, a gymnasium.Env, not {env!r}")
    with warnings.catch_warnings(), frozen_statistics(env):
        warnings.simplefilter("ignore")
        return run(str(env), ENVIRONMENT_CHECKS, _CheckContext(env, max_steps), skip).require()


class _CheckContext:
    """An environment, with one whole episode of it."""

    def __init__(self, env: Env, max_steps: int) -> None:
        self.env, self.max_steps = env, max_steps
        self.manifest: Manifest | None = getattr(env.unwrapped, "manifest", None)
        self._episode: list[tuple[Any, ...]] | None = None

    @property
    def episode(self) -> list[tuple[Any, ...]]:
        """Return (observation, reward, terminated, truncated, info) of each sample; the reward of sample 0 is 0."""
        if self._episode is None:
            self._episode = play(self.env, 1, self.max_steps)
        return self._episode

    def require_without(self, *wrappers: str) -> None:
        """Raise `NotApplicable` if one of these wrappers, within which a check cannot hold, is in the chain."""
        for layer in layers(self.env):
            if type(layer).__name__ in wrappers:
                raise NotApplicable(f"it does not hold within {type(layer).__name__}")


def play(env: Env, seed: int, max_steps: int) -> list[tuple[Any, ...]]:
    """Run an episode of at most `max_steps` random actions, all determined by the seed."""
    env.action_space.seed(seed)
    observation, info = env.reset(seed=seed)
    episode: list[tuple[Any, ...]] = [(observation, 0.0, False, False, info)]
    while len(episode) <= max_steps and not (episode[-1][2] or episode[-1][3]):
        episode.append(env.step(env.action_space.sample()))
    return episode


def _plays(context: _CheckContext) -> Iterator[str]:
    try:
        episode = play(context.env, 1, 1)
    except Exception as error:
        yield raised(error, "reset(seed=1) or a step")
        return
    if len(episode[-1]) != 5:
        yield f"step returned {len(episode[-1])} values; expected observation, reward, terminated, truncated and info"


def _gymnasium(context: _CheckContext) -> Iterator[str]:
    check_env(context.env, skip_render_check=True)
    yield from ()


def _steps(context: _CheckContext) -> Iterator[str]:
    context.require_without("TimeLimit", *_SKIP_STEPS)
    count = len(context.episode) - 1
    ends = [(terminated, truncated) for _, _, terminated, truncated, _ in context.episode]
    if not any(ends[-1]):
        yield f"the episode has not ended after {count} timesteps"
    if context.manifest is not None and ends[-1] == (False, True) and count != context.manifest.steps:
        yield f"the episode was truncated after {count} timesteps; expected {context.manifest.steps}"
    if any(not isinstance(flag, bool | np.bool_) for pair in ends for flag in pair):
        yield "terminated and truncated are not Boolean"


def _observed(context: _CheckContext) -> Iterator[str]:
    space = context.env.observation_space
    for step, (observation, *_) in enumerate(context.episode):
        if not space.contains(observation):
            yield f"the observation of sample {step} is not in the observation space{_explain(space, observation)}"
            return


def _explain(space: Any, observation: Any) -> str:
    if not isinstance(space, Box) or np.shape(observation) != space.shape:
        return f": shape {np.shape(observation)}, expected {space}"
    outside = np.flatnonzero(~((observation >= space.low) & (observation <= space.high)))
    if len(outside):
        first = outside[0]
        return f": value {first} is {observation[first]:g}, bounds {space.low[first]:g} to {space.high[first]:g}"
    return f": {observation.dtype}, expected {space.dtype}"


def _rewarded(context: _CheckContext) -> Iterator[str]:
    context.require_without("NormalizeReward", "ClipReward", "TransformReward", *_SKIP_STEPS)
    space = context.env.get_wrapper_attr("reward_space") if context.env.has_wrapper_attr("reward_space") else None
    for step, (_, reward, _, _, info) in enumerate(context.episode[1:], start=1):
        if space is not None and space.contains(reward) and np.isfinite(reward).all():
            continue  # a vector of terms, as in MO-Gymnasium
        if not isinstance(reward, float) or not np.isfinite(reward):
            yield f"the reward of step {step} is {reward!r}; expected a finite float"
            return
        terms = info.get("reward_terms") if isinstance(info, dict) else None
        if terms is not None and not np.isclose(sum(terms.values()), reward, rtol=_ROUNDING, atol=_ROUNDING):
            yield f"the reward of step {step} is {reward:g}; its reward_terms add up to {sum(terms.values()):g}"
            return


def _informed(context: _CheckContext) -> Iterator[str]:
    context.require_without("NumericInfos", *_SKIP_STEPS)
    infos = [info for *_, info in context.episode]
    for method, info, keys in (("reset", infos[0], _RESET_KEYS), ("step", infos[1], _STEP_KEYS)):
        missing = [key for key in keys if key not in info]
        if missing:
            yield f"the info of {method} lacks {', '.join(missing)}"
    steps = [info.get("step") for info in infos]
    if "step" in infos[0] and steps != list(range(len(infos))):
        yield f"info['step'] counts {steps[:4]} ...; expected 0, 1, 2, 3 ..."
    if all("time" in info for info in infos):
        times = [datetime.fromisoformat(info["time"]) for info in infos]
        lengths = {after - before for before, after in pairwise(times)}
        if len(lengths) != 1 or min(lengths).total_seconds() <= 0:
            yield "info['time'] does not advance by one timestep per step"


def _named(context: _CheckContext) -> Iterator[str]:
    env, observation = context.env, context.episode[-1][0]
    try:
        if isinstance(env, gym.Wrapper) and type(env).__module__.startswith("gymnasium."):
            names, values = _names_by_layers(env, observation)
        else:
            layer: Any = next((layer for layer in layers(env) if hasattr(layer, "observation_names")), env.unwrapped)
            names = tuple(layer.observation_names)
            if isinstance(layer, gym.Wrapper) and not hasattr(layer, "observation_dict"):  # it needs names alone
                values = dict(zip(names, observation, strict=False))
            else:
                values = layer.observation_dict(observation)
    except AttributeError as error:
        yield f"it has no observation_names or no observation_dict: {error}"
        return
    if len(set(names)) != len(names):
        yield "observation_names contains a name twice"
    if (len(names),) != np.shape(observation):
        yield f"observation_names has {len(names)} names for an observation of shape {np.shape(observation)}"
    elif tuple(values) != names or not np.array_equal(np.array(list(values.values()), np.float32), observation):
        yield "observation_dict does not return the values of the observation by observation_names"


def _names_by_layers(env: Env, observation: Any) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Return names and values within Gymnasium's wrappers, which have no names of their own."""
    try:
        return names_of(env), observation_dict(env, observation)
    except InvalidConfig as error:  # after `FrameStackObservation`, for example
        raise NotApplicable(str(error)) from None


def _seeded(context: _CheckContext) -> Iterator[str]:
    again = play(context.env, 1, _PARTIAL_STEPS)
    yield from _difference(context.episode, again, "the same seed and actions resulted in another episode")


def _anew(context: _CheckContext) -> Iterator[str]:
    play(context.env, 2, _PARTIAL_STEPS // 2)
    after = play(context.env, 1, _PARTIAL_STEPS)
    yield from _difference(context.episode, after, "an episode that was not finished affects the next one")


def _difference(expected: list[tuple[Any, ...]], actual: list[tuple[Any, ...]], description: str) -> Iterator[str]:
    for step, (first, second) in enumerate(zip(expected, actual, strict=False)):
        if not np.array_equal(first[0], second[0], equal_nan=True):
            yield f"{description}: the observation of sample {step} differs"
            return
        if not np.array_equal(first[1], second[1]) or first[2:4] != second[2:4]:
            yield f"{description}: reward or end of step {step} differ: {first[1:4]} and {second[1:4]}"
            return


def _strict(context: _CheckContext) -> Iterator[str]:
    context.require_without(*_SKIP_STEPS)
    env = context.env
    if not isinstance(env.action_space, Box) or not env.action_space.shape[0]:
        return
    _, info = env.reset(seed=1)
    bad = np.full(env.action_space.shape, np.nan, env.action_space.dtype)
    try:
        env.step(bad)
    except (ZenostatError, gym.error.Error):
        *_, info = env.step(env.action_space.sample())
        if info.get("step", 1) != 1:
            yield f"a rejected action was simulated: the step after it is {info['step']}; expected 1"
        return
    yield "an action of NaN was accepted; expected InvalidAction"


def _over(context: _CheckContext) -> Iterator[str]:
    context.require_without("TimeLimit")
    play(context.env, 1, context.max_steps)
    try:
        context.env.step(context.env.action_space.sample())
    except (ZenostatError, gym.error.Error):
        return
    yield "a step after the end of the episode was accepted; expected EpisodeChanged"


ENVIRONMENT_CHECKS: dict[str, Check[_CheckContext]] = {
    "can be reset and stepped": _plays,
    "gymnasium's own checks": _gymnasium,
    "an episode has its N timesteps": _steps,
    "observations are in their space": _observed,
    "rewards are finite and equal the sum of their terms": _rewarded,
    "info has its keys and counts steps": _informed,
    "observations have names": _named,
    "the same seed results in the same episode": _seeded,
    "a reset during an episode leaves no trace": _anew,
    "an action of NaN is rejected": _strict,
    "a step after the end is rejected": _over,
}
"""Checks by name, in the order in which `check_environment` runs them."""
