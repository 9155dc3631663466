"""The state of a chain of wrappers, saved with a model in a readable file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.names import chain, inside, layers
from zenostat.agent_sdk.wrappers.serialization import policy_wrappers
from zenostat.topics import yaml12
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig

LOGS = ("EpisodeLog", "TensorBoardLog", "WeightsAndBiasesLog")
"""Wrappers that only write files."""

_DTYPES = ("float32", "float64")


class _StatefulWrapper(NamedTuple):
    """A wrapper with state: its name, and functions that get and set the state."""

    name: str
    get: Callable[[], dict[str, Any]]
    set: Callable[[Mapping[str, Any]], None]


def save_wrappers(env: Any, path: str | Path) -> None:
    """Write the wrappers of `env` and their state: those of `zenostat.wrappers`, and Gymnasium's running statistics.

    Beside a model, as `model.wrappers.yaml` beside `model.zip`, the file lets `load_policy` and `zenostat evaluate`
    apply the same wrappers again. Wrappers that cannot be written as data are left out if they change neither
    observations nor actions, as `TransformReward`, `RecordVideo` and the `Monitor` of stable-baselines3; of a chain
    with others, the file has the state and the reason, with which `load_policy` refuses the model. Includes the
    wrappers of each slot's environment in a `SyncVectorEnv`. The YAML file is written atomically, and its folder is
    created. Save between episodes: the state of the simulation is not saved.

    Args:
        env: single or vector.
        path: the file.
    """
    content: dict[str, Any] = {
        "wrappers": [{"wrapper": wrapper.name, **wrapper.get()} for wrapper in _stateful_wrappers(env)]
    }
    try:
        if wrappers := policy_wrappers(env):
            content["chain"] = wrappers
    except InvalidConfig as error:
        content["chain_error"] = str(error)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary:
        temporary.write_text(yaml12.dump(content), encoding="utf-8")


def restore_wrappers(env: Any, path: str | Path) -> None:
    """Restore the state that `save_wrappers` wrote to a file. Reset the environment afterwards.

    If the number of slots differs, running statistics are restored but the state of running episodes is not.

    Args:
        env: with the same wrappers in the same order.
        path: the file.

    Raises:
        InvalidConfig: the file cannot be read, has another form, or is of another chain of wrappers; nothing was
            changed.
    """
    states = yaml12.read_mapping(Path(path)).get("wrappers")
    if not isinstance(states, list) or not all(isinstance(state, dict) and "wrapper" in state for state in states):
        raise InvalidConfig(f"{path} was not written by save_wrappers")
    set_wrapper_states(env, states, str(path))


def set_wrapper_states(env: Any, states: Sequence[Mapping[str, Any]], path: str) -> None:
    """Set the states of the wrappers of `env`; see `restore_wrappers`.

    Args:
        env: with the same wrappers in the same order.
        states: the name and the state of each wrapper, from the outermost, in the form of the file.
        path: the file, for errors.

    Raises:
        InvalidConfig: the states are of another chain of wrappers; nothing was changed.
    """
    wrappers = list(_stateful_wrappers(env))
    saved_names, names = [state["wrapper"] for state in states], [wrapper.name for wrapper in wrappers]
    if saved_names != names:
        raise InvalidConfig(
            f"{path} has the wrappers {', '.join(saved_names) or 'none'}; this chain has {', '.join(names) or 'none'}, "
            "from the outermost: apply the same wrappers as when it was saved"
        )
    before = [wrapper.get() for wrapper in wrappers]
    try:
        for wrapper, state in zip(wrappers, states, strict=True):
            wrapper.set({key: value for key, value in state.items() if key != "wrapper"})
    except (InvalidConfig, KeyError, TypeError, ValueError) as error:
        for wrapper, state in zip(wrappers, before, strict=True):
            wrapper.set(state)
        reason = error if isinstance(error, InvalidConfig) else f"{type(error).__name__} {error}"
        raise InvalidConfig(f"{path} does not fit: {reason}") from None


def without_logs(states: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the states of a chain of wrappers without those that only write files."""
    return [state for state in states if state["wrapper"] not in LOGS]


@contextmanager
def frozen_statistics(env: Any) -> Iterator[None]:
    """Keep Gymnasium's running statistics around `env` as they are within the context."""
    learning = [layer for layer in chain(env) if getattr(layer, "update_running_mean", False)]
    for layer in learning:
        layer.update_running_mean = False
    try:
        yield
    finally:
        for layer in learning:
            layer.update_running_mean = True


