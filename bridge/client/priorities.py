"""Priority arrays of a node's actuators, as a client of the bus sees them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from zenostat.topics import codec
from zenostat.topics.messages import Manifest, PriorityArrays


class PriorityValue(NamedTuple):
    """One entry of a priority array: a value in the actuator's unit and its source; both None if relinquished."""

    value: float | None
    source: str | None


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
