"""Tables of curves become `Table:Lookup` with independent variables (9.1 to 9.2; transition rules V9_2_0).

EnergyPlus itself had no equivalent of the old polynomial interpolation; its transition program writes cubic
interpolation for it, and so do these rules. Values between the points of a table can therefore differ.
"""

from __future__ import annotations

from itertools import product
from math import prod
from typing import Any

from zenostat.models.upgrade.step import UpgradingModel

_ONE, _TWO, _MANY = "Table:OneIndependentVariable", "Table:TwoIndependentVariables", "Table:MultiVariableLookup"
_COUNTS = (
    "number_of_values_for_independent_variable_x1",
    "field_1_determined_by_the_number_of_independent_variables",
    "field_2_determined_by_the_number_of_independent_variables",
)
_VALUE = "field_determined_by_the_number_of_independent_variables"
_EXTERNAL = "its data are in an external file; write them into the object"
_INCOMPLETE = "its points are no complete grid"

Grid = tuple[list[list[float]], list[float]]
"""Values of each variable, ascending; outputs, of which the last variable changes fastest."""


def lookup_tables(model: UpgradingModel) -> None:
    """Replace the three kinds of tables."""
    for kind, letters in ((_ONE, "x"), (_TWO, "xy")):
        for name, fields in model.items(kind):
            keys = [f"{letter}_value_1" for letter in letters]
            points = {tuple(float(e[k]) for k in keys): float(e["output_value_1"]) for e in fields.get("values", ())}
            axes = [sorted({point[axis] for point in points}) for axis in range(len(letters))]
            grid = list(product(*axes))
            if fields.get("external_file_name") or not points or any(point not in points for point in grid):
                reason = _EXTERNAL if fields.get("external_file_name") else _INCOMPLETE
                model.refuse(kind, name, reason)
                continue
            _replace(model, kind, name, list(letters), (axes, [points[point] for point in grid]))
    for name, fields in model.items(_MANY):
        table = _read_matrix(fields)
        if isinstance(table, str):
            model.refuse(_MANY, name, table)
        else:
            _replace(model, _MANY, name, [f"x{number}" for number in range(1, len(table[0]) + 1)], table)


def _read_matrix(fields: dict[str, Any]) -> Grid | str:
    """Read a table of many variables, of which the first one changes fastest; a reason if that is impossible."""
    if fields.get("external_file_name"):
        return _EXTERNAL
    numbers = [fields[key] for key in _COUNTS if fields.get(key, "") != ""]
    numbers += [entry.get(_VALUE, "") for entry in fields.get("values", ())]
    try:
        count = int(fields.get("number_of_independent_variables", 0))
        sizes = [int(number) for number in numbers[:count]]
        flat = [float(number) for number in numbers[count:] if number != ""]
    except ValueError:
        return _INCOMPLETE
    axes: list[list[float]] = []
    for size in sizes:
        axes.append(flat[:size])
        flat = flat[size:]
    if not count or len(sizes) != count or _has_headers(flat, axes):
        return "its data have a line of values for each combination of the further variables, which no rule reads"
    if len(flat) != prod(sizes):
        return _INCOMPLETE
    points = {}
    for value, backwards in zip(flat, product(*reversed(axes)), strict=True):
        points[tuple(reversed(backwards))] = value
    ordered = [sorted(axis) for axis in axes]
    return ordered, [points[point] for point in product(*ordered)]


def _has_headers(flat: list[float], axes: list[list[float]]) -> bool:
    """Whether the further variables' values precede each matrix of outputs of the first two."""
    matrix = prod(len(axis) for axis in axes[:2])
    blocks = prod(len(axis) for axis in axes[2:])
    return len(axes) > 2 and len(flat) == blocks * (matrix + len(axes) - 2)


def _replace(model: UpgradingModel, kind: str, name: str, letters: list[str], grid: Grid) -> None:
    fields = dict(model.items(kind))[name]
    method = str(fields.get("interpolation_method", "LagrangeInterpolationLinearExtrapolation")).casefold()
    interpolation = "Linear" if method == "linearinterpolationoftable" else "Cubic"
    extrapolation = "Linear" if method == "lagrangeinterpolationlinearextrapolation" else "Constant"
    names = []
    for number, (letter, axis) in enumerate(zip(letters, grid[0], strict=True), 1):
        variable = {"interpolation_method": interpolation, "extrapolation_method": extrapolation}
        limits = {f"{end}_value": fields.get(f"{end}_value_of_{letter}", "") for end in ("minimum", "maximum")}
        unit = fields.get(f"input_unit_type_for_{letter}", "")
        filled = {key: value for key, value in (limits | {"unit_type": unit}).items() if value != ""}
        entries = {"values": [{"value": value} for value in axis]}
        added = f"{name}_IndependentVariable{number}"
        names.append(model.add("Table:IndependentVariable", added, variable | filled | entries, source=(kind, name)))
    variables = {"independent_variables": [{"independent_variable_name": added} for added in names]}
    listed = model.add("Table:IndependentVariableList", f"{name}_IndependentVariableList", variables,
                       source=(kind, name))  # fmt: skip
    table: dict[str, Any] = {"independent_variable_list_name": listed}
    if (divisor := fields.get("normalization_reference", "")) != "":
        table |= {"normalization_method": "DivisorOnly", "normalization_divisor": divisor}
    renamed = {"minimum_table_output": "minimum_output", "maximum_table_output": "maximum_output",
               "output_unit_type": "output_unit_type"}  # fmt: skip
    table |= {new: fields[old] for old, new in renamed.items() if fields.get(old, "") != ""}
    model.add("Table:Lookup", name, table | {"values": [{"output_value": value} for value in grid[1]]},
              source=(kind, name))  # fmt: skip
    note = (
        ""
        if interpolation == "Linear"
        else "; between its points it can differ, because EnergyPlus has no polynomial interpolation"
    )
    model.remove(kind, name, f"is now a Table:Lookup with {interpolation.lower()} interpolation{note}")
