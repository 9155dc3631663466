"""Numbers of a node at a glance, as a text for each sample."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from zenostat.metrics.comfort import band_text
from zenostat.metrics.roles import PointRoles
from zenostat.topics.arrays import Floats
from zenostat.topics.plurals import counted
from zenostat.views.live.samples import BASELINE, SampleBlock
from zenostat.views.live.totals import TotalRows

NUMBERS = "numbers"
_NO_VALUE = "\N{EN DASH}"
_MARKUP = re.compile(r"[\\`*\[\]<>!#~&]")
_MAX_NAMES = 3


class NodeStatus(NamedTuple):
    """Names of a node's active alarms, and of its active faults."""

    alarms: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


class FuelUse(NamedTuple):
    """Use of a fuel: its power, and its energy since the first sample."""

    fuel: str
    kw: float
    kwh: float


@dataclass(slots=True)
class NodeNumbers:
    """A node's numbers at one sample; None where the node does not have them.

    Attributes:
        time: simulated time.
        low_degc, high_degc: lowest and highest zone temperature.
        band_degc: lowest and highest limit of the zones' comfort bands, NaN for none.
        zones_outside: number of zones outside their comfort band.
        facility_kw, hvac_kw: electric power; `hvac_label`: what the second is measured of.
        facility_kwh, hvac_kwh: electricity since the first sample.
        peak_kw: highest electric power of the whole building since the first sample.
        fuels: use of the fuels besides electricity.
        outside_kh, occupied_kh: degree-hours outside the band since the first sample: all, and of occupied zones.
        sources: names of the controllers and devices that set actuators in the timestep, in the actuators' order.
        alarms: alarms whose condition is present.
        faults: injected faults that are active.
    """

    time: datetime | None = None
    outdoor_degc: float | None = None
    low_degc: float | None = None
    high_degc: float | None = None
    band_degc: tuple[float, float] | None = None
    zones: int = 0
    zones_outside: int | None = None
    people: float | None = None
    facility_kw: float | None = None
    hvac_label: str = "HVAC"
    hvac_kw: float | None = None
    facility_kwh: float | None = None
    hvac_kwh: float | None = None
    peak_kw: float | None = None
    fuels: Sequence[FuelUse] = ()
    outside_kh: float | None = None
    occupied_kh: float | None = None
    sources: tuple[str, ...] = ()
    alarms: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def numbers_of(
    block: SampleBlock, totals: TotalRows, roles: PointRoles, statuses: Sequence[NodeStatus]
) -> list[NodeNumbers]:
    """Return a node's numbers at each sample of a block, with its status at each."""
    values, count = block.values, len(block)
    zones = [zone.temperature for zone in roles.zones if zone.temperature is not None]
    people = [zone.occupants for zone in roles.zones if zone.occupants is not None]
    has_band = block.deviations.shape[1] > 0
    nothing: list[None] = [None] * count
    air, outdoor = values[:, zones], roles.outdoor_temperature
    outside = (np.abs(block.deviations) > 0.05).sum(axis=1).tolist()
    limits = zip(*(limit.tolist() for limit in block.outer_limits()), strict=True) if has_band else nothing
    fuels = [fuel.fuel for fuel in roles.other_fuels]
    uses = zip(totals.fuels_kw.tolist(), totals.fuels_kwh.tolist(), strict=True)
    columns: dict[str, Iterable[Any]] = {
        "time": block.times.astype("M8[s]").tolist(),
        "outdoor_degc": _known(values[:, outdoor]) if outdoor is not None else nothing,
        "low_degc": _known(np.fmin.reduce(air, axis=1)) if zones else nothing,
        "high_degc": _known(np.fmax.reduce(air, axis=1)) if zones else nothing,
        "band_degc": limits,
        "zones": [len(zones)] * count,
        "zones_outside": outside if has_band else nothing,
        "people": values[:, people].sum(axis=1).tolist() if people else nothing,
        "facility_kw": _known(totals.facility_kw),
        "hvac_label": [roles.hvac_power.label if roles.hvac_power else "HVAC"] * count,
        "hvac_kw": _known(totals.hvac_kw),
        "facility_kwh": _known(totals.facility_kwh),
        "hvac_kwh": _known(totals.hvac_kwh),
        "peak_kw": _known(totals.peak_kw),
        "fuels": ([FuelUse(*use) for use in zip(fuels, kw, kwh, strict=True)] for kw, kwh in uses),
        "outside_kh": _known(totals.outside_kh) if has_band else nothing,
        "occupied_kh": _known(totals.occupied_kh) if has_band else nothing,
        "sources": (tuple(name for name in dict.fromkeys(row) if name) for row in block.sources.tolist()),
        "alarms": (status.alarms for status in statuses),
        "faults": (status.faults for status in statuses),
    }
    return [NodeNumbers(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)]


def _known(values: Floats) -> list[float | None]:
    """Return the values, None where they are unknown."""
    return [None if value != value else value for value in values.tolist()]


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
    cells = [("Simulated time", clock(numbers.time)), ("Outdoors", _if_known(numbers.outdoor_degc, "°C"))]
    if numbers.low_degc is not None and numbers.high_degc is not None:
        cells.append(("Zones", f"{numbers.low_degc:.1f} to {numbers.high_degc:.1f} °C"))
    if numbers.band_degc is not None:
        cells.append(("Comfort band", band_text(*numbers.band_degc, ".1f")))
    if numbers.zones_outside is not None:
        cells.append(("Outside comfort", f"{numbers.zones_outside} of {counted(numbers.zones, 'zone')}"))
    if numbers.people is not None:
        cells.append(("Occupants", quantity(numbers.people, _people(numbers.people), 0)))
    cells += [
        (numbers.hvac_label, _use(numbers.hvac_kw, numbers.hvac_kwh)),
        ("Electricity", _use(numbers.facility_kw, numbers.facility_kwh)),
        ("Electric peak", _if_known(numbers.peak_kw, "kW")),
        *((fuel.capitalize(), _use(kw, kwh)) for fuel, kw, kwh in numbers.fuels),
        ("Outside comfort, occupied", _if_known(numbers.occupied_kh, "K h")),
        ("all hours", _if_known(numbers.outside_kh, "K h")),
        ("Set by", _setters(numbers.sources)),
        ("Alarms", _listing(numbers.alarms)),
        ("Faults", _listing(numbers.faults)),
    ]
    cells = [(name, text) for name, text in cells if text]
    head, values = " | ".join([name for name, _ in cells]), "** | **".join([text for _, text in cells])
    return f"| {head} |\n|{'---|' * len(cells)}\n| **{values}** |"


def _if_known(value: float | None, unit: str) -> str:
    return "" if value is None else quantity(value, unit)


def _use(kw: float | None, kwh: float | None) -> str:
    """Return power and energy so far: `128.7 kW, 3,798 kWh`."""
    return "" if kw is None else f"{quantity(kw, 'kW')}, {quantity(kwh, 'kWh', 0)}"


def _setters(names: Sequence[str]) -> str:
    return _listing(names) if names else BASELINE


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
        "Set by", "Alarms", "Faults",
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
            _setters(numbers.sources),
            _listing(numbers.alarms),
            _listing(numbers.faults),
        )
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines)
