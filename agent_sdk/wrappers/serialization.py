"""A chain of wrappers as data: names and arguments, as a scenario file or a recipe has them."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from typing import Any
from weakref import WeakKeyDictionary

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from pydantic import BaseModel

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.changing_context import ChangingContext
from agent_sdk.wrappers.cyclic_time import CyclicTime
from agent_sdk.wrappers.discrete_incremental_action import DiscreteIncrementalAction
from agent_sdk.wrappers.episode_log import EpisodeLog
from agent_sdk.wrappers.incremental_action import IncrementalAction
from agent_sdk.wrappers.metric_loggers import TensorBoardLog, WeightsAndBiasesLog
from agent_sdk.wrappers.names import refuse_inside
from agent_sdk.wrappers.previous_observation import PreviousObservation
from agent_sdk.wrappers.reduced_observation import ReducedObservation
from agent_sdk.wrappers.reward_vector import RewardVector
from agent_sdk.wrappers.setpoint_difference import SetpointDifference
from agent_sdk.wrappers.time_series_observation import TimeSeriesObservation
from agent_sdk.wrappers.weather_forecast import WeatherForecast
from topics.errors import InvalidConfig, did_you_mean

OURS: dict[str, type[BuildingWrapper]] = {
    wrapper.__name__: wrapper
    for wrapper in (
        CyclicTime,
        PreviousObservation,
        WeatherForecast,
        TimeSeriesObservation,
        SetpointDifference,
        ReducedObservation,
        IncrementalAction,
        DiscreteIncrementalAction,
        RewardVector,
        ChangingContext,
        EpisodeLog,
        TensorBoardLog,
        WeightsAndBiasesLog,
    )
}
"""The wrappers of `agent_sdk.wrappers` by name."""

GYMNASIUMS = (
    "ClipAction", "ClipReward", "DelayObservation", "DiscretizeAction", "DiscretizeObservation", "DtypeObservation",
    "FlattenObservation", "FrameStackObservation", "MaxAndSkipObservation", "NormalizeObservation", "NormalizeReward",
    "RecordEpisodeStatistics", "RepeatAction", "RescaleAction", "RescaleObservation", "StickyAction",
    "TimeAwareObservation", "TimeLimit",
)  # fmt: skip
"""Gymnasium's wrappers that can be written as data."""

_MADE_BY_GYM_MAKE = ("PassiveEnvChecker", "OrderEnforcing", "TimeLimit")
_ONE_NUMBER = ("ClipReward", "NormalizeReward", "RecordEpisodeStatistics")
_ARRAYS = ("min_action", "max_action", "min_obs", "max_obs")
_given: WeakKeyDictionary[Any, dict[str, Any]] = WeakKeyDictionary()


def apply_wrappers(env: Any, wrappers: Sequence[Mapping[str, Any]]) -> Any:
    """The environment, single or vector, with wrappers around it, the first one innermost.

    Args:
        env: what is wrapped.
        wrappers: `{"wrapper": "CyclicTime", "fields": ["hour"]}` each: a name of `agent_sdk.wrappers` or one of
            Gymnasium's (`GYMNASIUMS`), and its arguments.

    Raises:
        InvalidConfig: no such wrapper, no such argument, one that cannot be, or an order that cannot work. The
            environment is as it was.
    """
    made = []
    try:
        for at, one in enumerate(wrappers):
            env = _apply(env, one, f"wrappers[{at}]")
            made.append(env)
    except BaseException:
        for wrapper in made:
            if isinstance(wrapper, BuildingWrapper):
                wrapper.let_go()
        raise
    return env


