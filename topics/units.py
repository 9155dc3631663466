"""Unit names on the bus for EnergyPlus's units, the limits that units imply, and conversions between units."""

from __future__ import annotations

from functools import cache

_NAMES = {
    "": "1",
    "C": "degC",
    "deltaC": "delta_degC",
    "%": "percent",
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


_CONVERSIONS: dict[str, tuple[str, float, float]] = {
    "degC": ("temperature", 1.0, 273.15),
    "degF": ("temperature", 5.0 / 9.0, 459.67 * 5.0 / 9.0),
    "K": ("temperature", 1.0, 0.0),
    "delta_degC": ("temperature difference", 1.0, 0.0),
    "deltaC": ("temperature difference", 1.0, 0.0),
    "delta_degF": ("temperature difference", 5.0 / 9.0, 0.0),
    "W": ("power", 1.0, 0.0),
    "kW": ("power", 1e3, 0.0),
    "MW": ("power", 1e6, 0.0),
    "J": ("energy", 1.0, 0.0),
    "kJ": ("energy", 1e3, 0.0),
    "MJ": ("energy", 1e6, 0.0),
    "GJ": ("energy", 1e9, 0.0),
    "Wh": ("energy", 3.6e3, 0.0),
    "kWh": ("energy", 3.6e6, 0.0),
    "MWh": ("energy", 3.6e9, 0.0),
    "kBtu": ("energy", 1.05505585262e6, 0.0),
    "therm": ("energy", 1.05505585262e8, 0.0),
    "var": ("reactive power", 1.0, 0.0),
    "kvar": ("reactive power", 1e3, 0.0),
    "Mvar": ("reactive power", 1e6, 0.0),
    "VA": ("apparent power", 1.0, 0.0),
    "kVA": ("apparent power", 1e3, 0.0),
    "MVA": ("apparent power", 1e6, 0.0),
    "V": ("voltage", 1.0, 0.0),
    "kV": ("voltage", 1e3, 0.0),
    "A": ("current", 1.0, 0.0),
    "kA": ("current", 1e3, 0.0),
    "kg/s": ("mass flow", 1.0, 0.0),
    "kg/h": ("mass flow", 1.0 / 3600.0, 0.0),
    "m3/s": ("volume flow", 1.0, 0.0),
    "m3/h": ("volume flow", 1.0 / 3600.0, 0.0),
    "L/s": ("volume flow", 1e-3, 0.0),
    "L/min": ("volume flow", 1e-3 / 60.0, 0.0),
    "Pa": ("pressure", 1.0, 0.0),
    "kPa": ("pressure", 1e3, 0.0),
    "bar": ("pressure", 1e5, 0.0),
    "s": ("time", 1.0, 0.0),
    "min": ("time", 60.0, 0.0),
    "h": ("time", 3600.0, 0.0),
    "1": ("number", 1.0, 0.0),
    "fraction": ("number", 1.0, 0.0),
    "percent": ("number", 0.01, 0.0),
    "on_off": ("number", 1.0, 0.0),
}
"""Quantity, factor and offset to its base unit, which for temperature is K: base = factor * value + offset."""


@cache
def quantity(unit: str) -> str:
    """Return the quantity that a unit measures, such as `power`; the unit itself where it is not known."""
    return _CONVERSIONS[unit][0] if unit in _CONVERSIONS else unit


def units_of(name: str) -> tuple[str, ...]:
    """Return the known units of a quantity, such as `power`."""
    return tuple(unit for unit, (own, _, _) in _CONVERSIONS.items() if own == name)


@cache
def conversion(source: str, target: str) -> tuple[float, float] | None:
    """Return factor and offset with which a value in one unit becomes one in another: factor * value + offset.

    Args:
        source: the unit of the value.
        target: the unit of the result.

    Returns:
        (1, 0) for equal units, known or not; None if the units measure different quantities.
    """
    if source == target:
        return 1.0, 0.0
    if source not in _CONVERSIONS or target not in _CONVERSIONS:
        return None
    (quantity_of_source, factor, offset), (quantity_of_target, divisor, base) = (
        _CONVERSIONS[source],
        _CONVERSIONS[target],
    )
    if quantity_of_source != quantity_of_target:
        return None
    return factor / divisor, (offset - base) / divisor


def energy_kwh(unit: str, step_s: float) -> float:
    """Return the factor from an energy of a timestep, or the mean power in it, to kWh; a `KeyError` for other units."""
    kind, factor, _ = _CONVERSIONS[unit]
    return {"energy": factor / 3.6e6, "power": factor / 1e3 / (3600.0 / step_s)}[kind]


def power_kw(unit: str, step_s: float) -> float:
    """Return the factor from an energy of a timestep, or the mean power in it, to kW; a `KeyError` for other units."""
    kind, factor, _ = _CONVERSIONS[unit]
    return {"energy": factor / 3.6e6 * 3600.0 / step_s, "power": factor / 1e3}[kind]


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
