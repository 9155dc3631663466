"""Numbers in single precision, as Modbus registers and BACnet's Real transport them."""

from __future__ import annotations

import math
import struct

from zenostat.topics.points import Bounded


def single(value: float) -> float:
    """Return a value rounded to single precision; infinite where that has no such number."""
    try:
        return float(struct.unpack(">f", struct.pack(">f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


def snapped(limits: Bounded, number: float) -> float:
    """Return the bound of which a number in single precision is the rounded value; else the number itself.

    The rounded value can lie outside the bounds: a client that writes the bound that it has read means the bound.
    """
    for bound in (limits.low, limits.high):
        if bound is not None and math.isfinite(number) and single(bound) == number:
            return bound
    return number


def double(value: float) -> float:
    """Return the number with the fewest digits that is the same in single precision: 21.1, not 21.100000381."""
    for digits in range(6, 9):
        text = f"{value:.{digits}g}"
        if single(float(text)) == single(value):
            return float(text)
    return value


def intended(limits: Bounded, number: float) -> float:
    """Return the number that a client means by one in single precision: a bound, or the one with the fewest digits."""
    bound = snapped(limits, number)
    return double(number) if bound == number else bound
