"""Priority arrays of actuators for the page, requested from a node once for all pages."""

from __future__ import annotations

from typing import Any

from zenostat.bridge.client.bus import Bus
from zenostat.topics.errors import RequestRejected
from zenostat.topics.points import actuator_index
from zenostat.views.room.node_watch import NodeWatch
from zenostat.views.room.numbers import number


def priority_arrays(bus: Bus, watch: NodeWatch, point: str) -> dict[str, Any]:
    """Return the 16 entries of an actuator's priority array, that of priority 1 first.

    Raises:
        UnknownName: there is no such actuator; the text lists similar names.
    """
    description = watch.description
    if description is None:
        raise RequestRejected("the node has not answered yet")
    actuator_index(description.manifest.actuators).require([point])
    entries = bus.priorities(watch.node)[point]
    return {
        "point": point,
        "entries": [{"value": number(entry.value), "source": entry.source} for entry in entries],
    }
