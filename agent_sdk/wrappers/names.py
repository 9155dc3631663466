"""Which name each value of an observation has, at any level of a chain of wrappers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from gymnasium import Wrapper
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import ArrayLike

from topics.errors import InvalidConfig, did_you_mean

_KEEP_PLACES = {
    "Autoreset", "ClipAction", "ClipReward", "DelayObservation", "DiscretizeAction", "DtypeObservation",
    "HumanRendering", "MaxAndSkipObservation", "NormalizeObservation", "NormalizeReward", "OrderEnforcing",
    "PassiveEnvChecker", "RecordEpisodeStatistics", "RecordVideo", "RenderCollection", "RepeatAction",
    "RescaleAction", "RescaleObservation", "StickyAction", "TimeLimit", "TransformAction", "TransformReward",
    "DictInfoToList",
}  # fmt: skip
"""Gymnasium's wrappers after which value i is still value i."""

_STACK = "FrameStackObservation"
_CHANGE_UNITS = {"NormalizeObservation", "RescaleObservation", "DiscretizeObservation"}
_TIME_AWARE = "TimeAwareObservation"


def layers(env: Any) -> Iterator[Any]:
    """The environment's layers from the outermost to the bare one; of a vector of environments, the first slot's."""
    while True:
        yield env
        if isinstance(env, Wrapper | VectorWrapper):
            env = env.env
        elif inner := inside(env):
            env = inner[0]
        else:
            return


def inside(env: Any) -> Sequence[Any]:
    """The environments that a vector environment of this process holds; none of any other."""
    return (getattr(env, "envs", None) or ()) if isinstance(env, VectorEnv) else ()


def attribute(env: Any, name: str) -> Any:
    """An attribute of the bare environment; of a vector environment, its first slot's.

    Raises:
        InvalidConfig: it has none.
    """
    base = env.unwrapped
    if inner := inside(base):
        base = inner[0].unwrapped
    try:
        if isinstance(base, VectorEnv) and not hasattr(base, name):
            return base.get_attr(name)[0]  # type: ignore[attr-defined]  # those in other processes have it
        return getattr(base, name)
    except AttributeError:
        raise InvalidConfig(f"{base} has no {name!r}; wrap an environment of zenostat/") from None


def names_of(env: Any) -> tuple[str, ...]:
    """Names of the observation's values as they come out of `env`, single or vector, however it is wrapped.

    Raises:
        InvalidConfig: a wrapper after which the values have no names; the text says which.
    """
    names = tuple(_names(env))
    space = env.single_observation_space if isinstance(env, VectorEnv) else env.observation_space
    if space.shape != (len(names),):
        raise InvalidConfig(f"{len(names)} names for observations of shape {space.shape}; a wrapper changed the shape")
    return names


def observation_dict(env: Any, observation: ArrayLike) -> dict[str, Any]:
    """The values of an observation of `env` by name, however `env` is wrapped.

    Args:
        env: single, or a vector.
        observation: as `env` gives it; of a vector also that of one slot.

    Returns:
        Floats; after `FrameStackObservation` arrays of shape (stacked,), the latest last; of a whole vector arrays
        with an entry a slot.

    Raises:
        InvalidConfig: an observation of another layer, or a wrapper after which the values have no names.
    """
    values, space = np.asarray(observation), _space(env)
    shapes = [space.shape, (env.num_envs, *space.shape)] if isinstance(env, VectorEnv) else [space.shape]
    if values.shape not in shapes:
        expected = " or ".join(map(str, shapes))
        raise InvalidConfig(f"observation_dict: {env} gives observations of shape {expected}, not {values.shape}")
    names = names_of(_below_stacks(env))
    return {
        name: one.item() if not one.ndim else one for name, one in zip(names, np.moveaxis(values, -1, 0), strict=True)
    }


def _below_stacks(env: Any) -> Any:
    """The layer that names the values: stacking adds an axis and leaves the last one as it is."""
    layer = env
    while isinstance(layer, Wrapper) and type(layer).__module__.startswith("gymnasium."):
        if type(layer).__name__ == _STACK:
            return _below_stacks(layer.env)
        if type(layer).__name__ not in _KEEP_PLACES:
            break
        layer = layer.env
    return env


def _names(env: Any) -> Sequence[str]:
    if not isinstance(env, Wrapper | VectorWrapper):
        return _of_the_bare(env)
    if hasattr(env, "observation_names"):
        found: Sequence[str] = env.observation_names
        return found
    kind = type(env).__name__
    ours = not type(env).__module__.startswith("gymnasium.")
    if kind == _TIME_AWARE and env.observation_space.shape is not None:
        return (*names_of(env.env), "time")
    if ours or not (kind in _KEEP_PLACES or (kind == "FlattenObservation" and isinstance(_space(env.env), Box))):
        what = "give its class `observation_names`, or put it" if ours else "put it"
        raise InvalidConfig(f"after {kind} values have no names; {what} outside of wrappers that need them")
    return names_of(env.env)


def _of_the_bare(env: Any) -> Sequence[str]:
    if inner := inside(env):
        return names_of(inner[0])
    found: Sequence[str] = attribute(env, "observation_names")
    return found


def _space(env: Any) -> Any:
    return env.single_observation_space if isinstance(env, VectorEnv) else env.observation_space


def action_names_of(env: Any) -> tuple[str, ...]:
    """Names of the action's dimensions as `env` takes it; of what a number chooses between where it is discrete."""
    for layer in layers(env):
        if hasattr(layer, "action_names"):
            return tuple(layer.action_names)
    return tuple(attribute(env, "action_names"))


def places(wanted: Iterable[str], names: Sequence[str], who: str, what: str = "observation") -> list[int]:
    """Where each name stands.

    Raises:
        InvalidConfig: names that are not there, all of them, with near ones; or one twice.
    """
    asked = list(wanted)
    faults = [f"{who}: no {what} {name!r}; {did_you_mean(str(name), names)}" for name in asked if name not in names]
    faults += [f"{who}: {name!r} stands twice" for name in dict.fromkeys(asked) if asked.count(name) > 1]
    if faults:
        raise InvalidConfig("\n".join(faults))
    return [names.index(name) for name in asked]


def need_units(env: Any, who: str) -> None:
    """Refuses a chain in which the values are no longer in their units."""
    for layer in layers(env):
        if type(layer).__name__ in _CHANGE_UNITS:
            raise InvalidConfig(f"{who} needs values in their units; put it before {type(layer).__name__}")


def refuse_inside(env: Any, kinds: Iterable[str], text: str) -> None:
    """Refuses a chain that has one of the wrappers; `{}` in the text is its name."""
    for layer in layers(env):
        if type(layer).__name__ in set(kinds):
            raise InvalidConfig(text.format(type(layer).__name__))
