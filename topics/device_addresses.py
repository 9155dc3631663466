"""Addresses of a node's points in the gateways for devices: BACnet objects and Modbus registers.

They depend on the points' names and order alone, so that a gateway, a map on paper and a semantic model agree.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import NamedTuple

MAX_INSTANCE = 4_194_302
"""Largest instance number of a BACnet object (22 bits); 4,194,303 is the wildcard."""

_FIRST_INSTANCE = 1000

FIRST_INPUT_REGISTER = 16
"""Address of the first sensor among the Modbus input registers; those before it are the header."""

REGISTERS_PER_VALUE = 2
"""Modbus registers of a float32."""


class ObjectKind(StrEnum):
    """BACnet object type of a point."""

    INPUT = "analog-input"
    OUTPUT = "analog-output"


class BacnetObject(NamedTuple):
    """A BACnet object of one point: its type, its instance number, and its name, unique in the device."""

    kind: ObjectKind
    instance: int
    object_name: str


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


def bacnet_objects(
    node: str, inputs: Sequence[str], actuators: Sequence[str]
) -> tuple[list[BacnetObject], list[BacnetObject]]:
    """Return the objects of a node's sensors and meters, and those of its actuators, each in the order of the names.

    Args:
        node: name of the node, which is the name of the device.
        inputs: names of the sensors, then of the meters.
        actuators: names of the actuators.
    """
    taken = {node}

    def unique(name: str, suffix: str) -> str:
        object_name = f"{name}/{suffix}" if name in taken else name  # names on the bus have no slash
        taken.add(object_name)
        return object_name

    numbers = instance_numbers(inputs)
    readings = [BacnetObject(ObjectKind.INPUT, numbers[name], unique(name, "input")) for name in inputs]
    numbers = instance_numbers(actuators)
    outputs = [BacnetObject(ObjectKind.OUTPUT, numbers[name], unique(name, "output")) for name in actuators]
    return readings, outputs


def input_register(position: int) -> int:
    """Return the address, from 0, of the first input register of a value.

    Args:
        position: place among the sensors, then the meters, then the effective values of the actuators.
    """
    return FIRST_INPUT_REGISTER + REGISTERS_PER_VALUE * position


def holding_register(position: int) -> int:
    """Return the address, from 0, of the first holding register of an actuator's command.

    Args:
        position: place among the actuators.
    """
    return REGISTERS_PER_VALUE * position
