"""Objects of a BACnet device that do not depend on the node's points. No I/O."""

from __future__ import annotations

from typing import NamedTuple

from zenostat.topics.messages import Manifest

MAX_STEPS = 1_000_000
"""Largest number of timesteps of one write to `node/advance`."""


class FixedObject(NamedTuple):
    """Type, instance number, name, description and bounds of an object.

    Attributes:
        kind: its BACnet object type.
        instance: its instance number.
        object_name: its name in the device.
        description: what it is.
        low, high: bounds of its value; None: no bound.
    """

    kind: str
    instance: int
    object_name: str
    description: str
    low: float | None = None
    high: float | None = None


ADVANCE = FixedObject(
    "analog-value",
    1,
    "node/advance",
    "write a number of timesteps to simulate while the node is paused; reads those left",
    0.0,
    float(MAX_STEPS),
)
STEP = FixedObject("analog-value", 2, "node/step", "number of the sample in the episode")
EPISODE = FixedObject("analog-value", 3, "node/episode", "number of the episode")
PAUSED = FixedObject("binary-value", 1, "node/paused", "pauses and resumes the node")
TIME = FixedObject("datetime-value", 1, "node/time", "simulated local standard time")
NETWORK_PORT = FixedObject("network-port", 1, "node/network-port", "address of the gateway")


def fixed_objects(manifest: Manifest, instance: int) -> list[FixedObject]:
    """Return the device with an instance number, and all objects but those of the points."""
    device = FixedObject("device", instance, manifest.node, device_description(manifest))
    return [device, NETWORK_PORT, ADVANCE, STEP, EPISODE, PAUSED, TIME]


def device_description(manifest: Manifest) -> str:
    """Return the description of the device object."""
    if not manifest.weather:
        return f"simulation of {manifest.building}"
    return f"simulated building {manifest.building} with weather {manifest.weather}"
