"""Gymnasium spaces from a node's manifest."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space

from zenostat.agent_sdk.envs.time_features import BOUNDS
from zenostat.topics.messages import Manifest
from zenostat.topics.points import bounds

Floats = Box


def observation_space(manifest: Manifest) -> Box[np.float32]:
    """Return a float32 box, shape (time fields + observed points,), with infinite bounds where a point has none."""
    return _box([*(BOUNDS[field] for field in manifest.task.time), *map(bounds, manifest.observed_points)])


def action_space(manifest: Manifest) -> Space[Any]:
    """Return `Discrete` or `MultiDiscrete` for discrete actions; otherwise a float32 box, shape (actions,)."""
    counts = [len(discrete.values) for discrete in manifest.task.discrete_actions]
    if len(counts) == 1:
        return Discrete(counts[0])
    return MultiDiscrete(counts) if counts else _box(map(bounds, manifest.task.actions))


def _box(ranges: Iterable[tuple[float, float]]) -> Box[np.float32]:
    low, high = np.array([*ranges], np.float32).reshape(-1, 2).T
    return Box(low, high, dtype=np.float32)
