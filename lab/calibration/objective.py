"""The error of a model against measured data: one number from CV(RMSE) and NMBE of all columns.

    error = sqrt(sum(w * ((CV(RMSE) / limit)^2 + (NMBE / limit)^2)) / sum(w))

over the columns with their weights w, where the limits are those of ASHRAE Guideline 14 for hourly or monthly values
(see `zenostat.metrics.calibration_errors`); of a temperature, RMSE and mean bias over its tolerance instead. At 1, the
errors of a single column are on the limits' circle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any

import numpy as np

from zenostat.lab.calibration.measured import MeasuredColumn, MeasuredData, bounds
from zenostat.metrics.calibration_errors import HOURLY, MONTHLY, FitErrors, fit_errors
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig

Days = tuple[date, date]

Hours = Mapping[Days, Floats]
"""Simulated hours by period, shape (hours, columns)."""

_IMPLAUSIBLE = 30.0
"""Ratio of measured and simulated means beyond which a unit is taken for wrong."""


@dataclass(frozen=True)
class Compared:
    """The rows of a column within some periods: measured and simulated values.

    Attributes:
        rows: rows of the data that have a measured value.
    """

    column: MeasuredColumn
    rows: tuple[int, ...]
    measured: Floats
    simulated: Floats


def compare(data: MeasuredData, hours: Hours) -> list[Compared]:
    """Return measured and simulated values of each column over the periods of a simulation."""
    result = []
    for number, column in enumerate(data.columns):
        rows: list[int] = []
        values: list[float] = []
        for days, table in hours.items():
            start = bounds(days)[0]
            for row in data.rows_of(days):
                if math.isnan(column.values[row]):
                    continue
                first, last = (
                    round((time - start).total_seconds() / 3600) for time in (data.begins[row], data.ends[row])
                )
                rows.append(row)
                values.append(column.of_hours(table[first:last, number]))
        result.append(Compared(column, tuple(rows), column.values[rows], np.array(values, np.float64)))
    return result


Scales = Mapping[str, tuple[float, float]]
"""RMSE and mean bias of a column that count as 1, in its unit, by header."""


def scales_of(data: MeasuredData, periods: Iterable[Days]) -> Scales:
    """Return the scales of all columns from the measured values of some periods; see the module."""
    limits = MONTHLY if data.is_monthly else HOURLY
    rows = [row for days in periods for row in data.rows_of(days)]
    scales = {}
    for column in data.columns:
        mean = abs(float(np.nanmean(column.values[rows])))
        spread, bias = limits.cv_rmse_percent / 100.0 * mean, limits.nmbe_percent / 100.0 * mean
        scales[column.header] = (column.tolerance, column.tolerance) if column.is_absolute else (spread, bias)
    return scales


def objective(compared: Iterable[Compared], scales: Scales, adjustable: int) -> float:
    """Return the error of a simulation; see the module. A column with too few values is left out."""
    total = weights = 0.0
    for each in compared:
        errors = fit_errors(each.measured, each.simulated, adjustable)
        if math.isnan(errors.rmse):
            continue
        spread, bias = scales[each.column.header]
        weight = each.column.settings.weight
        total += weight * ((errors.rmse / spread) ** 2 + (errors.mbe / bias) ** 2)
        weights += weight
    return math.sqrt(total / weights) if weights else math.nan


@dataclass(frozen=True)
class ColumnErrors:
    """Errors of a column: of its rows, and of its calendar months.

    Attributes:
        rows: errors of the rows.
        months: errors of the totals (means, for what is no total) of calendar months; None if these are too few.
        is_hourly_within, is_monthly_within: whether they are within the guideline's limits; None: it has none for
            them, as for temperatures, and for rows of a day.
    """

    header: str
    unit: str
    rows: FitErrors
    months: FitErrors | None
    is_hourly_within: bool | None
    is_monthly_within: bool | None
    is_absolute: bool

    def plain(self) -> dict[str, Any]:
        """Return the errors as JSON."""
        errors = {"rows": self.rows, "months": self.months}
        return {
            "unit": self.unit,
            **{
                name: None if each is None else {
                    "count": each.count, "mean": each.mean, "rmse": each.rmse, "mbe": each.mbe,
                    "cv_rmse_percent": each.cv_rmse_percent, "nmbe_percent": each.nmbe_percent,
                }
                for name, each in errors.items()
            },
        }  # fmt: skip


def column_errors(data: MeasuredData, compared: Iterable[Compared], adjustable: int) -> list[ColumnErrors]:
    """Return the errors of each column."""
    result = []
    for each in compared:
        rows = fit_errors(each.measured, each.simulated, adjustable)
        months = None if data.is_monthly else _months(data, each, adjustable)
        has_limits = not each.column.is_absolute
        by_month = rows if data.is_monthly else months
        hourly = rows.is_within(HOURLY) if has_limits and data.is_hourly else None
        monthly = by_month.is_within(MONTHLY) if has_limits and by_month is not None else None
        result.append(ColumnErrors(each.column.header, each.column.unit, rows, months, hourly, monthly, not has_limits))
    return result


def _months(data: MeasuredData, each: Compared, adjustable: int) -> FitErrors | None:
    """Return the errors of the totals or means of calendar months over the compared rows."""
    places: dict[tuple[int, int], list[int]] = {}
    for place, row in enumerate(each.rows):
        begin = data.begins[row]
        places.setdefault((begin.year, begin.month), []).append(place)
    if len(places) <= adjustable:
        return None
    joined = np.sum if each.column.is_total else np.mean
    measured, simulated = (
        np.array([joined(values[chosen]) for chosen in places.values()], np.float64)
        for values in (each.measured, each.simulated)
    )
    return fit_errors(measured, simulated, adjustable)


def check_comparable(data: MeasuredData, compared: Sequence[Compared], adjustable: int) -> None:
    """Check that errors are defined, and that measured and simulated values can have the same unit.

    Raises:
        InvalidConfig: a column has too few values or a mean of 0, or another magnitude than the model.
    """
    for each in compared:
        column = each.column
        where = f"column {column.header!r}"
        if len(each.measured) <= adjustable:
            raise InvalidConfig(f"{where}: {len(each.measured)} values in the periods; expected more than {adjustable}")
        if column.is_absolute:
            continue
        measured, simulated = float(np.mean(each.measured)), float(np.mean(each.simulated))
        if measured == 0.0:
            raise InvalidConfig(
                f"{where}: the mean of its values in the periods is 0, so CV(RMSE) is not defined; set "
                f"columns.{column.header} to false, or choose other periods"
            )
        if simulated != 0.0 and not 1 / _IMPLAUSIBLE < abs(measured / simulated) < _IMPLAUSIBLE:
            line = data.lines[each.rows[0]]
            raise InvalidConfig(
                f"{where}, from line {line} on: the mean is {measured:.4g} {column.unit} measured and {simulated:.4g} "
                f"{column.unit} in the model ({column.point}): is the unit {column.unit!r} right, and the point?"
            )
