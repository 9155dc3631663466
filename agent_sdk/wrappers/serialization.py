"""Chains of wrappers as data: names and arguments, as in a scenario file."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, VectorEnv, VectorWrapper
from pydantic import BaseModel

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.changing_context import ChangingContext
from zenostat.agent_sdk.wrappers.episode_log import EpisodeLog
from zenostat.agent_sdk.wrappers.gymnasium_wrappers import GYMNASIUMS, Trait, wrappers_with
from zenostat.agent_sdk.wrappers.incremental import DiscreteIncrementalAction, IncrementalAction
from zenostat.agent_sdk.wrappers.metric_loggers import TensorBoardLog, WeightsAndBiasesLog
from zenostat.agent_sdk.wrappers.names import chain, layers, reject_wrappers, unknown_arguments
from zenostat.agent_sdk.wrappers.numeric_infos import NumericInfos
from zenostat.agent_sdk.wrappers.observation import (
    CyclicTime,
    MetricObservation,
    PreviousObservation,
    ReducedObservation,
    SetpointDifference,
)
from zenostat.agent_sdk.wrappers.residual_action import ResidualAction
from zenostat.agent_sdk.wrappers.reward_vector import RewardVector
from zenostat.agent_sdk.wrappers.time_series_observation import TimeSeriesObservation
from zenostat.agent_sdk.wrappers.weather_forecast import WeatherForecast
from zenostat.topics.errors import ErrorCollector, InvalidConfig, did_you_mean

OURS: dict[str, type[BuildingWrapper]] = {
    wrapper.__name__: wrapper
    for wrapper in (
        CyclicTime,
        MetricObservation,
        PreviousObservation,
        WeatherForecast,
        TimeSeriesObservation,
        SetpointDifference,
        ReducedObservation,
        IncrementalAction,
        DiscreteIncrementalAction,
        ResidualAction,
        RewardVector,
        ChangingContext,
        EpisodeLog,
        NumericInfos,
        TensorBoardLog,
        WeightsAndBiasesLog,
    )
}
"""The wrappers of `zenostat.wrappers` by name."""

_CHECKS = ("PassiveEnvChecker", "OrderEnforcing")
_LEFT_OUT = {
    "gymnasium": tuple(name for name in wrappers_with(Trait.KEEPS_POLICY) if name not in GYMNASIUMS),
    "stable_baselines3": ("Monitor",),
    "zenostat": ("_PairedEnv", "_PairedVectorEnv"),
}
"""Wrappers of each package without which a policy acts alike, and which cannot be written as data."""
_SCALAR_REWARD_WRAPPERS = wrappers_with(Trait.SCALAR_REWARD)
_ARRAY_ARGUMENTS = ("min_action", "max_action", "min_obs", "max_obs")
_applied_arguments: WeakKeyDictionary[Any, dict[str, Any]] = WeakKeyDictionary()


def apply_wrappers(env: Any, wrappers: Sequence[Mapping[str, Any]]) -> Any:
    """Apply wrappers to an environment, the first one innermost.

    Args:
        env: single or vector.
        wrappers: each like `{"wrapper": "CyclicTime", "fields": ["hour"]}`: a name of `zenostat.wrappers` or of
            Gymnasium (`GYMNASIUMS`), and its arguments.

    Raises:
        InvalidConfig: there is no such wrapper or argument, an argument is invalid, or the wrappers cannot work in
            this order. The environment is unchanged.
    """
    applied = []
    try:
        for i, entry in enumerate(wrappers):
            env = _apply(env, entry, f"wrappers[{i}]")
            applied.append(env)
    except BaseException:
        for wrapper in applied:
            if isinstance(wrapper, BuildingWrapper):
                wrapper.release()
        raise
    return env


def check_wrappers(wrappers: Sequence[Mapping[str, Any]]) -> None:
    """Check the names of wrappers and of their arguments, without an environment.

    Args:
        wrappers: as for `apply_wrappers`.

    Raises:
        InvalidConfig: lists all unknown wrappers and arguments.
    """
    errors = ErrorCollector()
    for i, entry in enumerate(wrappers):
        errors.collect(partial(_read, entry, f"wrappers[{i}]", vector=False))
    errors.raise_if_any()


def _read(entry: Mapping[str, Any], where: str, *, vector: bool) -> tuple[Any, dict[str, Any]]:
    """Return the class of a wrapper and its arguments, whose names are valid."""
    if not isinstance(entry, Mapping) or not isinstance(entry.get("wrapper"), str):
        raise InvalidConfig(f"{where}: {entry!r} is not a wrapper; write {{'wrapper': 'CyclicTime', …}}")
    name, arguments = entry["wrapper"], {key: value for key, value in entry.items() if key != "wrapper"}
    kind = _class(name, vector, where)
    known = [*inspect.signature(kind).parameters][1:]
    if unknown := unknown_arguments(arguments, known, f"{where}: {name}"):
        raise InvalidConfig("\n".join(unknown))
    return kind, arguments


def _apply(env: Any, entry: Mapping[str, Any], where: str) -> Any:
    kind, original = _read(entry, where, vector=isinstance(env, VectorEnv))
    name = entry["wrapper"]
    if name in _SCALAR_REWARD_WRAPPERS:
        reject_wrappers(env, ["RewardVector"], f"{where}: {name} needs a scalar reward; apply it before {{}}")
    arguments = original
    if name not in OURS:
        arguments = {key: _for_gymnasium(key, value) for key, value in original.items()}
    try:
        wrapper = kind(env, **arguments)
    except (TypeError, ValueError, AssertionError, gym.error.Error) as error:
        raise InvalidConfig(f"{where}: {name}: {error}") from None
    _applied_arguments[wrapper] = deepcopy(original)
    return wrapper


def _class(name: str, vector: bool, where: str) -> Any:  # noqa: FBT001  # private
    if name not in (*OURS, *GYMNASIUMS):
        raise InvalidConfig(f"{where}: there is no wrapper {name!r}; {did_you_mean(name, (*OURS, *GYMNASIUMS))}")
    if name in OURS:
        return OURS[name]
    module = gym.wrappers.vector if vector else gym.wrappers
    if not hasattr(module, name):
        raise InvalidConfig(
            f"{where}: {name} has no vector form; use a single environment (in a training: slots: 1), "
            "or wrap each environment of a SyncVectorEnv"
        )
    return getattr(module, name)


def _for_gymnasium(key: str, value: Any) -> Any:
    if key in _ARRAY_ARGUMENTS and not isinstance(value, bool):
        return np.array(value, np.float32) if isinstance(value, list) else np.float32(value)
    return tuple(value) if isinstance(value, list) else value


def wrappers_of(env: Any) -> list[dict[str, Any]]:
    """Return the wrappers of `env` in the form of `apply_wrappers`, innermost first, without the checks of `gym.make`.

    Raises:
        InvalidConfig: a wrapper or one of its arguments cannot be written as data.
    """
    return [_entry(layer) for layer in list(chain(env))[::-1] if type(layer).__name__ not in _CHECKS]


def policy_wrappers(env: Any) -> list[dict[str, Any]]:
    """Return the wrappers within which a policy of `env` acts, in the form of `apply_wrappers`, innermost first.

    Wrappers that change neither observations nor actions may be left out. Those of the first slot's environment in a
    `SyncVectorEnv` are included.

    Raises:
        InvalidConfig: another wrapper or one of its arguments cannot be written as data, or is in another process.
    """
    if isinstance(env.unwrapped, AsyncVectorEnv):
        raise InvalidConfig("the wrappers within the processes of an AsyncVectorEnv cannot be read")
    wrappers = [layer for layer in layers(env) if isinstance(layer, gym.Wrapper | VectorWrapper)]
    return [_entry(layer) for layer in wrappers[::-1] if not _is_left_out(layer)]


def _is_left_out(layer: Any) -> bool:
    kind = type(layer)
    return kind.__name__ in _LEFT_OUT.get(kind.__module__.partition(".")[0], ())


def _entry(layer: Any) -> dict[str, Any]:
    name = type(layer).__name__
    is_gymnasium = name in GYMNASIUMS and type(layer).__module__.startswith("gymnasium.")
    if not (is_gymnasium or isinstance(layer, BuildingWrapper)):
        raise InvalidConfig(f"{name} cannot be written as data; {did_you_mean(name, (*OURS, *GYMNASIUMS))}")
    if layer in _applied_arguments:
        return {"wrapper": name, **deepcopy(_applied_arguments[layer])}
    # Gymnasium's vector form of a single wrapper records nothing, but the single one in it does.
    records = (getattr(source, "_saved_kwargs", None) for source in (layer, getattr(layer, "wrapper", None)))
    arguments = next((record for record in records if record is not None), None)
    if arguments is None:
        raise InvalidConfig(f"{name} does not record its arguments; create it with apply_wrappers")
    if is_gymnasium:  # which records its defaults as well
        defaults = {key: parameter.default for key, parameter in inspect.signature(type(layer)).parameters.items()}
        arguments = {key: value for key, value in arguments.items() if not _is_default(value, defaults.get(key))}
    plain = {key: _plain(value, f"{name}: {key}") for key, value in arguments.items() if key != "env"}
    return {"wrapper": name, **plain}


def _is_default(value: Any, default: Any) -> bool:
    return not isinstance(value, np.ndarray) and type(value) is type(default) and bool(value == default)


def _plain(value: Any, where: str) -> Any:
    """Convert to JSON and YAML built-ins."""
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
