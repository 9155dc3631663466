"""`zenostat points`: the sensors, meters, actuators and internal variables of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import err, print_error
from zenostat.cli.tables import AsJson, show, show_json
from zenostat.topics.errors import did_you_mean
from zenostat.topics.plurals import counted
from zenostat.topics.units import unit_label

if TYPE_CHECKING:
    from zenostat.models.building.model import Building
    from zenostat.models.points.listing import PointListing


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
        bool, typer.Option("--default", help="Show the points that a node has by default, with their names on the bus.")
    ] = False,
    monitoring: Annotated[
        bool | None,
        typer.Option(
            help="Show only the default points for pictures and reports, of which agents observe none; with "
            "--default --no-monitoring, those of a node with that option."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List a building's points with units, bounds and locations. The first call for a building takes seconds.

    Example: `zenostat points office-medium --kind actuator --match setpoint`
    """
    from zenostat.models import catalog
    from zenostat.models.building.model import read_building
    from zenostat.models.points.discovery import discover
    from zenostat.models.points.listing import listing

    with err.status(f"reading the points of {building} with EnergyPlus"):
        model = read_building(catalog.find_building(building))
        discovered = discover(model, catalog.weathers()[0].path)
    of_run = default or bool(monitoring)
    rows = (
        points_of_run(building, model, default=default, monitoring=monitoring) if of_run else listing(discovered, model)
    )
    listed = [row for row in rows if kind is None or row.kind == kind]
    rows = _matching(listed, match, f"no {kind or 'point'} of {model.name}")
    if as_json:
        show_json([asdict(row) for row in rows])
        return
    columns = ("kind", *(("bus name",) if of_run else ()), "name", "key (location)", "unit", "low", "high")
    show(
        f"{model.name}: {counted(len(rows), 'point', ',')}",
        columns,
        [_cells(row, of_run=of_run) for row in rows],
        right=("low", "high"),
        wrap=("bus name", "name", "key (location)"),
    )


def points_of_run(name: str, building: Building, *, default: bool, monitoring: bool | None) -> list[PointListing]:
    """Return the points that a node of the building has by default, or those of them for pictures and reports."""
    from zenostat.eplus_node.config import read_config, scenario_of
    from zenostat.eplus_node.plan import run_points
    from zenostat.models import catalog
    from zenostat.models.points.discovery import discover
    from zenostat.models.points.listing import run_listing
    from zenostat.models.points.monitoring import monitoring_meters, monitoring_sensors

    weather = catalog.weathers()[0]
    scenario = scenario_of(read_config({"building": name, "weather": weather.name}))
    points = run_points(building, scenario, weather.path, monitoring=monitoring is not False)
    rows = [*run_listing(points, building)]
    if default:
        return rows
    discovered = discover(building, weather.path)
    shown = {(name.casefold(), key.casefold()) for name, key in monitoring_sensors(building, discovered).values()}
    shown |= {(meter.casefold(), "") for meter in monitoring_meters(discovered).values()}
    return [row for row in rows if (row.name.casefold(), row.key.casefold()) in shown]


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
    return row.bus_name, row.name, row.key, row.where


def _cells(row: PointListing, *, of_run: bool) -> tuple[str, ...]:
    low, high = ("" if bound is None else f"{bound:g}" for bound in (row.low, row.high))
    is_named_by_key = not row.where or row.where.casefold() == row.key.casefold()
    place = row.key if is_named_by_key else f"{row.key} ({row.where})".lstrip()
    names = (row.bus_name, row.name) if of_run else (row.name,)
    return row.kind, *names, place, unit_label(row.unit), low, high
