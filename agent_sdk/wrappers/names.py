"""Names of the values of an observation, at any layer of a chain of wrappers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import Wrapper
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import ArrayLike

from zenostat.agent_sdk.wrappers.gymnasium_wrappers import Trait, wrappers_with
from zenostat.topics.errors import InvalidConfig, did_you_mean, repeated

_KEEP_ORDER = wrappers_with(Trait.KEEPS_ORDER)
_STACK = "FrameStackObservation"
_CHANGE_UNITS = wrappers_with(Trait.OBSERVATION_UNITS)
_SKIP_STEPS = wrappers_with(Trait.SKIPS_STEPS)
_TIME_AWARE = "TimeAwareObservation"


def layers(env: Any) -> Iterator[Any]:
    """Yield the layers from the outermost to the unwrapped environment; those of the first slot in a vector."""
    while True:
        yield env
        if isinstance(env, Wrapper | VectorWrapper):
            env = env.env
        elif inner := inside(env):
            env = inner[0]
        else:
            return


def chain(env: Any) -> Iterator[Any]:
    """Yield the wrappers around an environment, single or vector, from the outermost; not those within its slots."""
    while isinstance(env, Wrapper | VectorWrapper):
        yield env
        env = env.env


def inside(env: Any) -> Sequence[Any]:
    """Return the environments of a vector environment that runs them in this process; else an empty sequence."""
    return (getattr(env, "envs", None) or ()) if isinstance(env, VectorEnv) else ()


def attribute(env: Any, name: str) -> Any:
    """Return an attribute of the unwrapped environment; that of the first slot in a vector environment.

    Raises:
        InvalidConfig: it does not have the attribute.
    """
    base = env.unwrapped
    if inner := inside(base):
        base = inner[0].unwrapped
    try:
        if isinstance(base, VectorEnv) and not hasattr(base, name):
            return base.get_attr(name)[0]  # type: ignore[attr-defined]  # those in other processes have it
        return getattr(base, name)
    except AttributeError:
        raise InvalidConfig(f"{base} has no {name!r}; wrap an environment with an id under zenostat/") from None


def names_of(env: Any) -> tuple[str, ...]:
    """Return the names of the observation's values at any layer of wrappers.

    Args:
        env: single or vector.

    Raises:
        InvalidConfig: after one of the wrappers the values have no names; the error names the wrapper.
    """
    names = tuple(_names(env))
    space = env.single_observation_space if isinstance(env, VectorEnv) else env.observation_space
    if space.shape != (len(names),):
        raise InvalidConfig(
            f"the observation has the shape {space.shape} but {len(names)} names; a wrapper changed its shape"
        )
    return names


def observation_dict(env: Any, observation: ArrayLike) -> dict[str, Any]:
    """Return the values of an observation by name, at any layer of wrappers.

    Args:
        env: single or vector.
        observation: as `env` returned it; that of one slot is also possible.

    Returns:
        Floats; after `FrameStackObservation` arrays of shape (stack_size,), the latest last; for a vector observation
        arrays with one entry per slot.

    Raises:
        InvalidConfig: the observation is that of another layer, or after one of the wrappers the values have no names.
    """
    values, space = np.asarray(observation), _space(env)
    shapes = [space.shape, (env.num_envs, *space.shape)] if isinstance(env, VectorEnv) else [space.shape]
    if values.shape not in shapes:
        expected = " or ".join(map(str, shapes))
        raise InvalidConfig(f"observation_dict: an observation of {env} has the shape {expected}, got {values.shape}")
    names = names_of(_below_stacks(env))
    return {
        name: column.item() if not column.ndim else column
        for name, column in zip(names, np.moveaxis(values, -1, 0), strict=True)
    }


def _below_stacks(env: Any) -> Any:
    """Return the layer that names the values: stacking adds an axis but does not change the last one."""
    layer = env
    while isinstance(layer, Wrapper) and type(layer).__module__.startswith("gymnasium."):
        if type(layer).__name__ == _STACK:
            return _below_stacks(layer.env)
        if type(layer).__name__ not in _KEEP_ORDER:
            break
        layer = layer.env
    return env


def _names(env: Any) -> Sequence[str]:
    if not isinstance(env, Wrapper | VectorWrapper):
        return _unwrapped_names(env)
    if hasattr(env, "observation_names"):
        names: Sequence[str] = env.observation_names
        return names
    kind = type(env).__name__
    is_custom = not type(env).__module__.startswith("gymnasium.")
    if kind == _TIME_AWARE and env.observation_space.shape is not None:
        return (*names_of(env.env), "time")
    if is_custom or not (kind in _KEEP_ORDER or (kind == "FlattenObservation" and isinstance(_space(env.env), Box))):
        remedy = "give its class `observation_names`, or apply it" if is_custom else "apply it"
        raise InvalidConfig(f"after {kind} values have no names; {remedy} after the wrappers that need them")
    return names_of(env.env)


def _unwrapped_names(env: Any) -> Sequence[str]:
    if inner := inside(env):
        return names_of(inner[0])
    names: Sequence[str] = attribute(env, "observation_names")
    return names


def _space(env: Any) -> Any:
    return env.single_observation_space if isinstance(env, VectorEnv) else env.observation_space


def action_names_of(env: Any) -> tuple[str, ...]:
    """Return the names of the action's dimensions as `env` takes it; if it is discrete, of the actions it sets."""
    for layer in layers(env):
        if hasattr(layer, "action_names"):
            return tuple(layer.action_names)
    return tuple(attribute(env, "action_names"))


