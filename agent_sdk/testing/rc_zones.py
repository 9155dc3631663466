"""Rooms as one heat capacity behind one thermal resistance each, solved exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from topics.errors import InvalidConfig

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Zone:
    """One room.

    Attributes:
        name: letters, digits, `_`, `.`, `-`.
        capacity_j_per_k: what it takes to warm air, furniture and walls by 1 K; above 0.
        resistance_k_per_w: between the room and outdoors; above 0.
        heating_w, cooling_w: the most that the thermostat can add or take away; at least 0.
        people: while the building is open.
        equipment_w: electricity for light and appliances while the building is open.
        aperture_m2: sunlight that comes in is this times the global radiation.
    """

    name: str
    capacity_j_per_k: float = 5e6
    resistance_k_per_w: float = 0.01
    heating_w: float = 6000.0
    cooling_w: float = 6000.0
    people: float = 4.0
    equipment_w: float = 600.0
    aperture_m2: float = 1.0

    def __post_init__(self) -> None:
        for field in ("capacity_j_per_k", "resistance_k_per_w"):
            if not getattr(self, field) > 0.0:
                raise InvalidConfig(f"zone {self.name!r}: {field} = {getattr(self, field)}; more than 0 expected")
        for field in ("heating_w", "cooling_w", "people", "equipment_w", "aperture_m2"):
            if not getattr(self, field) >= 0.0:
                raise InvalidConfig(f"zone {self.name!r}: {field} = {getattr(self, field)}; at least 0 expected")


class ZoneStep(NamedTuple):
    """What happened in a timestep, each of shape (zones,).

    Attributes:
        end_degc: temperature at its end.
        mean_degc: mean temperature over it.
        heat_w: heat that the thermostat added (below 0: took away), the same all through the timestep.
    """

    end_degc: Floats
    mean_degc: Floats
    heat_w: Floats


class RCZones:
    """The thermal side of some zones: `C dT/dt = (T_out - T) / R + gains + heat` for each of them.

    Outdoor temperature, gains and heat are the same all through a timestep, so the exponential solution is exact.
    """

    def __init__(self, zones: Sequence[Zone]) -> None:
        self.capacity_j_per_k = np.array([z.capacity_j_per_k for z in zones])
        self.resistance_k_per_w = np.array([z.resistance_k_per_w for z in zones])
        self._heating_w = np.array([z.heating_w for z in zones])
        self._cooling_w = np.array([z.cooling_w for z in zones])
        self._tau_s = self.capacity_j_per_k * self.resistance_k_per_w

    def step(
        self, start_degc: Floats, outdoor_degc: float, gains_w: Floats, heating: Floats, cooling: Floats, step_s: float
    ) -> ZoneStep:
        """One timestep of `step_s` seconds under an ideal thermostat.

        The thermostat adds the constant heat that brings the room to its heating setpoint (takes it to its cooling
        setpoint) at the end of the timestep, as far as its capacity goes, and none if the room ends between them
        by itself.
        """
        decay = np.exp(-step_s / self._tau_s)
        k_per_w = self.resistance_k_per_w * (1.0 - decay)
        calm = outdoor_degc + self.resistance_k_per_w * gains_w
        free = calm + (start_degc - calm) * decay
        heat = np.clip((heating - free) / k_per_w, 0.0, self._heating_w)
        heat -= np.clip((free - cooling) / k_per_w, 0.0, self._cooling_w)
        goal = calm + self.resistance_k_per_w * heat
        distance = start_degc - goal
        return ZoneStep(goal + distance * decay, goal + distance * (1.0 - decay) * self._tau_s / step_s, heat)
