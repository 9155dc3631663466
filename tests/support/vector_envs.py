"""Two vector environments side by side: step and reset both, and find where they differ."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.typing import NDArray

from zenostat.agent_sdk.testing import Climate, FakeEnv
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv

MODES = list(AutoresetMode)
each_mode = pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)

DAY: dict[str, Any] = {"zones": 2, "steps_per_hour": 1, "climate": Climate(noise_k=3.0)}
"""24 timesteps, with another weather each time."""


def fakes(count: int, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **arguments: Any) -> FakeVectorEnv:
    return FakeVectorEnv(count, autoreset_mode=mode, **{**DAY, **arguments})


def apart(count: int, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **arguments: Any) -> SyncVectorEnv:
    return SyncVectorEnv([lambda: FakeEnv(**{**DAY, **arguments}) for _ in range(count)], autoreset_mode=mode)


def differ(one: Any, other: Any, where: str = "") -> str:
    """Return the path at which two infos, or two arrays, differ; empty if they are equal."""
    if isinstance(one, dict) and isinstance(other, dict):
        if set(one) != set(other):
            return f"{where}: {sorted(set(one) ^ set(other))} only in one of them"
        return next((difference for key in one if (difference := differ(one[key], other[key], f"{where}.{key}"))), "")
    if type(one) is not type(other):
        return f"{where}: {type(one)} and {type(other)}"
    if isinstance(one, np.ndarray):
        if (one.dtype, one.shape) != (other.dtype, other.shape):
            return f"{where}: {one.dtype} {one.shape} and {other.dtype} {other.shape}"
        if one.flags.writeable != other.flags.writeable:
            return f"{where}: one is read-only"
        if one.dtype == object:
            pairs = zip(one.tolist(), other.tolist(), strict=True)
            return next((difference for a, b in pairs if (difference := differ(a, b, where))), "")
        same = one.tobytes() == other.tobytes()
    else:
        same = one == other
    return "" if same else f"{where}: {one!r} and {other!r}"


def step_both(envs: Sequence[VectorEnv[Any, Any, Any]], actions: Any, but: Sequence[str] = ()) -> NDArray[np.bool_]:
    """Steps both and compares all but these keys of the infos; which slots have ended."""
    ours, theirs = (without(env.step(actions), but) for env in envs)
    for name, one, other in zip(
        ("observations", "rewards", "terminated", "truncated", "infos"), ours, theirs, strict=True
    ):
        assert differ(one, other, name) == ""
    return np.asarray(ours[2] | ours[3])


def without(step: tuple[Any, ...], keys: Sequence[str]) -> tuple[Any, ...]:
    return *step[:-1], {key: value for key, value in step[-1].items() if key.removeprefix("_") not in keys}


def reset_both(envs: Sequence[VectorEnv[Any, Any, Any]], but: Sequence[str] = (), **arguments: Any) -> None:
    ours, theirs = (
        without(env.reset(**{key: _copied(value) for key, value in arguments.items()}), but) for env in envs
    )
    assert differ(ours[0], theirs[0], "observations") == ""
    assert differ(ours[1], theirs[1], "infos") == ""


def _copied(value: Any) -> Any:
    return dict(value) if isinstance(value, dict) else value  # Gymnasium takes the mask out of the options


def run_both(
    envs: Sequence[VectorEnv[Any, Any, Any]], mode: AutoresetMode, steps: int, seed: Any = 3, but: Sequence[str] = ()
) -> list[NDArray[np.bool_]]:
    """Resets, steps, and in mode `Disabled` resets the slots that have ended; compares all; who ended when."""
    assert envs[0].observation_space == envs[1].observation_space
    assert envs[0].action_space == envs[1].action_space
    envs[0].action_space.seed(1)
    reset_both(envs, but, seed=seed)
    ends = []
    for _ in range(steps):
        ends.append(step_both(envs, envs[0].action_space.sample(), but))
        if mode is AutoresetMode.DISABLED and ends[-1].any():
            reset_both(envs, but, options={"reset_mask": ends[-1]})
    return ends