def indices_of(wanted: Iterable[str], names: Sequence[str], label: str, kind: str = "observation") -> list[int]:
    """Return the index of each wanted name in `names`.

    Args:
        wanted: the names to find.
        names: all names.
        label: names the wrapper or argument in errors.
        kind: the kind of name, for errors.

    Raises:
        InvalidConfig: not a list of names; names that do not exist, or are listed twice; the error lists all of them.
    """
    if isinstance(wanted, str):
        raise InvalidConfig(f"{label}: a list of names expected, such as [{wanted!r}], got {wanted!r}")
    if not isinstance(wanted, Iterable) or not all(isinstance(name, str) for name in wanted):
        raise InvalidConfig(f"{label}: a list of names expected, got {wanted!r}")
    wanted = list(wanted)
    errors = [f"{label}: no {kind} {name!r}; {did_you_mean(name, names)}" for name in wanted if name not in names]
    errors += [f"{label}: {name!r} is listed twice" for name in repeated(wanted)]
    if errors:
        raise InvalidConfig("\n".join(errors))
    return [names.index(name) for name in wanted]


def require_mapping(value: Any, label: str, form: str) -> None:
    """Raise `InvalidConfig` if an argument is not a mapping; `form` shows the right form."""
    if not isinstance(value, Mapping):
        raise InvalidConfig(f"{label}: {form} expected, got {value!r}")


def unknown_arguments(arguments: Iterable[str], known: Sequence[str], wrapper_name: str) -> list[str]:
    """Return an error for each argument that a wrapper does not have."""
    return [
        f"{wrapper_name} has no argument {name!r}; {did_you_mean(name, known)}"
        for name in arguments
        if name not in known
    ]


def require_units(env: Any, wrapper_name: str) -> None:
    """Raise `InvalidConfig` if a wrapper of the chain changes the units of the values."""
    for layer in layers(env):
        if type(layer).__name__ in _CHANGE_UNITS:
            raise InvalidConfig(f"{wrapper_name} needs values in their units; apply it before {type(layer).__name__}")


def require_each_timestep(env: Any, wrapper_name: str, remedy: str = "apply it before {0}") -> None:
    """Raise `InvalidConfig` if a wrapper of the chain takes several timesteps in a step; `{0}` becomes its name."""
    reject_wrappers(env, _SKIP_STEPS, f"{wrapper_name} needs each timestep, but {{0}} skips some; {remedy}")


def reject_wrappers(env: Any, kinds: Iterable[str], text: str) -> None:
    """Raise `InvalidConfig` if the chain has one of the wrappers; `{}` in the text becomes its name."""
    for layer in layers(env):
        if type(layer).__name__ in set(kinds):
            raise InvalidConfig(text.format(type(layer).__name__))
