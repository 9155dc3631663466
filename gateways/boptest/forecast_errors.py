"""Errors of weather forecasts.

Model and parameters: W. Zheng, Z. Wang et al., Journal of Building Performance Simulation (2025),
doi 10.1080/19401493.2025.2453537. Temperature errors are a first-order autoregression with normal noise, those of
global horizontal irradiation one with Laplace noise. The random numbers are those of NumPy's legacy generator, as in
BOPTEST, so that one seed gives one forecast.
"""

from __future__ import annotations

import numpy as np

from zenostat.topics.arrays import Floats

LEVELS = ("low", "medium", "high")

_TEMPERATURE = {
    "low": (0.0, 0.6, 0.92, 0.4, 0.0),
    "medium": (0.15, 1.2, 0.93, 0.6, 0.0),
    "high": (-0.58, 1.5, 0.95, 0.7, -0.015),
}
"""By level: mean and deviation of the first error, autocorrelation, deviation and mean of the noise."""

_SOLAR = {
    "low": (4.44, 57.42, 0.62, 1.86, 45.64),
    "medium": (15.02, 122.6, 0.63, 4.44, 91.97),
    "high": (32.09, 119.94, 0.67, 10.63, 87.44),
}
"""By level: location and scale of the first error, autocorrelation, location and scale of the noise."""

_DAYLIGHT_W_M2 = 50.0
_SHARE = (0.2, 2.0)
_TRIALS = 200


def temperature_errors(level: str, count: int, seed: int | None) -> Floats:
    """Return errors in K of the coming hours, shape (count,); None draws another seed."""
    first_mean, first_deviation, autocorrelation, deviation, mean = _TEMPERATURE[level]
    rng = np.random.RandomState(seed)
    errors = np.zeros(count)
    errors[0] = rng.normal(first_mean, first_deviation)
    for hour in range(1, count):
        errors[hour] = rng.normal(errors[hour - 1] * autocorrelation + mean, deviation)
    return errors


def solar_forecast(level: str, truth: Floats, seed: int | None) -> Floats:
    """Return a forecast of global horizontal irradiation in W/m2 for the coming hours, whose truth is known.

    By day it is within 0.2 to 2 times the truth: of up to 200 draws the first one that is, else the last one, limited.
    """
    first_location, first_scale, autocorrelation, location, scale = _SOLAR[level]
    is_day = truth > _DAYLIGHT_W_M2
    low, high = _SHARE[0] * truth, _SHARE[1] * truth
    forecast = truth
    for trial in range(_TRIALS):
        rng = np.random.RandomState(None if seed is None else (seed + trial**2) % 2**32)
        errors = np.zeros(len(truth))
        errors[0] = rng.laplace(first_location, first_scale)
        for hour in range(1, len(truth)):
            errors[hour] = rng.laplace(errors[hour - 1] * autocorrelation + location, scale)
        forecast = truth - errors
        if bool(((forecast >= low) & (forecast <= high))[is_day].all()):
            break
    return limited(_moving_mean(forecast), truth)


def limited(forecast: Floats, truth: Floats) -> Floats:
    """Return a forecast of irradiation within 0.2 to 2 times the truth."""
    values: Floats = np.clip(forecast, _SHARE[0] * truth, _SHARE[1] * truth)
    return values


def _moving_mean(values: Floats) -> Floats:
    """Return the mean of each value with its neighbors; the ends and zeros are unchanged."""
    means = values.copy()
    for index in range(1, len(values) - 1):
        if values[index] != 0.0:
            means[index] = values[index - 1 : index + 2].sum() / 3.0
    return means
