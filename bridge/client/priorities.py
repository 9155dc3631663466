"""Priority arrays of a node's actuators, as a client of the bus sees them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from zenostat.bridge.client.requests import Requests
from zenostat.topics import codec, keys
from zenostat.topics.errors import UnknownName
from zenostat.topics.messages import Manifest, PriorityArrays, Query


class PriorityValue(NamedTuple):
    """One entry of a priority array: a value in the actuator's unit and its source; both None if relinquished."""

    value: float | None
    source: str | None


class PriorityRequests(Requests):
    """Base class of `Bus`: requests about the priorities of commands."""

    def priorities(self, node: str, *, slot: int = 0) -> dict[str, list[PriorityValue]]:
        """Return each actuator's priority array by its name: 16 entries, that of priority 1 first.

        The arrays are those before the next timestep: a command or a write that was accepted is in them at once.

        Raises:
            UnknownName: There is no such slot.
        """
        manifest = self.manifest(node)
        if not 0 <= slot < manifest.slots:
            raise UnknownName(f"node {node!r} has no slot {slot}; it has 0 to {manifest.slots - 1}")
        return decode_priorities(self._ask(keys.PRIORITIES, node, Query(), PriorityArrays), manifest, slot)


def decode_priorities(message: PriorityArrays, manifest: Manifest, slot: int = 0) -> dict[str, list[PriorityValue]]:
    """Return the priority arrays of a slot by the actuator's name.

    Raises:
        BadMessage: The arrays do not have the manifest's shape.
    """
    shape = (manifest.slots, len(manifest.actuators) * 16)
    values = codec.row(message.values, slot, *shape, "values").reshape(-1, 16)
    sources = codec.indices(message.source_index, shape, "source_index")[slot].reshape(-1, 16)
    return {
        actuator.name: [
            PriorityValue(None, None) if np.isnan(value) else PriorityValue(float(value), message.sources[source])
            for value, source in zip(values[index], sources[index], strict=True)
        ]
        for index, actuator in enumerate(manifest.actuators)
    }
