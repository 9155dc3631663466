"""Unit names on the bus for EnergyPlus's units, and the limits that units imply."""

from __future__ import annotations

from functools import cache

_NAMES = {
    "": "1",
    "C": "degC",
    "deltaC": "delta_degC",
    "%": "percent",
    "deg": "deg",
    "degree": "deg",
    "fraction": "fraction",
    "each": "count",
    "unknown": "1",
    "on/off": "on_off",
}

_LIMITS: dict[str, tuple[float | None, float | None]] = {
    "percent": (0.0, 100.0),
    "fraction": (0.0, 1.0),
    "on_off": (0.0, 1.0),
    "count": (0.0, None),
    "ppm": (0.0, None),
    "kg/s": (0.0, None),
    "kgWater/kgDryAir": (0.0, None),
    "lux": (0.0, None),
}


@cache
def unit_name(energyplus: str) -> str:
    """Return a unit's name on the bus: `degC` for `[C]`, `1` for no unit; unknown units are unchanged."""
    bare = energyplus.strip().removeprefix("[").removesuffix("]").strip()
    return _NAMES.get(bare, bare)


def limits(unit: str) -> tuple[float | None, float | None]:
    """Return the lowest and the highest possible value of a quantity in this unit; None where there is no limit."""
    return _LIMITS.get(unit, (None, None))


def unit_label(unit: str) -> str:
    """Return a unit as a table shows it: nothing for a quantity without a unit."""
    return "" if unit == "1" else unit


_PLAIN = ("", "1", "fraction", "count", "on_off")
"""Units that are not shown."""


def with_unit(number: str, unit: str) -> str:
    """Return a number with its unit for display: `26 degC`, but `0 to 1` for a fraction."""
    return number if unit in _PLAIN else f"{number} {unit}"
