"""Numbers and messages as JSON: rounded, and null where there is no finite value."""

from __future__ import annotations

import json
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

_DIGITS = 7


def number(value: float | None) -> float | None:
    """Return a number with seven significant digits; None if it is not finite."""
    return float(f"{value:.{_DIGITS}g}") if value is not None and isfinite(value) else None


def numbers(values: ArrayLike) -> list[float | None]:
    """Return numbers with seven significant digits; None for those that are not finite."""
    return [number(value) for value in np.asarray(values, np.float64).ravel().tolist()]


def to_json(content: Any) -> bytes:
    """Return JSON in one line of ASCII: a line break in a text is written as two characters."""
    return json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
