"""`zenostat points`: what EnergyPlus offers for a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from cli.console import err, say_error
from cli.tables import show, show_json
from topics.errors import did_you_mean

if TYPE_CHECKING:
    from models.points.discovery import PointCatalog
    from models.points.selection import PointListing


class Kind(StrEnum):
    """Kinds of points."""

    SENSOR = "sensor"
    METER = "meter"
    ACTUATOR = "actuator"
    INTERNAL = "internal"


def points(
    building: Annotated[str, typer.Argument(help="Short name, path to an IDF or epJSON, or part of a name.")],
    kind: Annotated[Kind | None, typer.Option(help="Only this kind.")] = None,
    match: Annotated[str, typer.Option(help="Only names, keys or places that contain this text.")] = "",
    default: Annotated[bool, typer.Option("--default", help="Only those that a node has if none are named.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Lists a building's points with their units, bounds and places. The first time takes seconds.

    Example: `zenostat points office-medium --kind actuator --match setpoint`
    """
    from models import catalog
    from models.building.model import read_building
    from models.points.discovery import discover
    from models.points.selection import listing

    with err.status(f"asking EnergyPlus about {building}"):
        model = read_building(catalog.find_building(building))
        found = discover(model, catalog.weathers()[0].path)
    wanted = _default(found) if default else None
    listed = [
        row
        for row in listing(found, model)
        if (kind is None or row.kind == kind)
        and (wanted is None or (row.kind, row.name.casefold(), row.key.casefold()) in wanted)
    ]
    rows = _matching(listed, match, f"no {kind or 'point'} of {model.name}")
    if as_json:
        show_json([asdict(row) for row in rows])
        return
    columns = ("kind", "name", "key", "where", "unit", "low", "high")
    show(
        f"{model.name}: {len(rows):,} points",
        columns,
        [_cells(row) for row in rows],
        right=("low", "high"),
        wrap=("name", "key", "where"),
    )


def _default(found: PointCatalog) -> set[tuple[str, str, str]]:
    """(kind, name, key), folded, of the points that a node has if none are named."""
    from models.points.selection import default_actuators, default_meters, default_sensors

    wanted = {("sensor", *spec) for spec in default_sensors(found).values()}
    wanted |= {("meter", name, "") for name in default_meters(found).values()}
    wanted |= {("actuator", f"{a} / {b}", key) for a, b, key in default_actuators(found).values()}
    return {(kind, name.casefold(), key.casefold()) for kind, name, key in wanted}


def _matching(listed: Sequence[PointListing], match: str, nothing: str) -> list[PointListing]:
    """The rows that contain a text; where there are none, an error that begins with `nothing`, and the end."""
    text = match.casefold()
    found = [row for row in listed if any(text in part.casefold() for part in _parts(row))]
    if match and not found:
        names = [part for row in listed for part in _parts(row) if part]
        say_error(f"{nothing} matches {match!r}; {did_you_mean(match, names)}")
        raise typer.Exit(1)
    return found


def _parts(row: PointListing) -> tuple[str, ...]:
    """What `--match` looks at."""
    return row.name, row.key, row.where


def _cells(row: PointListing) -> tuple[str, ...]:
    low, high = ("" if bound is None else f"{bound:g}" for bound in (row.low, row.high))
    return row.kind, row.name, row.key, row.where, row.unit, low, high
