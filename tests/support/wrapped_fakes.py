"""Fake environments for tests of wrappers."""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from support.fakes import FakeBuilding
from zenostat import wrappers as w

MIDDLE = np.array([20.0, 26.0], np.float32)
DRY, WIND = "dry_bulb_temperature", "wind_direction"


def fake(**arguments: Any) -> FakeBuilding:
    return FakeBuilding(**{"steps_per_hour": 1, **arguments})


def fakes(count: int = 2, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **arguments: Any) -> SyncVectorEnv[Any, Any]:
    return SyncVectorEnv([lambda: fake(**arguments)] * count, autoreset_mode=mode)


def named(env: Any, observation: Any) -> dict[str, float]:
    return dict(zip(w.names_of(env), np.asarray(observation).tolist(), strict=True))


def episode(env: Any, act: Callable[[], Any], seed: int | None = 0) -> list[tuple[Any, ...]]:
    """All that comes out of an episode; sample 0 has None for its reward."""
    observation, info = env.reset(seed=seed)
    steps: list[tuple[Any, ...]] = [(observation, None, False, info)]
    while not steps[-1][2]:
        observation, reward, _, truncated, info = env.step(act())
        steps.append((observation, reward, truncated, info))
    return steps
