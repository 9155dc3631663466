"""`zenostat read`: what a running node's points are now."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bridge.transport.session import default_endpoint
from cli.options import CertificateName, Connect, Keys
from cli.tables import show, show_json
from topics.errors import UnknownName, did_you_mean
from topics.keys import Role
from topics.messages import Manifest, Meter, Sensor

if TYPE_CHECKING:
    from agent_sdk.bus.sample import SampleView


@dataclass(frozen=True, slots=True)
class Row:
    """One point at one sample; `value` is None where EnergyPlus does not tell.

    `value_source` is who set an actuator, empty for the building's own control; None for what is no actuator.
    """

    kind: str
    name: str
    value: float | None
    unit: str
    low: float | None
    high: float | None
    value_source: str | None = None


def read(
    node: Annotated[str, typer.Argument(help="The node's name.")],
    points: Annotated[list[str] | None, typer.Argument(help="Names of points; all if left out.")] = None,
    slot: Annotated[int, typer.Option(min=0, help="Which engine of a node that has several.")] = 0,
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Shows the latest sample of a node: values with units, what each actuator really was and who set it.

    With keys, as a monitor.

    Example: `zenostat read office core_zn_air_temperature core_zn_cooling_setpoint`
    """
    from agent_sdk import connect as connect_bus

    connect = connect or default_endpoint(keys)
    with connect_bus(connect, keys=keys, role=Role.MONITOR, certificate=certificate) as bus:
        sample = bus.read(node, slot=slot)
    check_points(sample.manifest, points or [])
    found = rows(sample, points or [])
    if as_json:
        show_json({"node": node, **where(sample), "points": [asdict(row) for row in found]})
        return
    columns = ("kind", "name", "value", "unit", "low", "high", "ruled by")
    title = f"{node} at {sample.time}: sample {sample.step} of episode {sample.episode}"
    show(
        title,
        columns,
        [_cells(row) for row in found],
        right=("value", "low", "high"),
        wrap=("name", "ruled by"),
    )


def check_points(manifest: Manifest, names: Sequence[str]) -> None:
    """Raises `UnknownName` for all names that the node does not have, with near ones."""
    known = [*manifest.names, *(a.name for a in manifest.actuators)]
    unknown = [f"node {manifest.node!r} has no point {n!r}; {did_you_mean(n, known)}" for n in names if n not in known]
    if unknown:
        raise UnknownName("\n".join(unknown))


def where(sample: SampleView) -> dict[str, Any]:
    """Which sample it is, for JSON."""
    return {"episode": sample.episode, "step": sample.step, "time": sample.time.isoformat()}


def rows(sample: SampleView, names: Sequence[str]) -> list[Row]:
    """The named points of a sample, or all: sensors, meters, actuators, each in the manifest's order."""
    manifest, wanted = sample.manifest, set(names)
    points: list[tuple[str, Sensor | Meter]] = [("sensor", sensor) for sensor in manifest.sensors]
    points += [("meter", meter) for meter in manifest.meters]
    found = [
        Row(kind, point.name, number(value), point.unit, point.low, point.high)
        for (kind, point), value in zip(points, sample.values.tolist(), strict=True)
    ]
    sources, effective = sample.value_source, sample.effective.tolist()
    found += [
        Row("actuator", a.name, number(value), a.unit, a.low, a.high, sources[a.name])
        for a, value in zip(manifest.actuators, effective, strict=True)
    ]
    return [row for row in found if not wanted or row.name in wanted]


def number(value: float) -> float | None:
    """None for NaN: EnergyPlus does not tell."""
    return None if math.isnan(value) else value


def shown(value: float | None) -> str:
    """A value for people: six figures; a dash where there is none."""
    return "-" if value is None else f"{value:.6g}"


def _cells(row: Row) -> tuple[str, ...]:
    low, high = ("" if bound is None else f"{bound:g}" for bound in (row.low, row.high))
    source_index = "" if row.value_source is None else row.value_source or "the building"
    return row.kind, row.name, shown(row.value), row.unit, low, high, source_index
