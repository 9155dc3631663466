"""The energy of a timestep, from meters or power sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zenostat.agent_sdk.rewards.selectors import check_distinct, energy_point, indices, observed_meters, of_variables
from zenostat.topics.arrays import Floats
from zenostat.topics.energyplus_names import HVAC_POWER
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest
from zenostat.topics.units import energy_kwh

METERS = ("Electricity:Facility", "HVAC:Electricity", "Electricity:HVAC")
"""Default meters; the first that exists is used."""


class EnergyMeter:
    """The energy of a timestep in kWh.

    Meters and sensors of energy (J, kWh) are exact. The value of a sensor of power (W, kW) is taken for the whole
    timestep: this is exact if the sensor reports the timestep's mean, and an approximation if it reports an instant.

    Args:
        kind: the reward's kind.
        names: meters and sensors to add up; None: the meter Electricity:Facility, else HVAC:Electricity, else
            Electricity:HVAC, else the sensor of EnergyPlus's Facility Total HVAC Electricity Demand Rate.
        manifest: the node's manifest.
        default: meters for `names=None`, instead of those of electricity; the first that exists is used.

    Raises:
        InvalidConfig: the node has none of these, one of them does not measure energy or power, or is named twice.
    """

    def __init__(
        self, kind: str, names: Sequence[str] | None, manifest: Manifest, default: Sequence[str] = METERS
    ) -> None:
        if names is None:
            points = _default(kind, manifest, default)
        else:
            check_distinct(kind, names)
            points = [energy_point(kind, name, manifest) for name in names]
        self._indices = indices(points)
        self._kwh = np.array([energy_kwh(manifest.points[i].unit, manifest.step_s) for i in points])
        self.kw_per_kwh = 3600.0 / manifest.step_s
        """Mean power in kW of a timestep that used 1 kWh."""

    def kwh(self, values: Floats) -> Any:
        """Return the energy of the timestep in kWh, with the leading shape of `values`."""
        return np.add.reduce(values.take(self._indices, axis=-1) * self._kwh, axis=-1)


def _default(kind: str, manifest: Manifest, default: Sequence[str]) -> list[int]:
    meters = observed_meters(manifest)
    for meter in default:
        if meter.casefold() in meters:
            return [meters[meter.casefold()]]
    is_electric = default is METERS
    sensors = of_variables(manifest, HVAC_POWER.casefold())[:1] if is_electric else []
    if not sensors:
        raise InvalidConfig(
            f"the {kind} reward needs the energy that is used: name the meter {default[0]!r} in meters=, or "
            f"name other meters (J) or power sensors (W) as the reward's `{'energy' if is_electric else 'gas'}`"
        )
    return sensors