def _apply(env: Any, one: Mapping[str, Any], where: str) -> Any:
    if not isinstance(one, Mapping) or not isinstance(one.get("wrapper"), str):
        raise InvalidConfig(f"{where}: {one!r}; write {{'wrapper': 'CyclicTime', …}}")
    name, said = one["wrapper"], {key: value for key, value in one.items() if key != "wrapper"}
    kind = _class(name, isinstance(env, VectorEnv), where)
    if name in _ONE_NUMBER:
        refuse_inside(env, ["RewardVector"], f"{where}: {name} needs a number as reward; put it before {{}}")
    arguments = said if name in OURS else {key: _for_gymnasium(key, value) for key, value in said.items()}
    try:
        known = [*inspect.signature(kind).parameters][1:]
        if unknown := [key for key in said if key not in known]:
            raise InvalidConfig(f"{where}: {name} has no argument {unknown[0]!r}; {did_you_mean(unknown[0], known)}")
        wrapper = kind(env, **arguments)
    except (TypeError, ValueError, AssertionError, gym.error.Error) as error:
        raise InvalidConfig(f"{where}: {name}: {error}") from None
    _given[wrapper] = deepcopy(said)
    return wrapper


def _class(name: str, vectors: bool, where: str) -> Any:  # noqa: FBT001  # a private question
    if name not in (*OURS, *GYMNASIUMS):
        raise InvalidConfig(f"{where}: there is no wrapper {name!r}; {did_you_mean(name, (*OURS, *GYMNASIUMS))}")
    if name in OURS:
        return OURS[name]
    room = gym.wrappers.vector if vectors else gym.wrappers
    if not hasattr(room, name):
        raise InvalidConfig(f"{where}: {name} has no vector form; wrap each environment before they become a vector")
    return getattr(room, name)


def _for_gymnasium(key: str, value: Any) -> Any:
    if key in _ARRAYS and not isinstance(value, bool):
        return np.array(value, np.float32) if isinstance(value, list) else np.float32(value)
    return tuple(value) if isinstance(value, list) else value


def wrappers_of(env: Any) -> list[dict[str, Any]]:
    """The wrappers around `env` as `apply_wrappers` takes them, the innermost first; those of `gym.make` are left out.

    Raises:
        InvalidConfig: a wrapper, or an argument of one, that cannot be written as data.
    """
    chain = list(_chain(env))[::-1]
    while chain and type(chain[0]).__name__ in _MADE_BY_GYM_MAKE and chain[0] not in _given:
        del chain[0]
    return [_told(layer) for layer in chain if type(layer).__name__ not in _MADE_BY_GYM_MAKE[:2]]


def _chain(env: Any) -> Iterator[Any]:
    while isinstance(env, gym.Wrapper | VectorWrapper):
        yield env
        env = env.env


def _told(layer: Any) -> dict[str, Any]:
    name = type(layer).__name__
    theirs = name in GYMNASIUMS and type(layer).__module__.startswith("gymnasium.")
    if not (theirs or isinstance(layer, BuildingWrapper)):
        raise InvalidConfig(f"{name} cannot be written as data; {did_you_mean(name, (*OURS, *GYMNASIUMS))}")
    if layer in _given:
        return {"wrapper": name, **deepcopy(_given[layer])}
    said = getattr(layer, "_saved_kwargs", None)
    if said is None:
        raise InvalidConfig(f"{name} does not tell its arguments; make it by apply_wrappers")
    defaults = {key: found.default for key, found in inspect.signature(type(layer)).parameters.items()}
    kept = said if not theirs else {k: v for k, v in said.items() if not _same(v, defaults.get(k))}
    return {"wrapper": name, **{key: _plain(value, f"{name}: {key}") for key, value in kept.items() if key != "env"}}


def _same(value: Any, default: Any) -> bool:
    return not isinstance(value, np.ndarray) and type(value) is type(default) and bool(value == default)


def _plain(value: Any, where: str) -> Any:
    """As JSON and YAML have it."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: _plain(inner, f"{where}.{key}") for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner, where) for inner in value]
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_unset=True)
    if hasattr(value, "__fspath__"):
        return str(value)
    raise InvalidConfig(f"{where}: {type(value).__name__} cannot be written as data")
