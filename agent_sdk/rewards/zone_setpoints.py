"""Setpoints of zones as the limits of their air temperatures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from zenostat.agent_sdk.rewards.selectors import Indices, indices
from zenostat.topics.arrays import Floats
from zenostat.topics.energyplus_names import COOLING_SETPOINT_VARIABLE, HEATING_SETPOINT_VARIABLE
from zenostat.topics.messages import Manifest

_THERMOSTAT_VARIABLES = (HEATING_SETPOINT_VARIABLE.casefold(), COOLING_SETPOINT_VARIABLE.casefold())


class ZonePoints(NamedTuple):
    """Indices of a zone's air temperature, heating and cooling setpoint; None: no limit on that side."""

    air: int
    heating: int | None
    cooling: int | None


class ZoneSetpoints:
    """Heating and cooling setpoints of zones.

    Args:
        zones: their points.
        manifest: manifest of the node.

    Attributes:
        zones: the points of each zone.
        air: indices of the air temperatures, shape (zones,).
    """

    def __init__(self, zones: Sequence[ZonePoints], manifest: Manifest) -> None:
        self.zones = tuple(zones)
        self.air = indices([zone.air for zone in zones])
        self._heating = _Limits([zone.heating for zone in zones], -np.inf, manifest)
        self._cooling = _Limits([zone.cooling for zone in zones], np.inf, manifest)

    def heating(self, values: Floats) -> Floats:
        """Return the heating setpoints in degC, -inf where there is none; shape (..., zones) of (..., points)."""
        return self._heating.read(values)

    def cooling(self, values: Floats) -> Floats:
        """Return the cooling setpoints in degC, inf where there is none; shape (..., zones) of (..., points)."""
        return self._cooling.read(values)


class _Limits:
    """Setpoints on one side.

    EnergyPlus's thermostats report exactly 0 for the setpoint that their control type does not use.
    """

    def __init__(self, points: Sequence[int | None], unlimited: float, manifest: Manifest) -> None:
        self._points: Indices = indices([point or 0 for point in points])
        self._unlimited = unlimited
        variables = ["" if point is None else manifest.sensors[point].variable.casefold() for point in points]
        self._is_absent = np.array([point is None for point in points])
        self._is_thermostat = np.array([variable in _THERMOSTAT_VARIABLES for variable in variables])

    def read(self, values: Floats) -> Floats:
        setpoints = values.take(self._points, axis=-1)
        is_unused = self._is_absent | self._is_thermostat & (setpoints == 0.0)
        return np.where(is_unused, self._unlimited, setpoints)
