"""Objects of a BACnet device for a manifest's points: kinds, instance numbers, names, units, limits. No I/O."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple

from zenostat.gateways.bacnet.units import bacnet_unit
from zenostat.gateways.points import Reading, readings
from zenostat.topics.messages import Actuator, Manifest, Sensor

MAX_INSTANCE = 4_194_302
"""Largest instance number of an object (22 bits); 4,194,303 is the wildcard."""

_FIRST_INSTANCE = 1000


class ObjectKind(StrEnum):
    """BACnet object type of a point."""

    INPUT = "analog-input"
    OUTPUT = "analog-output"


class PointSpec(NamedTuple):
    """A BACnet object of one point.

    Attributes:
        kind: its object type.
        instance: its instance number.
        object_name: its name, unique in the device.
        position: place of the point in `Sample.values`, or of the actuator in the manifest.
        name: the point's name on the bus.
        unit: unit of its value; that of an amount is a rate where there is one.
        divisor: the value on the bus divided by the value of the object.
        low, high: bounds in `unit`; None: no bound.
        default: value while nobody commands the actuator; None: unknown, or an input.
        description: what EnergyPlus calls it.
    """

    kind: ObjectKind
    instance: int
    object_name: str
    position: int
    name: str
    unit: str
    divisor: float
    low: float | None
    high: float | None
    default: float | None
    description: str


def instance_number(name: str) -> int:
    """Return a number from 1,000 to 4,194,302 that depends on a name only (CRC-32)."""
    return _FIRST_INSTANCE + zlib.crc32(name.encode()) % (MAX_INSTANCE - _FIRST_INSTANCE + 1)


def instance_numbers(names: Iterable[str]) -> dict[str, int]:
    """Return a distinct number for each name: its own, or the next free one if an earlier name (A to Z) has it."""
    numbers: dict[str, int] = {}
    used: set[int] = set()
    for name in sorted(names):
        number = instance_number(name)
        while number in used:
            number = number + 1 if number < MAX_INSTANCE else _FIRST_INSTANCE
        used.add(number)
        numbers[name] = number
    return numbers


def point_specs(manifest: Manifest) -> list[PointSpec]:
    """Return the objects of a node's points: sensors and meters as inputs, actuators as outputs."""
    names = {manifest.node}
    inputs = instance_numbers(manifest.names)
    outputs = instance_numbers(actuator.name for actuator in manifest.actuators)

    def unique(name: str, suffix: str) -> str:
        object_name = f"{name}/{suffix}" if name in names else name  # names on the bus have no slash
        names.add(object_name)
        return object_name

    specs = [_input(reading, inputs[reading.name], unique(reading.name, "input")) for reading in readings(manifest)]
    specs += [
        _output(actuator, outputs[actuator.name], unique(actuator.name, "output"), index)
        for index, actuator in enumerate(manifest.actuators)
    ]
    return specs


def _input(reading: Reading, instance: int, object_name: str) -> PointSpec:
    point = reading.point
    source = _joined(point.variable, point.key) if isinstance(point, Sensor) else point.meter
    low, high = (None if bound is None else bound / reading.divisor for bound in (point.low, point.high))
    return PointSpec(
        ObjectKind.INPUT,
        instance,
        object_name,
        reading.index,
        reading.name,
        reading.unit,
        reading.divisor,
        low,
        high,
        None,
        _described([source, reading.note], reading.unit),
    )


def _output(actuator: Actuator, instance: int, object_name: str, index: int) -> PointSpec:
    text = _described(
        [_joined(_joined(actuator.component_type, actuator.control_type, " "), actuator.key)], actuator.unit
    )
    bounds = (actuator.low, actuator.high, actuator.default)
    return PointSpec(ObjectKind.OUTPUT, instance, object_name, index, actuator.name, actuator.unit, 1.0, *bounds, text)


def _joined(first: str, second: str, separator: str = ", ") -> str:
    return separator.join(text for text in (first, second) if text)


def _described(notes: list[str], unit: str) -> str:
    has_no_entry = unit != "1" and bacnet_unit(unit).name == "noUnits"
    return "; ".join(text for text in (*notes, f"unit: {unit}" if has_no_entry else "") if text)
