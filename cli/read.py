"""`zenostat read`: the present values of a node's points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.options import DEFAULTS, BusOptions, Node, Slot, on_bus
from zenostat.cli.tables import AsJson, show, show_json
from zenostat.topics.keys import Role
from zenostat.topics.messages import Manifest, Meter, Sensor
from zenostat.topics.points import PointIndex
from zenostat.topics.units import unit_label

if TYPE_CHECKING:
    from zenostat.bridge.client.sample import SampleView


@dataclass(frozen=True, slots=True)
class Row:
    """One point at one sample.

    `value` is None where EnergyPlus does not report it. `value_source` names who set an actuator: empty for baseline
    control, None for sensors and meters.
    """

    kind: str
    name: str
    value: float | None
    unit: str
    low: float | None
    high: float | None
    value_source: str | None = None


@on_bus
def read(
    node: Node,
    points: Annotated[list[str] | None, typer.Argument(help="Names of points. Default: all.")] = None,
    slot: Slot = 0,
    options: BusOptions = DEFAULTS,
    as_json: AsJson = False,
) -> None:
    """Show the latest sample of a node: values with units, and each actuator's effective value and source.

    With keys, it uses the monitor role.

    Example: `zenostat read office core_zn_air_temperature core_zn_cooling_setpoint`
    """
    with options.open_bus(Role.MONITOR) as bus:
        sample = bus.read(node, slot=slot)
    check_points(sample.manifest, points or [])
    listed = rows(sample, points or [])
    if as_json:
        show_json({"node": node, **sample_id(sample), "points": [asdict(row) for row in listed]})
        return
    columns = ("kind", "name", "value", "unit", "low", "high", "value source")
    title = f"{node} at {sample.time}: sample {sample.step} of episode {sample.episode}"
    show(title, columns, [_cells(row) for row in listed], right=("value", "low", "high"), wrap=("name", "value source"))


def check_points(manifest: Manifest, names: Sequence[str]) -> None:
    """Check that the node has all named points.

    Raises:
        UnknownName: it lacks some; the text suggests similar names for each.
    """
    points = (*manifest.points, *manifest.actuators)
    PointIndex((point.name for point in points), "point").require(names)


def sample_id(sample: SampleView) -> dict[str, Any]:
    """Return episode, step and time of a sample, for JSON."""
    return {"episode": sample.episode, "step": sample.step, "time": sample.time.isoformat()}


def rows(sample: SampleView, names: Sequence[str]) -> list[Row]:
    """Return the named points of a sample, or all: sensors, meters, actuators, each in the manifest's order."""
    manifest, selected = sample.manifest, set(names)
    points: list[tuple[str, Sensor | Meter]] = [("sensor", sensor) for sensor in manifest.sensors]
    points += [("meter", meter) for meter in manifest.meters]
    listed = [
        Row(kind, point.name, number(value), point.unit, point.low, point.high)
        for (kind, point), value in zip(points, sample.values.tolist(), strict=True)
    ]
    sources, effective = sample.value_source, sample.effective.tolist()
    listed += [
        Row("actuator", a.name, number(value), a.unit, a.low, a.high, sources[a.name])
        for a, value in zip(manifest.actuators, effective, strict=True)
    ]
    return [row for row in listed if not selected or row.name in selected]


def number(value: float) -> float | None:
    """Replace NaN, which stands for a value that EnergyPlus does not report, by None."""
    return None if math.isnan(value) else value


def format_value(value: float | None) -> str:
    """Format a value with six significant digits; None as a dash."""
    return "-" if value is None else f"{value:.6g}"


def _cells(row: Row) -> tuple[str, ...]:
    low, high = ("" if bound is None else f"{bound:g}" for bound in (row.low, row.high))
    return row.kind, row.name, format_value(row.value), unit_label(row.unit), low, high, format_source(row)


def format_source(row: Row) -> str:
    """Format the value source; empty for sensors and meters."""
    return "" if row.value_source is None else row.value_source or "baseline control"
