"""`zenostat points`: the sensors, meters, actuators and internal variables of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from cli.console import err, print_error
from cli.tables import show, show_json
from topics.errors import did_you_mean
from topics.units import unit_label

if TYPE_CHECKING:
    from models.building.model import Building
    from models.points.discovery import PointCatalog
    from models.points.selection import PointListing


class Kind(StrEnum):
    """Kinds of points."""

    SENSOR = "sensor"
    METER = "meter"
    ACTUATOR = "actuator"
    INTERNAL = "internal"


def points(
    building: Annotated[str, typer.Argument(help="Short name, IDF or epJSON file, or part of a name.")],
    kind: Annotated[Kind | None, typer.Option(help="Show only this kind.")] = None,
    match: Annotated[str, typer.Option(help="Show only points whose name, key or location contains this text.")] = "",
    default: Annotated[
        bool, typer.Option("--default", help="Show only the points that a node has by default.")
    ] = False,
    monitoring: Annotated[
        bool,
        typer.Option(
            "--monitoring", help="Show only the points for pictures and reports, of which agents observe none."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List a building's points with units, bounds and locations. The first call for a building takes seconds.

    Example: `zenostat points office-medium --kind actuator --match setpoint`
    """
    from models import catalog
    from models.building.model import read_building
    from models.points.discovery import discover
    from models.points.selection import listing

    with err.status(f"reading the points of {building} with EnergyPlus"):
        model = read_building(catalog.find_building(building))
        discovered = discover(model, catalog.weathers()[0].path)
    selected = _keys(model, discovered, default=default, monitoring=monitoring) if default or monitoring else None
    listed = [
        row
        for row in listing(discovered, model)
        if (kind is None or row.kind == kind)
        and (selected is None or (row.kind, row.name.casefold(), row.key.casefold()) in selected)
    ]
    rows = _matching(listed, match, f"no {kind or 'point'} of {model.name}")
    if as_json:
        show_json([asdict(row) for row in rows])
        return
    columns = ("kind", "name", "key (location)", "unit", "low", "high")
    show(
        f"{model.name}: {len(rows):,} points",
        columns,
        [_cells(row) for row in rows],
        right=("low", "high"),
        wrap=("name", "key (location)"),
    )


def _keys(
    building: Building, discovered: PointCatalog, *, default: bool, monitoring: bool
) -> set[tuple[str, str, str]]:
    """Return (kind, name, key), case-folded, of the points that a node has by default, or for monitoring."""
    from models.points.monitoring import monitoring_meters, monitoring_sensors
    from models.points.selection import default_actuators, default_meters, default_sensors

    keys: set[tuple[str, str, str]] = set()
    if default:
        keys |= {("sensor", *spec) for spec in default_sensors(discovered).values()}
        keys |= {("meter", name, "") for name in default_meters(discovered).values()}
        keys |= {("actuator", f"{a} / {b}", key) for a, b, key in default_actuators(discovered).values()}
    if monitoring:
        keys |= {("sensor", *spec) for spec in monitoring_sensors(building, discovered).values()}
        keys |= {("meter", name, "") for name in monitoring_meters(discovered).values()}
    return {(kind, name.casefold(), key.casefold()) for kind, name, key in keys}


def _matching(listed: Sequence[PointListing], match: str, prefix: str) -> list[PointListing]:
    """Return the rows that contain `match`; if there are none, print an error that starts with `prefix` and exit."""
    text = match.casefold()
    matching = [row for row in listed if any(text in part.casefold() for part in _parts(row))]
    if match and not matching:
        names = [part for row in listed for part in _parts(row) if part]
        print_error(f"{prefix} matches {match!r}; {did_you_mean(match, names)}")
        raise typer.Exit(1)
    return matching


def _parts(row: PointListing) -> tuple[str, ...]:
    return row.name, row.key, row.where


def _cells(row: PointListing) -> tuple[str, ...]:
    low, high = ("" if bound is None else f"{bound:g}" for bound in (row.low, row.high))
    is_named_by_key = not row.where or row.where.casefold() == row.key.casefold()
    place = row.key if is_named_by_key else f"{row.key} ({row.where})".lstrip()
    return row.kind, row.name, place, unit_label(row.unit), low, high
