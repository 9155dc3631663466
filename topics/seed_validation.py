"""Validation of seeds: the numbers that fit into a message."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, SupportsIndex

from zenostat.topics.errors import InvalidConfig

MAX_SEED = 2**64 - 1


def check_seed(seed: Any, slots: int = 1) -> int:
    """Return a seed as a Python int.

    Args:
        seed: an int or a NumPy integer.
        slots: number of consecutive seeds, of which this is the first.

    Raises:
        InvalidConfig: the seed has another type or is out of range.
    """
    if isinstance(seed, SupportsIndex) and not isinstance(seed, bool):
        with suppress(TypeError):  # an array of NumPy has the method, but not always an index
            number = seed.__index__()
            if 0 <= number <= MAX_SEED - (slots - 1):
                return number
    raise InvalidConfig(f"seed = {seed!r}; an integer from 0 to 2**64 - {slots} expected")
