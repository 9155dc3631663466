"""Coefficients of water-to-air and water-to-water heat pumps become curves (9.4 to 9.5; schemas).

Their functions are linear in the same variables: temperatures over 283.15 K and flows over their reference. The
limits of a curve's variables are those of EnergyPlus's own example files, -100 to 100 and 0 to 100, which no operating
point reaches.
"""

from __future__ import annotations

from typing import Any

from zenostat.models.upgrade.step import UpgradingModel

_AIR_COIL, _WATER_PUMP = "WaterToAirHeatPump:EquationFit", "HeatPump:WaterToWater:EquationFit"
_CURVES = {
    f"Coil:Cooling:{_AIR_COIL}": {
        "total_cooling_capacity": 5,
        "sensible_cooling_capacity": 6,
        "cooling_power_consumption": 5,
    },
    f"Coil:Heating:{_AIR_COIL}": {"heating_capacity": 5, "heating_power_consumption": 5},
    f"{_WATER_PUMP}:Cooling": {"cooling_capacity": 5, "cooling_compressor_power": 5},
    f"{_WATER_PUMP}:Heating": {"heating_capacity": 5, "heating_compressor_power": 5},
}
"""Functions of each type, with their numbers of coefficients."""

_VARIABLES = {5: "wxyz", 6: "vwxyz"}


def heat_pump_curves(model: UpgradingModel) -> None:
    """Replace coefficients by curves."""
    for kind, functions in _CURVES.items():
        for name, fields in model.items(kind):
            for function, count in functions.items():
                keys = [f"{function}_coefficient_{number}" for number in range(1, count + 1)]
                if not any(key in fields for key in keys):
                    continue
                coefficients = [float(fields.pop(key, 0.0)) for key in keys]
                curve = model.add(
                    "Curve:QuadLinear" if count == 5 else "Curve:QuintLinear",
                    f"{name} {function.replace('_', ' ')}",
                    _linear_curve(coefficients),
                    source=(kind, name),
                )
                fields[f"{function}_curve_name"] = curve
                model.note(kind, name, f"its coefficients of {function} are now the curve {curve!r}")


def _linear_curve(coefficients: list[float]) -> dict[str, Any]:
    variables = _VARIABLES[len(coefficients)]
    curve: dict[str, Any] = {"coefficient1_constant": coefficients[0]}
    for number, (letter, value) in enumerate(zip(variables, coefficients[1:], strict=True), 2):
        curve[f"coefficient{number}_{letter}"] = value
    temperatures = len(variables) - 2  # the last two variables are flows
    for position, letter in enumerate(variables):
        curve[f"minimum_value_of_{letter}"] = -100.0 if position < temperatures else 0.0
        curve[f"maximum_value_of_{letter}"] = 100.0
    return curve
