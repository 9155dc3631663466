"""What a chain of wrappers has learnt, kept with the model: a file that people can read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium import Wrapper
from gymnasium.vector import VectorWrapper

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.names import inside
from topics import yaml12
from topics.atomic_file import atomic_file
from topics.errors import InvalidConfig

_KINDS = ("float32", "float64")


class _Keeper(NamedTuple):
    """One wrapper that remembers: its name, and its state out and in."""

    name: str
    get: Callable[[], dict[str, Any]]
    set: Callable[[Mapping[str, Any]], None]


def save_wrappers(env: Any, path: str | Path) -> None:
    """Writes what the wrappers of `env`, single or vector, remember: ours, and Gymnasium's running statistics.

    Of a `SyncVectorEnv` also the wrappers of each slot's own environment. The file (YAML) is there whole or not
    at all, and its folder is made. Save between episodes: what the simulation itself is at is not kept.
    """
    kept = {"wrappers": [{"wrapper": keeper.name, **keeper.get()} for keeper in _keepers(env)]}
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary:
        temporary.write_text(yaml12.dump(kept), encoding="utf-8")


def restore_wrappers(env: Any, path: str | Path) -> None:
    """Goes on from a file of `save_wrappers`; `env` has the same wrappers in the same order. Reset it then.

    With another number of slots running statistics are taken over, and what concerns a running episode is not.

    Raises:
        InvalidConfig: no such file, no such form, or another chain of wrappers; nothing was changed then.
    """
    try:
        found = yaml12.parse(yaml12.read_text(Path(path)), str(path)).get("wrappers")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidConfig(f"{path} cannot be read: {error}") from None
    keepers = list(_keepers(env))
    if not isinstance(found, list) or not all(isinstance(one, dict) and "wrapper" in one for one in found):
        raise InvalidConfig(f"{path} is no file of save_wrappers")
    there, here = [one["wrapper"] for one in found], [keeper.name for keeper in keepers]
    if there != here:
        raise InvalidConfig(
            f"{path} is of the wrappers {', '.join(there) or 'none'}; this chain has {', '.join(here) or 'none'}, "
            "from the outermost: wrap as it was when saved"
        )
    before = [keeper.get() for keeper in keepers]
    try:
        for keeper, state in zip(keepers, found, strict=True):
            keeper.set({key: value for key, value in state.items() if key != "wrapper"})
    except (InvalidConfig, KeyError, TypeError, ValueError) as error:
        for keeper, state in zip(keepers, before, strict=True):
            keeper.set(state)
        why = error if isinstance(error, InvalidConfig) else f"{type(error).__name__} {error}"
        raise InvalidConfig(f"{path} does not fit: {why}") from None


def _keepers(env: Any, mark: str = "") -> Iterator[_Keeper]:
    """From the outermost on; of what a `SyncVectorEnv` holds, `0/NormalizeObservation` and so on."""
    while isinstance(env, Wrapper | VectorWrapper):
        name, kind = mark + type(env).__name__, type(env).__name__
        if isinstance(env, BuildingWrapper):
            yield _Keeper(name, env.get_state, env.set_state)
        elif kind in _STATISTICS and type(env).__module__.startswith("gymnasium."):
            yield _Keeper(name, *_of_gymnasium(env))
        env = env.env
    for slot, inner in enumerate(inside(env)):
        yield from _keepers(inner, f"{slot}/")


_STATISTICS = {
    "NormalizeObservation": ("obs_rms", ()),
    "NormalizeReward": ("return_rms", ("discounted_reward", "accumulated_reward", "_prev_dones")),
}
"""Gymnasium's running statistics, and the arrays of running episodes beside them."""


def _of_gymnasium(env: Any) -> tuple[Callable[[], dict[str, Any]], Callable[[Mapping[str, Any]], None]]:
    running, arrays = _STATISTICS[type(env).__name__]

    def get() -> dict[str, Any]:
        of = getattr(env, running)
        state = {"mean": _plain(of.mean), "var": _plain(of.var), "count": float(of.count)}
        return state | {name: _plain(getattr(env, name)) for name in arrays if hasattr(env, name)}

    def restore(state: Mapping[str, Any]) -> None:
        of = getattr(env, running)
        mean, var, count = _array(state["mean"]), _array(state["var"]), float(state["count"])
        if mean.shape != np.shape(of.mean) or var.shape != np.shape(of.var) or not count > 0:
            raise ValueError(f"{type(env).__name__} has statistics of shape {np.shape(of.mean)}, not {mean.shape}")
        of.mean, of.var, of.count = mean, var, count
        for name in arrays:
            if name in state and hasattr(env, name) and np.shape(getattr(env, name)) == np.shape(state[name]["values"]):
                setattr(env, name, _array(state[name]))

    return get, restore


def _plain(array: Any) -> dict[str, Any]:
    """An array as plain values; a float32 is a float64 to the bit."""
    found = np.asarray(array)
    return {"kind": str(found.dtype), "values": found.tolist()}


def _array(plain: Mapping[str, Any]) -> Any:
    if plain["kind"] not in _KINDS:
        raise ValueError(f"numbers of kind {plain['kind']!r}; {' or '.join(_KINDS)} expected")
    return np.array(plain["values"], plain["kind"])


def restore_normalization(env: Any, folder: str | Path) -> None:
    """Takes over the statistics of observations that Sinergym saved: `mean.txt`, `var.txt` and `count.txt`.

    They are numbers of a model's training, one for each observation; `count.txt` may be missing.

    Args:
        env: with Gymnasium's `NormalizeObservation` around it, whose observation has the same order.
        folder: Sinergym's `norm_stats`.

    Raises:
        InvalidConfig: no such wrapper; a file that is missing or not of so many numbers.
    """
    try:
        statistics = env.get_wrapper_attr("obs_rms")
    except AttributeError:
        raise InvalidConfig("there is no NormalizeObservation around the environment to take the statistics") from None
    shape, found = np.shape(statistics.mean), {}
    for name in ("mean", "var", "count"):
        path = Path(folder) / f"{name}.txt"
        if name == "count" and not path.exists():
            continue
        try:
            found[name] = np.loadtxt(path, np.float64, ndmin=1)
        except (OSError, ValueError) as error:
            raise InvalidConfig(f"{path}: a number a line expected ({error})") from None
        wanted = shape if name != "count" else (1,)
        if found[name].shape != wanted or not np.isfinite(found[name]).all():
            raise InvalidConfig(f"{path}: {int(np.prod(wanted))} numbers expected, it has {found[name].size}")
    statistics.mean, statistics.var = found["mean"], found["var"]
    if "count" in found:
        statistics.count = float(found["count"][0])
