"""Registers, coils and discrete inputs of a node: which point is where.

Float32 values take two registers, the high word first (with word order `little` the low word first). Addresses are
those of the protocol, from 0; many programs count from 1.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields
from enum import StrEnum
from zlib import crc32

from zenostat.gateways.points import readings
from zenostat.topics.device_addresses import FIRST_INPUT_REGISTER, REGISTERS_PER_VALUE, holding_register, input_register
from zenostat.topics.messages import Manifest

MAP_VERSION = 1
"""Version of the layout; it changes when registers of the header or blocks move."""

FIRST_VALUE = FIRST_INPUT_REGISTER
"""Address of the first sensor among the input registers, and of the first actuator among the discrete inputs."""


class Table(StrEnum):
    """A table of the Modbus data model."""

    COIL = "coil"
    DISCRETE_INPUT = "discrete input"
    INPUT_REGISTER = "input register"
    HOLDING_REGISTER = "holding register"


@dataclass(frozen=True, slots=True)
class Entry:
    """One row of the map.

    Attributes:
        table: the table of the data model.
        address: first address in the table, from 0.
        count: number of registers, 1 for bits.
        type: `uint16`, `uint32`, `float32` or `bit`.
        name: name of the point, or of a field of the header.
        unit: unit of the value.
        low, high: bounds of an actuator.
        description: meaning, for people.
    """

    table: Table
    address: int
    count: int
    type: str
    name: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    description: str = ""


class RegisterMap:
    """The map of one node.

    Attributes:
        entries: rows, by table and address.
        checksum: 16 bits of the CRC-32 of the map's CSV, which the header contains: a client that compares it with that
            of the map for which it was written notices another building.
    """

    def __init__(self, manifest: Manifest) -> None:
        self.entries = [*_input_registers(manifest), *_holding_registers(manifest), *_bits(manifest)]
        self.checksum = crc32(self.csv().encode()) & 0xFFFF

    def csv(self) -> str:
        """Return the map as CSV with a header row."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(field.name for field in fields(Entry))
        writer.writerows(["" if cell is None else cell for cell in astuple(entry)] for entry in self.entries)
        return text.getvalue()

    def markdown(self) -> str:
        """Return the map as a table in Markdown."""
        names = [field.name for field in fields(Entry)]
        rows = [names, ["---"] * len(names)]
        rows += [["" if cell is None else str(cell) for cell in astuple(entry)] for entry in self.entries]
        return "".join(f"| {' | '.join(row)} |\n" for row in rows)


HEADER = (
    ("map_version", "uint16", "version of this layout"),
    ("readings", "uint16", "number of sensors and meters"),
    ("actuators", "uint16", "number of actuators"),
    ("map_checksum", "uint16", "checksum of this map"),
    ("episode", "uint32", "number of the episode"),
    ("step", "uint32", "number of the sample in the episode"),
    ("time", "uint32", "local standard time as seconds since 1970-01-01 00:00"),
    ("timestep", "float32", "length of a timestep"),
)
"""Fields at the beginning of the input registers: name, type, description."""

STATES = (
    ("node_up", "the node is on the bus"),
    ("episode_running", "the episode is not over"),
    ("fallback", "the latest timestep ran without a command of a required controller"),
)
"""Discrete inputs before those of the actuators."""

WIDTHS = {"uint16": 1, "uint32": 2, "float32": 2, "bit": 1}
"""Number of addresses of a value, by its type."""


def _input_registers(manifest: Manifest) -> Iterator[Entry]:
    address = 0
    for name, kind, description in HEADER:
        unit = "s" if name in ("time", "timestep") else ""
        yield Entry(Table.INPUT_REGISTER, address, WIDTHS[kind], kind, name, unit, description=description)
        address += WIDTHS[kind]
    rows = [(reading.name, reading.unit, reading.note) for reading in readings(manifest)]
    rows += [(actuator.name, actuator.unit, "effective value") for actuator in manifest.actuators]
    for position, (name, unit, text) in enumerate(rows):
        address = input_register(position)
        yield Entry(Table.INPUT_REGISTER, address, REGISTERS_PER_VALUE, "float32", name, unit, description=text)


def _holding_registers(manifest: Manifest) -> Iterator[Entry]:
    for index, actuator in enumerate(manifest.actuators):
        yield Entry(
            Table.HOLDING_REGISTER, holding_register(index), REGISTERS_PER_VALUE, "float32",
            actuator.name, actuator.unit, actuator.low, actuator.high,
            "command at the gateway's priority; NaN while relinquished",
        )  # fmt: skip


def _bits(manifest: Manifest) -> Iterator[Entry]:
    for index, actuator in enumerate(manifest.actuators):
        text = "1: commanded by the gateway; write 0 to relinquish"
        yield Entry(Table.COIL, index, 1, "bit", actuator.name, description=text)
    for address, (name, description) in enumerate(STATES):
        yield Entry(Table.DISCRETE_INPUT, address, 1, "bit", name, description=description)
    for index, actuator in enumerate(manifest.actuators):
        text = "the gateway's command is in effect"
        yield Entry(Table.DISCRETE_INPUT, FIRST_VALUE + index, 1, "bit", actuator.name, description=text)
