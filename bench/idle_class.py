"""A class that does nothing, as a plant in a process of its own: `zenostat node --plant bench/idle_class.py:Idle`."""

from __future__ import annotations

from collections.abc import Mapping


class Idle:
    """One sensor, which shows the command of one actuator."""

    step_s = 1.0
    duration_s = 1e9
    sensors = {"measured": "1"}
    actuators = {"command": ("1", -1e9, 1e9, 0.0)}

    def reset(self, seed: int) -> dict[str, float]:
        """Begin an episode."""
        return {"measured": 0.0}

    def step(self, commands: Mapping[str, float]) -> dict[str, float]:
        """Copy the command."""
        return {"measured": commands["command"]}
