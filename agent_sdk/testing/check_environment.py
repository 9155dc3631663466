"""Checks for environments."""

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

from agent_sdk.testing.report import Check, Report, raised, run
from topics.errors import ZenostatError
from topics.messages import Manifest

Env = gym.Env[Any, Any]

_AMID = 30
_RESET_KEYS = ("time", "step", "effective", "late", "rejected", "weather", "weather_noise")
_STEP_KEYS = ("time", "step", "effective", "late", "rejected")
_ROUNDING = 1e-9


def check_environment(env: Env, *, most: int = 10_000, skip: Iterable[str] = ()) -> Report:
    """Checks an environment of Zenostat's kind: one of its own, under wrappers, or somebody else's.

    It is reset and stepped a dozen times and stays open.

    Args:
        env: of one building.
        most: an episode that has not ended after so many timesteps is not followed further.
        skip: names of checks to leave out.

    Returns:
        What was checked.

    Raises:
        ConformanceError: all that is wrong, each with the name of its check.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return run(str(env), ENVIRONMENT_CHECKS, _Stage(env, most), skip).require()


class _Stage:
    """An environment and one whole episode of it."""

    def __init__(self, env: Env, most: int) -> None:
        self.env, self.most = env, most
        self.manifest: Manifest | None = getattr(env.unwrapped, "manifest", None)
        self._episode: list[tuple[Any, ...]] | None = None

    @property
    def episode(self) -> list[tuple[Any, ...]]:
        """(observation, reward, terminated, truncated, info) of each sample; sample 0 has no reward."""
        if self._episode is None:
            self._episode = play(self.env, 1, self.most)
        return self._episode


def play(env: Env, seed: int, most: int) -> list[tuple[Any, ...]]:
    """An episode of at most so many random steps, all drawn from the seed."""
    env.action_space.seed(seed)
    observation, info = env.reset(seed=seed)
    came: list[tuple[Any, ...]] = [(observation, 0.0, False, False, info)]
    while len(came) <= most and not (came[-1][2] or came[-1][3]):
        came.append(env.step(env.action_space.sample()))
    return came


def _plays(stage: _Stage) -> Iterator[str]:
    try:
        came = play(stage.env, 1, 1)
    except Exception as error:
        yield raised(error, "reset(seed=1) or a step")
        return
    if len(came[-1]) != 5:
        yield f"step gave {len(came[-1])} values; observation, reward, terminated, truncated and info expected"


def _gymnasium(stage: _Stage) -> Iterator[str]:
    check_env(stage.env, skip_render_check=True)
    yield from ()


def _steps(stage: _Stage) -> Iterator[str]:
    count = len(stage.episode) - 1
    ends = [(terminated, truncated) for _, _, terminated, truncated, _ in stage.episode]
    if not any(ends[-1]):
        yield f"the episode has not ended after {count} timesteps"
    if stage.manifest is not None and ends[-1] == (False, True) and count != stage.manifest.steps:
        yield f"the episode was truncated after {count} timesteps; {stage.manifest.steps} expected"
    if any(not isinstance(flag, bool | np.bool_) for pair in ends for flag in pair):
        yield "terminated and truncated are no truth values"


def _observed(stage: _Stage) -> Iterator[str]:
    space = stage.env.observation_space
    for step, (observation, *_) in enumerate(stage.episode):
        if not space.contains(observation):
            yield f"the observation of sample {step} is not in the observation space{_where(space, observation)}"
            return


def _where(space: Any, observation: Any) -> str:
    if not isinstance(space, Box) or np.shape(observation) != space.shape:
        return f": shape {np.shape(observation)}, {space} expected"
    outside = np.flatnonzero(~((observation >= space.low) & (observation <= space.high)))
    if len(outside):
        first = outside[0]
        return f": value {first} is {observation[first]:g}, bounds {space.low[first]:g} to {space.high[first]:g}"
    return f": {observation.dtype}, {space.dtype} expected"


def _rewarded(stage: _Stage) -> Iterator[str]:
    for step, (_, reward, _, _, info) in enumerate(stage.episode[1:], start=1):
        if not isinstance(reward, float) or not np.isfinite(reward):
            yield f"the reward of step {step} is {reward!r}; a finite float expected"
            return
        terms = info.get("reward_terms") if isinstance(info, dict) else None
        if terms is not None and not np.isclose(sum(terms.values()), reward, rtol=_ROUNDING, atol=_ROUNDING):
            yield f"the reward of step {step} is {reward:g}; its reward_terms add up to {sum(terms.values()):g}"
            return


def _informed(stage: _Stage) -> Iterator[str]:
    infos = [info for *_, info in stage.episode]
    for when, info, keys in (("reset", infos[0], _RESET_KEYS), ("step", infos[1], _STEP_KEYS)):
        missing = [key for key in keys if key not in info]
        if missing:
            yield f"the info of {when} lacks {', '.join(missing)}"
    steps = [info.get("step") for info in infos]
    if "step" in infos[0] and steps != list(range(len(infos))):
        yield f"info['step'] counts {steps[:4]} ...; 0, 1, 2, 3 ... expected"
    if all("time" in info for info in infos):
        times = [datetime.fromisoformat(info["time"]) for info in infos]
        lengths = {after - before for before, after in pairwise(times)}
        if len(lengths) != 1 or min(lengths).total_seconds() <= 0:
            yield "info['time'] does not go on by one timestep each step"


def _named(stage: _Stage) -> Iterator[str]:
    env, observation = stage.env, stage.episode[-1][0]
    try:
        names = tuple(env.get_wrapper_attr("observation_names"))
        named = env.get_wrapper_attr("observation_dict")(observation)
    except AttributeError as error:
        yield f"it has no observation_names or no observation_dict: {error}"
        return
    if len(set(names)) != len(names):
        yield "observation_names has a name twice"
    if (len(names),) != np.shape(observation):
        yield f"observation_names has {len(names)} names for an observation of shape {np.shape(observation)}"
    elif tuple(named) != names or not np.array_equal(np.array(list(named.values()), np.float32), observation):
        yield "observation_dict does not give the observation's values by observation_names"


def _seeded(stage: _Stage) -> Iterator[str]:
    amid = play(stage.env, 1, _AMID)
    yield from _difference(stage.episode, amid, "the same seed and actions gave another episode")


def _anew(stage: _Stage) -> Iterator[str]:
    play(stage.env, 2, _AMID // 2)
    after = play(stage.env, 1, _AMID)
    yield from _difference(stage.episode, after, "an episode that was left amid leaves a trace in the next")


def _difference(these: list[tuple[Any, ...]], those: list[tuple[Any, ...]], what: str) -> Iterator[str]:
    for step, (this, that) in enumerate(zip(these, those, strict=False)):
        if not np.array_equal(this[0], that[0], equal_nan=True):
            yield f"{what}: the observation of sample {step} differs"
            return
        if this[1:4] != that[1:4]:
            yield f"{what}: reward or end of step {step} differ: {this[1:4]} and {that[1:4]}"
            return


def _strict(stage: _Stage) -> Iterator[str]:
    env = stage.env
    if not isinstance(env.action_space, Box) or not env.action_space.shape[0]:
        return
    _, info = env.reset(seed=1)
    bad = np.full(env.action_space.shape, np.nan, env.action_space.dtype)
    try:
        env.step(bad)
    except (ZenostatError, gym.error.Error):
        *_, info = env.step(env.action_space.sample())
        if info.get("step", 1) != 1:
            yield f"a refused action was simulated: the step after it is {info['step']}; 1 expected"
        return
    yield "an action that is not a number was taken; InvalidAction expected"


def _over(stage: _Stage) -> Iterator[str]:
    play(stage.env, 1, stage.most)
    try:
        stage.env.step(stage.env.action_space.sample())
    except (ZenostatError, gym.error.Error):
        return
    yield "a step after the episode's end was taken; EpisodeChanged expected"


ENVIRONMENT_CHECKS: dict[str, Check[_Stage]] = {
    "can be reset and stepped": _plays,
    "gymnasium's own checks": _gymnasium,
    "an episode has its N timesteps": _steps,
    "observations are in their space": _observed,
    "rewards are finite, and the sum of their terms": _rewarded,
    "info has its keys, and counts": _informed,
    "observations have names": _named,
    "the same seed gives the same episode": _seeded,
    "a reset amid an episode leaves no trace": _anew,
    "an action that is no number is refused": _strict,
    "a step after the end is refused": _over,
}
"""In the order in which `check_environment` runs them."""
