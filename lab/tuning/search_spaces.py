"""Recommended search spaces of bundled controllers."""

from __future__ import annotations

from typing import Any

RULE_SEARCH_SPACE: dict[str, Any] = {
    "heating_margin": {"low": -1.0, "high": 1.5, "start": 0.3},
    "cooling_margin": {"low": -1.0, "high": 1.5, "start": 0.3},
    "heating_setback": {"low": 0.0, "high": 13.0, "start": 6.0},
    "cooling_setback": {"low": 0.0, "high": 9.0, "start": 6.0},
    "occupancy_threshold": {"low": 0.0, "high": 1.0, "start": 0.2},
    "start_rate": {"low": 0.5, "high": 16.0, "log": True, "start": 3.0},
    "limit_cooling": {"low": 0.0, "high": 1.5, "start": 0.1},
    "precooling": {"low": 0.0, "high": 3.0, "start": 0.2},
    "shed_cooling": {"low": 0.0, "high": 1.5, "start": 0.1},
}
"""Of `rbc`, for a reward with a price and a demand charge, and comfort in occupied hours.

A threshold near 1 with a deep setback is a building that is hardly heated: right for halls with few people.
"""
