"""Numbers of a node at a glance, as a text for each sample of a choice."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from math import isnan
from typing import NamedTuple

import numpy as np

from bridge.display.roles import PointRoles
from bridge.rerun.samples import SampleBlock
from bridge.rerun.totals import TotalRows

NUMBERS = "numbers"
_NO_VALUE = "\N{EN DASH}"
_MARKUP = re.compile(r"[\\`*\[\]<>!#~&]")
_MAX_NAMES = 3
MAX_TEXTS = 500
"""Largest number of texts in an episode."""


class NodeStatus(NamedTuple):
    """Names of a node's connected controllers, and of its active faults."""

    controllers: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


@dataclass(slots=True)
class NodeNumbers:
    """A node's numbers at one sample; None where the node does not have them.

    Attributes:
        time: simulated time.
        low_degc, high_degc: lowest and highest zone temperature.
        zones_outside: number of zones outside their comfort band.
        facility_kw, hvac_kw: electric power; `hvac_label`: what the second is measured of.
        facility_kwh, hvac_kwh: electricity since the first sample.
        outside_kh, occupied_kh: kelvin hours outside the band since the first sample: all, and of occupied zones.
        controllers: names of the connected controllers.
        faults: injected faults that are active.
    """

    time: datetime | None = None
    outdoor_degc: float | None = None
    low_degc: float | None = None
    high_degc: float | None = None
    zones: int = 0
    zones_outside: int | None = None
    people: float | None = None
    facility_kw: float | None = None
    hvac_label: str = "HVAC"
    hvac_kw: float | None = None
    facility_kwh: float | None = None
    hvac_kwh: float | None = None
    outside_kh: float | None = None
    occupied_kh: float | None = None
    controllers: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def numbers_at(
    row: int,
    block: SampleBlock,
    totals: TotalRows,
    roles: PointRoles,
    status: NodeStatus,
) -> NodeNumbers:
    """Return a node's numbers at one row of a block."""
    values = block.values[row]
    zones = [zone.temperature for zone in roles.zones if zone.temperature is not None]
    air = [value for value in values[zones].tolist() if not isnan(value)]
    people = [values[zone.occupants] for zone in roles.zones if zone.occupants is not None]
    has_band = block.deviations.shape[1] > 0
    outdoor = roles.outdoor_temperature
    return NodeNumbers(
        time=block.times[row].astype("M8[s]").item(),
        outdoor_degc=None if outdoor is None else _known(values[outdoor]),
        low_degc=min(air, default=None),
        high_degc=max(air, default=None),
        zones=len(zones),
        zones_outside=int((np.abs(block.deviations[row]) > 0.05).sum()) if has_band else None,
        people=float(sum(people)) if people else None,
        facility_kw=_known(totals.facility_kw[row]),
        hvac_label=roles.hvac_power.label if roles.hvac_power else "HVAC",
        hvac_kw=_known(totals.hvac_kw[row]),
        facility_kwh=_known(totals.facility_kwh[row]),
        hvac_kwh=_known(totals.hvac_kwh[row]),
        outside_kh=_known(totals.outside_kh[row]) if has_band else None,
        occupied_kh=_known(totals.occupied_kh[row]) if has_band else None,
        controllers=status.controllers,
        faults=status.faults,
    )


def _known(value: float) -> float | None:
    return None if isnan(value) else float(value)


def quantity(value: float | None, unit: str, digits: int = 1) -> str:
    """Return a number with its unit, `1,234.5 kWh`; a dash for None."""
    return _NO_VALUE if value is None else f"{value:,.{digits}f} {unit}".rstrip()


def _people(count: float) -> str:
    return "person" if round(count) == 1 else "people"


def clock(time: datetime | None) -> str:
    """Return a simulated time: `Sun 2 Jul 2017, 17:30`; a dash for None."""
    return _NO_VALUE if time is None else f"{time:%a} {time.day} {time:%b %Y, %H:%M}"


def markdown(numbers: NodeNumbers) -> str:
    """Return the numbers as a table in markdown; columns that the node does not have are left out."""
    cells = [("Simulated time", clock(numbers.time)), ("Outdoors", _degrees(numbers.outdoor_degc))]
    if numbers.low_degc is not None and numbers.high_degc is not None:
        cells.append(("Zones", f"{numbers.low_degc:.1f} to {numbers.high_degc:.1f} °C"))
    if numbers.zones_outside is not None:
        cells.append(("Outside comfort", f"{numbers.zones_outside} of {numbers.zones} zones"))
    if numbers.people is not None:
        cells.append(("Occupants", quantity(numbers.people, _people(numbers.people), 0)))
    cells += [
        (numbers.hvac_label, _kw(numbers.hvac_kw)),
        (f"{numbers.hvac_label} so far", _kwh(numbers.hvac_kwh)),
        ("Whole building", _kw(numbers.facility_kw)),
        ("Electricity so far", _kwh(numbers.facility_kwh)),
        ("Outside comfort, occupied", _kh(numbers.occupied_kh)),
        ("Outside comfort, all hours", _kh(numbers.outside_kh)),
        ("Controllers", _listing(numbers.controllers)),
        ("Active faults", _listing(numbers.faults)),
    ]
    cells = [(name, text) for name, text in cells if text]
    head, values = (" | ".join(column) for column in zip(*((name, f"**{text}**") for name, text in cells), strict=True))
    return "\n".join([f"| {head} |", "|" + "---|" * len(cells), f"| {values} |"])


def _degrees(value: float | None) -> str:
    return "" if value is None else quantity(value, "°C")


def _kw(value: float | None) -> str:
    return "" if value is None else quantity(value, "kW")


def _kwh(value: float | None) -> str:
    return "" if value is None else quantity(value, "kWh", 0)


def _kh(value: float | None) -> str:
    return "" if value is None else quantity(value, "K h")


def _listing(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_MAX_NAMES])
    more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    return _literal(f"{shown}{more}") or "none"


def _literal(text: str) -> str:
    """Return a text for a cell of a table in markdown, with a backslash before what would be markup or a link."""
    return _MARKUP.sub(r"\\\g<0>", text.replace("|", "/"))


@dataclass(slots=True)
class NodeRow:
    """A node's row in the overview."""

    name: str
    building: str
    numbers: NodeNumbers
    is_connected: bool = True


def overview(rows: list[NodeRow]) -> str:
    """Return the overview of several nodes as a table in markdown."""
    head = (
        "Node", "Building", "Simulated time", "Zones", "HVAC", "Electricity so far", "Degree-hours outside, occupied",
        "Controllers", "Faults",
    )  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in sorted(rows, key=lambda row: row.name):
        numbers = row.numbers
        zones = _NO_VALUE if numbers.low_degc is None else f"{numbers.low_degc:.1f} to {numbers.high_degc:.1f} °C"
        energy = numbers.facility_kwh if numbers.facility_kwh is not None else numbers.hvac_kwh
        cells = (
            f"**{row.name}**" + ("" if row.is_connected else " (gone)"),
            _literal(row.building),
            clock(numbers.time),
            zones,
            quantity(numbers.hvac_kw, "kW") + ("" if numbers.hvac_label == "HVAC" else f" ({numbers.hvac_label})"),
            quantity(energy, "kWh", 0),
            quantity(numbers.occupied_kh, "K h"),
            _literal(", ".join(numbers.controllers)) or "none",
            _literal(", ".join(numbers.faults)) or "none",
        )
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines)
