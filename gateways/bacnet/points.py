"""Objects of a BACnet device for a manifest's points: kinds, instance numbers, names, units, limits. No I/O."""

from __future__ import annotations

from typing import NamedTuple

from zenostat.gateways.bacnet.units import bacnet_unit
from zenostat.gateways.points import Reading, readings
from zenostat.topics.device_addresses import BacnetObject, ObjectKind, bacnet_objects
from zenostat.topics.messages import Actuator, Manifest, Sensor


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


def point_specs(manifest: Manifest) -> list[PointSpec]:
    """Return the objects of a node's points: sensors and meters as inputs, actuators as outputs."""
    inputs, outputs = bacnet_objects(manifest.node, manifest.names, [each.name for each in manifest.actuators])
    specs = [_input(reading, named) for reading, named in zip(readings(manifest), inputs, strict=True)]
    pairs = zip(manifest.actuators, outputs, strict=True)
    return specs + [_output(actuator, named, index) for index, (actuator, named) in enumerate(pairs)]


def _input(reading: Reading, named: BacnetObject) -> PointSpec:
    point = reading.point
    source = _joined(point.variable, point.key) if isinstance(point, Sensor) else point.meter
    low, high = (None if bound is None else bound / reading.divisor for bound in (point.low, point.high))
    return PointSpec(
        *named,
        reading.index,
        reading.name,
        reading.unit,
        reading.divisor,
        low,
        high,
        None,
        _described([source, reading.note], reading.unit),
    )


def _output(actuator: Actuator, named: BacnetObject, index: int) -> PointSpec:
    text = _described(
        [_joined(_joined(actuator.component_type, actuator.control_type, " "), actuator.key)], actuator.unit
    )
    bounds = (actuator.low, actuator.high, actuator.default)
    return PointSpec(*named, index, actuator.name, actuator.unit, 1.0, *bounds, text)


def _joined(first: str, second: str, separator: str = ", ") -> str:
    return separator.join(text for text in (first, second) if text)


def _described(notes: list[str], unit: str) -> str:
    has_no_entry = unit != "1" and bacnet_unit(unit).name == "noUnits"
    return "; ".join(text for text in (*notes, f"unit: {unit}" if has_no_entry else "") if text)
