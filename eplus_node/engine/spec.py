"""What an engine simulates."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from models.points.selection import Points


@dataclass(frozen=True, slots=True)
class EngineSpec:
    """What one engine simulates: prepared files, the number of timesteps, the points in order.

    `cpus`: where it may run; empty leaves it to the system. `branch`: it ends at its last sample, without EnergyPlus's
    own end of a run.
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

    def spec(self) -> dict[str, Any]:
        """The description that the engine reads first."""
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
            "sensors": [
                (s.variable, s.key, str(s.aggregation), system)
                for s, system in zip(points.sensors, points.system, strict=True)
            ],
            "meters": [(m.meter, h) for m, h in zip(points.meters, points.meter_handles, strict=True)],
            "actuators": [(a.component_type, a.control_type, a.key) for a in points.actuators],
            "feedback": [(a.feedback, a.key) for a in points.actuators if a.feedback],
        }
