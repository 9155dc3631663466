"""Weather between the rows of a weather file, as EnergyPlus interpolates it."""

from __future__ import annotations

import numpy as np

from zenostat.topics.arrays import Floats

_DAY_S = 86400.0


class WeatherColumn:
    """A column of a weather file as a function of the time since the run period's start, linear between its rows.

    A row is valid at the end of its interval. The first interval begins with the last row of the first day, because
    the field First Hour Interpolation Starting Values of EnergyPlus's RunPeriod is Hour24. The last row is held.

    Args:
        values: of the rows, shape (rows,); NaN where one is missing, which is skipped, but not in all rows.
        interval_s: time between two rows.
        period: 360 for an angle in degrees, which is interpolated over the shorter arc; None for other quantities.
        is_mean: whether a row is the mean of its interval, so that it is valid in its middle.
    """

    def __init__(
        self, values: Floats, interval_s: float, *, period: float | None = None, is_mean: bool = False
    ) -> None:
        end_of_day = min(round(_DAY_S / interval_s), len(values)) - 1
        rows = np.concatenate([values[end_of_day : end_of_day + 1], values])
        is_valid = np.isfinite(rows)
        times_s = interval_s * (np.arange(len(rows)) - 0.5 * is_mean)
        self._times_s: Floats = times_s[is_valid]
        self._values: Floats = rows[is_valid] if period is None else np.unwrap(rows[is_valid], period=period)
        self._period = period

    def at(self, times_s: Floats) -> Floats:
        """Return the values at times in seconds since the run period's start."""
        values: Floats = np.interp(times_s, self._times_s, self._values)
        return values if self._period is None else values % self._period
