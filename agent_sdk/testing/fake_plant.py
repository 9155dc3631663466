"""The fake building as a plant that a node can run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.topics.messages import Actuator, Meter, Sensor

_Spec = tuple[str, float | None, float | None]


class FakePlant:
    """A `FakeBuilding` for nodes: `zenostat node --plant zenostat.agent_sdk.testing.fake_plant:FakePlant`.

    Actuators that nobody commands have the building's baseline control. Equal seeds and commands result in the same
    values as those of `FakeEnv`, to the bit.

    Args:
        zones: number of zones.
        building: further arguments of `FakeBuilding`.

    Raises:
        InvalidConfig: an argument is invalid.
    """

    forkable = True

    def __init__(self, zones: int = 3, **building: Any) -> None:
        self._building = FakeBuilding(zones, **building)
        manifest = self._building.manifest
        self.step_s, self.begin, self.duration_s = manifest.step_s, manifest.begin, manifest.steps * manifest.step_s
        self.sensors, self.meters = _specs(manifest.sensors), _specs(manifest.meters)
        self.actuators = _specs(manifest.actuators)
        self.time = tuple(manifest.task.time)
        self._names = manifest.names

    def reset(self, seed: int) -> dict[str, float]:
        """Begin an episode, and return the values of sample 0."""
        return self._by_name(self._building.reset(seed))

    def step(self, commands: Mapping[str, float]) -> dict[str, float]:
        """Simulate a timestep, and return the values at its end.

        Raises:
            ModelError: a heating setpoint is above the cooling setpoint.
        """
        commanded = np.array([commands.get(name, np.nan) for name in self.actuators])
        return self._by_name(self._building.advance(commanded)[0])

    def save(self) -> FakeBuilding:
        """Return the state."""
        return self._building

    def restore(self, state: FakeBuilding) -> None:
        """Continue from a saved state."""
        self._building = state

    def _by_name(self, values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
        return dict(zip(self._names, values.tolist(), strict=True))


def _specs(points: Iterable[Sensor | Meter | Actuator]) -> dict[str, _Spec]:
    return {point.name: (point.unit, point.low, point.high) for point in points}
