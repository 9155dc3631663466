"""Seeds of episodes: the numbers that a message can carry."""

from __future__ import annotations

from typing import Any, SupportsIndex

from topics.errors import InvalidConfig

MAX_SEED = 2**64 - 1


def check_seed(seed: Any, slots: int = 1) -> int:
    """Return a seed as a Python int.

    Args:
        seed: an int, of NumPy's as well.
        slots: how many seeds are counted up from it.

    Raises:
        InvalidConfig: another type, or out of range.
    """
    if isinstance(seed, SupportsIndex) and not isinstance(seed, bool):
        number = seed.__index__()
        if 0 <= number <= MAX_SEED - (slots - 1):
            return number
    raise InvalidConfig(f"seed = {seed!r}; a whole number from 0 to 2**64 - {slots} expected")
