"""Actuators of the benchmark's version 1 with their bounds, which later defaults do not change."""

from __future__ import annotations

from zenostat.topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT, THERMOSTAT
from zenostat.topics.keys import safe_name

_BOUNDS = {HEATING_SETPOINT: (15.0, 22.5), COOLING_SETPOINT: (22.5, 30.0)}
"""Default bounds of setpoints when version 1 was published, degC."""

_APARTMENTS = ("CORRIDOR", *(f"{side} APARTMENT" for side in ("N1", "N2", "NE", "NW", "S1", "S2", "SE", "SW")))
_GROUND_FLOOR = tuple(name for name in _APARTMENTS if name != "SE APARTMENT")
"""Its south-east corner is the office."""

_ZONES = {
    "ref-small-office": ("CORE_ZN", *(f"PERIMETER_ZN_{number}" for number in range(1, 5))),
    "ref-warehouse": ("BULKSTORAGE", "FINESTORAGE", "OFFICE"),
    "ref-stand-alone-retail": ("BACK_SPACE", "CORE_RETAIL", "FRONT_ENTRY", "FRONT_RETAIL", "POINT_OF_SALE"),
    "ref-quick-service-restaurant": ("DINING", "KITCHEN"),
    "ref-midrise-apartment": (
        *(f"G {name}" for name in _GROUND_FLOOR), *(f"M {name}" for name in _APARTMENTS), "OFFICE",
        *(f"T {name}" for name in _APARTMENTS),
    ),
}  # fmt: skip
"""Zones with a thermostat, in EnergyPlus's order."""


def frozen_actuators(building: str) -> dict[str, list[str | float]]:
    """Return the actuators of a building of the benchmark, as the argument `actuators` of an environment."""
    return {
        f"{safe_name(zone)}_{safe_name(kind)}": [THERMOSTAT, kind, zone, *limits]
        for zone in _ZONES[building]
        for kind, limits in _BOUNDS.items()
    }
