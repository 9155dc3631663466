"""Gymnasium spaces from a node's manifest."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box

from topics.messages import Actuator, Manifest, Meter, Sensor

Floats = Box[np.float32]


def observation_space(manifest: Manifest) -> Floats:
    """Float32, shape (sensors + meters,); bounds from units and limits, infinite where there are none."""
    return _box((*manifest.sensors, *manifest.meters))


def action_space(manifest: Manifest) -> Floats:
    """Float32, shape (actuators,); each actuator's own bounds, in its unit."""
    return _box(manifest.actuators)


def _box(points: tuple[Sensor | Meter | Actuator, ...]) -> Floats:
    low = [-np.inf if p.low is None else p.low for p in points]
    high = [np.inf if p.high is None else p.high for p in points]
    return Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)
