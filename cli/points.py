"""`zenostat points`: what EnergyPlus offers for a model."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from typing import Annotated

import typer
from rich.table import Table

from cli.console import err, out


class Kind(StrEnum):
    """Kinds of points."""

    SENSOR = "sensor"
    METER = "meter"
    ACTUATOR = "actuator"


def points(
    building: Annotated[str, typer.Argument(help="Short name, path to an IDF or epJSON, or part of a name.")],
    kind: Annotated[Kind | None, typer.Option(help="Only this kind.")] = None,
    match: Annotated[str, typer.Option(help="Only names or keys that contain this text.")] = "",
    default: Annotated[bool, typer.Option("--default", help="Only those that a node has if none are named.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Lists a building's sensors, meters and actuators with their units. The first time takes seconds.

    Example: `zenostat points office-medium --kind actuator --match setpoint`
    """
    from models import catalog
    from models.building import read_building
    from models.points import default_actuators, default_meters, default_sensors, listing
    from models.survey import survey

    with err.status(f"asking EnergyPlus about {building}"):
        model = read_building(catalog.find_building(building))
        found = survey(model, catalog.weathers()[0].path)
    rows = [row for row in listing(found) if kind is None or row[0] == kind]
    if default:
        wanted = {("sensor", *spec) for spec in default_sensors(found).values()}
        wanted |= {("meter", name, "") for name in default_meters(found).values()}
        wanted |= {("actuator", f"{a} / {b}", key) for a, b, key in default_actuators(found).values()}
        folded = {(k, n.casefold(), key.casefold()) for k, n, key in wanted}
        rows = [row for row in rows if (row[0], row[1].casefold(), row[2].casefold()) in folded]
    text = match.casefold()
    rows = [row for row in rows if text in row[1].casefold() or text in row[2].casefold()]
    if as_json:
        fields = ("kind", "name", "key", "unit")
        json.dump([dict(zip(fields, row, strict=True)) for row in rows], sys.stdout, indent=1)
        sys.stdout.write("\n")
        return
    table = Table("kind", "name", "key", "unit", title=f"{model.name}: {len(rows)} points")
    for row in rows:
        table.add_row(*row)
    out.print(table)
