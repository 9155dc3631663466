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
