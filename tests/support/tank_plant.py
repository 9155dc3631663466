"""A tank as a plant, for tests that need a node and no building."""

from pathlib import Path
from typing import ClassVar

TANK = f"{Path(__file__)}:Tank"
"""The plant as a node's setting."""


class Tank:
    """A tank whose level rises by 0.01 m each minute for each W of its pump, which has 5 W by default."""

    step_s = 60.0
    begin = "2026-01-12T00:00"
    duration_s = 86400.0
    sensors: ClassVar = {"level": ("m", 0.0, None)}
    actuators: ClassVar = {"pump": ("W", 0.0, 100.0, 5.0)}
    forkable = True

    def reset(self, seed: int) -> dict[str, float]:
        """Empty the tank."""
        self.level = 0.0
        return {"level": self.level}

    def step(self, commands: dict[str, float]) -> dict[str, float]:
        """Pump for a minute."""
        self.level += 0.01 * commands["pump"]
        return {"level": self.level}
