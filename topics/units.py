"""EnergyPlus's unit texts, the names that they have on the bus, and the limits that units carry."""

from __future__ import annotations

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


def unit_name(energyplus: str) -> str:
    """The unit's name on the bus: `[C]` is `degC`, no unit is `1`; unknown ones stay as they are."""
    bare = energyplus.strip().removeprefix("[").removesuffix("]").strip()
    return _NAMES.get(bare, bare)


def limits(unit: str) -> tuple[float | None, float | None]:
    """Lowest and highest value that a quantity of this unit can have; None where there is none."""
    return _LIMITS.get(unit, (None, None))


_PLAIN = ("", "1", "fraction", "count", "on_off")
"""Units that people leave out."""


def with_unit(number: str, unit: str) -> str:
    """Return a number with its unit as people write it: `26 degC`, `0 to 1` without one."""
    return number if unit in _PLAIN else f"{number} {unit}"
