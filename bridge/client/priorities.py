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


def decode_remaining(message: PriorityArrays, manifest: Manifest) -> dict[str, dict[int, float]]:
    """Return by the actuator's name and the priority the simulated seconds after which a value is relinquished.

    Raises:
        BadMessage: The array does not have the manifest's shape.
    """
    if not message.remaining_s:
        return {actuator.name: {} for actuator in manifest.actuators}
    remaining = codec.floats(message.remaining_s, (len(manifest.actuators), 16), "remaining_s")
    return {
        actuator.name: {int(index) + 1: float(row[index]) for index in np.flatnonzero(~np.isnan(row))}
        for actuator, row in zip(manifest.actuators, remaining, strict=True)
    }


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
