"""Forecasts of a test: weather with its errors, prices, emission factors, setpoints and occupants."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor
from typing import Any

import numpy as np

from zenostat.gateways.boptest import forecast_errors
from zenostat.gateways.boptest.baseline import Baseline, ZoneSchedules
from zenostat.gateways.boptest.parsing import BadRequest, unknown_names
from zenostat.gateways.boptest.prices import Rates, rate_at
from zenostat.gateways.boptest.simulation import YEAR_S, wrapped
from zenostat.gateways.boptest.weather import Weather
from zenostat.topics.arrays import Floats

UNCERTAIN = {"TDryBul": "temperature_uncertainty", "HGloHor": "solar_uncertainty"}
"""The points that have errors, with the field of the scenario that has their level."""

MAX_UNCERTAIN_S = 48 * 3600
MAX_VALUES = 2_000_000
MAX_HORIZON_S = 3 * YEAR_S


class Forecaster:
    """The forecasts of a test case.

    Args:
        weather: weather of the site.
        rates: prices and emission factors.
        schedules: setpoints and occupants of its zones.

    Attributes:
        points: by name, unit and description.
    """

    def __init__(self, weather: Weather, rates: Rates, schedules: ZoneSchedules) -> None:
        self._weather, self._rates, self._schedules = weather, rates, schedules
        self.points: dict[str, tuple[str, str]] = {
            **weather.points,
            **{name: (unit, text) for name, (_, unit, text) in rates.points.items()},
            **schedules.points,
        }
        self._stored: dict[str, tuple[Any, Floats]] = {}

    def forget_errors(self) -> None:
        """Draw new errors at the next forecast."""
        self._stored.clear()

    def forecast(
        self,
        names: list[str],
        now_s: float,
        horizon_s: float,
        interval_s: float,
        scenario: Mapping[str, Any],
        baseline: Baseline,
    ) -> dict[str, list[float]]:
        """Return `time` and the values of points from now to the horizon, inclusive.

        Args:
            names: points.
            now_s: the current time.
            horizon_s: at least 0, at most three years.
            interval_s: above 0.
            scenario: has the levels of uncertainty and the seed.
            baseline: the test's.

        Raises:
            BadRequest: an unknown point, too many values, or a horizon that is too long, which depends on the points.
        """
        if unknown := [name for name in names if name not in self.points]:
            raise unknown_names(unknown, "point_names")
        intervals = horizon_s / interval_s
        size = (intervals + 1) * (len(names) + 1)
        if size > MAX_VALUES:
            raise BadRequest(
                f"the forecast would have {size:.9g} values, including times; at most {MAX_VALUES} can be requested"
            )
        if horizon_s > MAX_HORIZON_S:
            raise BadRequest(f"The horizon of {horizon_s:g} s is longer than {MAX_HORIZON_S} s, the longest possible.")
        count = floor(intervals + 1e-9) + 1
        times_s: Floats = now_s + interval_s * np.arange(count, dtype=np.float64)
        result = {"time": _times(times_s)}
        for name in names:
            level = scenario.get(UNCERTAIN.get(name, ""))
            if level in forecast_errors.LEVELS:
                values = self._uncertain(name, level, times_s, horizon_s, scenario.get("seed"))
            else:
                values = self._certain(name, times_s, baseline)
            result[name] = values.tolist()
        return result

    def _certain(self, name: str, times_s: Floats, baseline: Baseline) -> Floats:
        if name in self._weather.points:
            return self._weather.at(name, times_s)
        if name in self._rates.points:
            return rate_at(self._rates.points[name][0], wrapped(times_s))
        return self._schedules.at(name, baseline, times_s)

    def _uncertain(self, name: str, level: str, times_s: Floats, horizon_s: float, seed: int | None) -> Floats:
        """Return a forecast with errors, which are drawn for full hours, and interpolated between them.

        As in BOPTEST, the number of hours follows from the horizon alone. After part of an hour, the forecast may end
        after the last one, whose error then holds.
        """
        if horizon_s > MAX_UNCERTAIN_S:
            raise BadRequest(
                f"The horizon of {horizon_s:g} s is longer than {MAX_UNCERTAIN_S} s, the longest for which the "
                f"uncertainty of {name} is defined."
            )
        hour_s = times_s[0] // 3600 * 3600
        key = (level, hour_s, horizon_s, seed)
        drawn = int((horizon_s + 3600) / 3600 + 1)
        hours_s = hour_s + 3600.0 * np.arange(drawn)
        if self._stored.get(name, (None,))[0] != key:
            start = None if seed is None else int(seed + times_s[0]) % 2**32
            if name == "TDryBul":
                errors = forecast_errors.temperature_errors(level, drawn, start)
            else:
                hourly = self._weather.at(name, hours_s)
                errors = hourly - forecast_errors.solar_forecast(level, hourly, start)
            self._stored[name] = (key, errors)
        truth = self._weather.at(name, times_s)
        values: Floats = truth - np.interp(times_s, hours_s, self._stored[name][1])
        return forecast_errors.limited(values, truth) if name == "HGloHor" else values


def _times(times_s: Floats) -> list[float]:
    """Return times as JSON numbers, whole ones as integers."""
    return [int(time) if time == int(time) else time for time in times_s.tolist()]