def _stateful_wrappers(env: Any, prefix: str = "") -> Iterator[_StatefulWrapper]:
    """Yield them from the outermost; those of a `SyncVectorEnv`'s slots as `0/NormalizeObservation` and so on."""
    for layer in chain(env):
        name, kind = prefix + type(layer).__name__, type(layer).__name__
        if isinstance(layer, BuildingWrapper):
            yield _StatefulWrapper(name, layer.get_state, layer.set_state)
        elif kind in _STATISTICS and type(layer).__module__.startswith("gymnasium."):
            yield _StatefulWrapper(name, *_statistics_accessors(layer))
    for slot, inner in enumerate(inside(env.unwrapped)):
        yield from _stateful_wrappers(inner, f"{slot}/")


_STATISTICS = {
    "NormalizeObservation": ("obs_rms", ()),
    "NormalizeReward": ("return_rms", ("discounted_reward", "accumulated_reward", "_prev_dones")),
}
"""Attributes of Gymnasium's wrappers: the running statistics, and arrays of the running episodes."""


def _statistics_accessors(env: Any) -> tuple[Callable[[], dict[str, Any]], Callable[[Mapping[str, Any]], None]]:
    running, arrays = _STATISTICS[type(env).__name__]

    def get() -> dict[str, Any]:
        statistics = getattr(env, running)
        state = {"mean": _plain(statistics.mean), "var": _plain(statistics.var), "count": float(statistics.count)}
        return state | {name: _plain(getattr(env, name)) for name in arrays if hasattr(env, name)}

    def restore(state: Mapping[str, Any]) -> None:
        statistics = getattr(env, running)
        mean, var, count = _array(state["mean"]), _array(state["var"]), float(state["count"])
        shape = np.shape(statistics.mean)
        if mean.shape != shape or var.shape != np.shape(statistics.var) or not count > 0:
            raise ValueError(f"{type(env).__name__} has statistics of shape {shape}, not {mean.shape}")
        statistics.mean, statistics.var, statistics.count = mean, var, count
        for name in arrays:
            if name in state and hasattr(env, name) and np.shape(getattr(env, name)) == np.shape(state[name]["values"]):
                setattr(env, name, _array(state[name]))

    return get, restore


def _plain(array: Any) -> dict[str, Any]:
    """Convert an array to plain values, without loss."""
    values = np.asarray(array)
    return {"kind": str(values.dtype), "values": values.tolist()}


def _array(plain: Mapping[str, Any]) -> Any:
    if plain["kind"] not in _DTYPES:
        raise ValueError(f"{' or '.join(_DTYPES)} expected, got {plain['kind']!r}")
    return np.array(plain["values"], plain["kind"])


def restore_normalization(env: Any, folder: str | Path) -> None:
    """Load the observation statistics that Sinergym saved: `mean.txt`, `var.txt` and `count.txt`.

    The files have one number per observation value; `count.txt` is optional.

    Args:
        env: an environment within Gymnasium's `NormalizeObservation`, with the values in the same order.
        folder: Sinergym's `norm_stats`.

    Raises:
        InvalidConfig: the wrapper or a file is missing, a file has another number of values, a variance is below 0, or
            the count is not above 0.
    """
    statistics = next((layer.obs_rms for layer in layers(env) if hasattr(layer, "obs_rms")), None)
    if statistics is None:
        raise InvalidConfig("the environment has no NormalizeObservation, which the statistics are for")
    shape, loaded = np.shape(statistics.mean), {}
    for name in ("mean", "var", "count"):
        path = Path(folder) / f"{name}.txt"
        if name == "count" and not path.exists():
            continue
        try:
            loaded[name] = np.loadtxt(path, np.float64, ndmin=1)
        except (OSError, ValueError) as error:
            raise InvalidConfig(f"{path}: one number per line expected ({error})") from None
        expected_shape = shape if name != "count" else (1,)
        if loaded[name].shape != expected_shape:
            raise InvalidConfig(f"{path}: {int(np.prod(expected_shape))} numbers expected, got {loaded[name].size}")
        if not np.isfinite(loaded[name]).all():
            wrong = loaded[name][~np.isfinite(loaded[name])][0]
            raise InvalidConfig(f"{path}: finite numbers expected, got {wrong}")
        if name == "var" and (loaded[name] < 0.0).any():
            raise InvalidConfig(f"{path}: {loaded[name].min():g} is no variance; numbers of at least 0 expected")
        if name == "count" and not loaded[name][0] > 0.0:
            raise InvalidConfig(f"{path}: {loaded[name][0]:g} is no number of observations; one above 0 expected")
    statistics.mean, statistics.var = loaded["mean"], loaded["var"]
    if "count" in loaded:
        statistics.count = float(loaded["count"][0])
