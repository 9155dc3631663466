"""Thermal model of zones: one heat capacity and one thermal resistance each, solved exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig


@dataclass(frozen=True)
class Zone:
    """Parameters of one zone.

    Attributes:
        name: name of letters, digits, `_`, `.`, `-`.
        capacity_j_per_k: heat capacity of air, furniture and walls; above 0.
        resistance_k_per_w: thermal resistance between zone and outdoors; above 0.
        heating_w, cooling_w: heating and cooling capacity; at least 0.
        people: number of people while the building is open.
        equipment_w: electric power of lighting and appliances while the building is open.
        aperture_m2: solar gain divided by the global radiation.
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
    """Temperatures and heat of a timestep, each of shape (zones,).

    Attributes:
        end_degc: temperature at the end of the timestep.
        mean_degc: mean temperature over the timestep.
        heat_w: heating (above 0) or cooling (below 0) power, constant over the timestep.
    """

    end_degc: Floats
    mean_degc: Floats
    heat_w: Floats


class RCZones:
    """Thermal model of independent zones: `C dT/dt = (T_out - T) / R + gains + heat` for each.

    Outdoor temperature, gains and heat are constant over a timestep, so the exponential solution is exact.
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
        """Simulate one timestep of `step_s` seconds with an ideal thermostat.

        The thermostat applies the constant heat with which the zone reaches its heating (cooling) setpoint at the end
        of the timestep, within its capacity, and none if the zone ends between the setpoints without heat.
        """
        decay = np.exp(-step_s / self._tau_s)
        k_per_w = self.resistance_k_per_w * (1.0 - decay)
        equilibrium = outdoor_degc + self.resistance_k_per_w * gains_w
        free = equilibrium + (start_degc - equilibrium) * decay
        heat = np.clip((heating - free) / k_per_w, 0.0, self._heating_w)
        heat -= np.clip((free - cooling) / k_per_w, 0.0, self._cooling_w)
        target = equilibrium + self.resistance_k_per_w * heat
        distance = start_degc - target
        return ZoneStep(target + distance * decay, target + distance * (1.0 - decay) * self._tau_s / step_s, heat)
