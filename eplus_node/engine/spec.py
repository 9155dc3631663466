"""The specification of an engine's run."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from models.points.selection import Points


@dataclass(frozen=True, slots=True)
class EngineSpec:
    """Specification of an engine's run: prepared files, number of timesteps, points in order.

    Attributes:
        keep_output: keep the folder and let EnergyPlus finish its files.
        cpus: cores on which the engine may run; empty leaves it to the system.
        poll: whether the engine polls for orders before it sleeps.
        branch: end the process at its last sample, without EnergyPlus's own end of run.
        shrink_caches: see `eplus_node.engine.memory`.
    """

    model: Path
    weather: Path
    folder: Path
    steps: int
    steps_per_hour: int
    points: Points
    keep_output: bool = False
    cpus: tuple[int, ...] = ()
    poll: bool = False
    branch: bool = False
    shrink_caches: bool = True

    def fields(self) -> dict[str, Any]:
        """Return the fields that the engine reads, as JSON built-ins."""
        points = self.points
        return {
            "model": str(self.model),
            "weather": str(self.weather),
            "folder": str(self.folder),
            "steps": self.steps,
            "steps_per_hour": self.steps_per_hour,
            "keep": self.keep_output,
            "parent": os.getpid(),
            "cpus": self.cpus,
            "poll": self.poll,
            "branch": self.branch,
            "shrink_caches": self.shrink_caches,
            "sensors": [
                (s.variable, s.key, str(s.aggregation), system)
                for s, system in zip(points.sensors, points.system, strict=True)
            ],
            "meters": [(m.meter, h) for m, h in zip(points.meters, points.meter_handles, strict=True)],
            "actuators": [(a.component_type, a.control_type, a.key) for a in points.actuators],
            "feedback": [(a.feedback, a.key) for a in points.actuators if a.feedback],
        }
