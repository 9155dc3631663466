"""Recommended search spaces of bundled controllers."""

from __future__ import annotations

from typing import Any

RULE_SEARCH_SPACE: dict[str, Any] = {
    "heating_margin": {"low": -4.0, "high": 2.0},
    "cooling_margin": {"low": -4.0, "high": 2.0},
    "heating_setback": {"low": 0.0, "high": 8.0},
    "cooling_setback": {"low": 0.0, "high": 8.0},
    "occupancy_threshold": {"low": 0.0, "high": 0.6},
    "start_rate": {"low": 0.5, "high": 8.0, "log": True},
    "limit_cooling": {"low": 0.0, "high": 4.0},
    "precooling": {"low": 0.0, "high": 3.0},
    "shed_cooling": {"low": 0.0, "high": 3.0},
}
"""Of `rbc`, for a reward with a price and a demand charge, and comfort in occupied hours."""
