"""Priority arrays of actuators, as JSON values."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.priorities import decode_priorities, decode_remaining
from zenostat.topics import keys
from zenostat.topics.messages import Manifest, PriorityArrays, Query
from zenostat.topics.points import actuator_index
from zenostat.views.room.numbers import number


def priority_arrays(bus: Bus, manifest: Manifest, point: str) -> dict[str, Any]:
    """Return the 16 entries of an actuator's priority array, that of priority 1 first, with the time of its expiry.

    The time is None for a value that does not expire, or not before the year 10000.

    Raises:
        UnknownName: there is no such actuator; the text lists similar names.
    """
    actuator_index(manifest).require([point])
    arrays = bus.ask(keys.PRIORITIES, manifest.node, Query(), PriorityArrays)
    entries, remaining_s = decode_priorities(arrays, manifest)[point], decode_remaining(arrays, manifest)[point]
    now = manifest.time_at(arrays.step[0])
    ends = {priority: _end(now, after_s) for priority, after_s in remaining_s.items()}
    return {
        "point": point,
        "entries": [
            {"value": number(entry.value), "source": entry.source, "expires": ends.get(priority)}
            for priority, entry in enumerate(entries, 1)
        ],
    }


def _end(now: datetime, after_s: float) -> str | None:
    """Return a time in the future; None after the year 9999: durations of writes have no upper limit."""
    try:
        return (now + timedelta(seconds=after_s)).isoformat()
    except OverflowError:
        return None
