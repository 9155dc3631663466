"""Round ticks of axes, and numbers as text."""

from __future__ import annotations

import math
from datetime import datetime, timedelta

from zenostat.metrics.labels import date_label

_MINUS = "\N{MINUS SIGN}"
_FACTORS = (1.0, 2.0, 2.5, 5.0)
_MARGIN = 0.06
_MIN_SPAN = 0.1
_RESOLUTION = 1e-9
"""Least extent of an axis as a part of its values, so that its limits differ."""
_TINY = 1e-200
_TICK_HOURS = (
    *(minutes / 60.0 for minutes in (1, 2, 5, 10, 15, 30)), 1.0, 2.0, 3.0, 6.0, 12.0, 24.0, 48.0, 168.0, 336.0, 672.0,
)  # fmt: skip
_MOST_TIME_TICKS = 9


def round_scale(
    low: float, high: float, min_span: float | None, most: int, *, from_zero: bool = False
) -> tuple[float, float, list[float]]:
    """Return lower and upper limit of an axis, and at most `most` (at least 2) round ticks within them.

    The axis extends over at least `min_span`; if that is None, over a tenth of its values, but not more than 0.1.
    """
    size = max(abs(low), abs(high))
    min_span = max(min(_MIN_SPAN, 0.1 * size) if min_span is None else min_span, _RESOLUTION * size, _TINY)
    if from_zero:
        low, high = min(low, 0.0), max(high, 0.0)
    if low == high == 0.0:
        high = max(min_span, 1.0)
    if high - low < min_span:
        if from_zero and low == 0.0:
            high = min_span
        elif from_zero and high == 0.0:
            low = -min_span
        else:
            middle = 0.5 * (low + high)
            low, high = middle - 0.5 * min_span, middle + 0.5 * min_span
    margin = _MARGIN * (high - low)
    bottom = low if from_zero and low == 0.0 else low - margin
    top = high if from_zero and high == 0.0 else high + margin
    power = 10.0 ** math.floor(math.log10((top - bottom) / most))
    steps = (factor * power * ten for ten in (1.0, 10.0, 100.0) for factor in _FACTORS)
    step = next(step for step in steps if _last(top, step) - _first(bottom, step) < most)
    return bottom, top, [step * n for n in range(_first(bottom, step), _last(top, step) + 1)]


def _first(bottom: float, step: float) -> int:
    return math.ceil(bottom / step - 1e-9)


def _last(top: float, step: float) -> int:
    return math.floor(top / step + 1e-9)


def time_ticks(first: float, last: float) -> list[float]:
    """Return ticks at round times from `first` to `last`, all in hours since a midnight."""
    span = last - first
    step = next((hours for hours in _TICK_HOURS if span / hours <= _MOST_TIME_TICKS), span / _MOST_TIME_TICKS)
    return [step * n for n in range(_first(first, step), _last(last, step) + 1)]


def format_time_tick(origin: datetime, hours: float) -> str:
    """Return the time `hours` after `origin`; at midnight the date."""
    time = origin + timedelta(minutes=round(60.0 * hours))
    if time.hour or time.minute:
        return f"{time:%H:%M}"
    return date_label(time)


def format_time(time: datetime) -> str:
    """Return a date and time, in English whatever the locale is."""
    clock = f"{time:%H:%M:%S}" if time.second else f"{time:%H:%M}"
    return f"{date_label(time)} {time.year}, {clock}"


def format_tick(value: float) -> str:
    """Return a tick's number."""
    text = f"{value:.6g}" if abs(value) < 1e5 else f"{value:.3g}"
    return text.replace("-", _MINUS) if float(text) else "0"


def format_value(value: float, unit: str, *, is_integer: bool = False) -> str:
    """Return a measured value with a sensible number of digits; `n/a` if it is unknown."""
    if math.isnan(value):
        return "n/a"
    size = abs(value)
    if unit == "°C":
        text = f"{value:.1f}"
    elif is_integer or unit == "people" or 100.0 <= size < 1e5:
        text = f"{value:,.0f}"
    elif size >= 1e5 or 0.0 < size < 1e-3:
        text = f"{value:.1e}"
    else:
        text = f"{value:.1f}" if size >= 10.0 else f"{value:.2f}" if size >= 0.1 else f"{value:.2g}"
    return text.replace("-", _MINUS) if float(text.replace(",", "")) else text.lstrip("-")


def format_range(low: float, high: float, unit: str) -> str:
    """Return two measured values as a range."""
    return f"{format_value(low, unit)} to {format_value(high, unit)}"
