"""Numbers in JSON, which has neither NaN nor infinities."""

from __future__ import annotations

from math import isfinite
from typing import Any


def finite(data: Any) -> Any:
    """Return a copy of data for JSON with None in place of numbers that are not finite."""
    if isinstance(data, float):
        return data if isfinite(data) else None
    if isinstance(data, dict):
        return {name: finite(part) for name, part in data.items()}
    return [finite(part) for part in data] if isinstance(data, (list, tuple)) else data
