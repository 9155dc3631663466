"""`zenostat buildings`: the buildings that can be named, and what they are."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import track

from cli.console import err
from cli.tables import show, show_json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from models.building.summary import BuildingSummary
    from models.catalog import Entry

COLUMNS = (
    "building",
    "floor\n(m²)",
    "conditioned\n(m²)",
    "zones",
    "conditioned\nzones",
    "EMS",
    "steps\n(1/h)",
    "fuels",
    "HVAC",
)


def buildings(
    building: Annotated[
        list[str] | None, typer.Argument(help="Short names, paths to an IDF or epJSON, or parts of names; all if none.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Lists buildings: floor area, conditioned part of it, HVAC, fuels, own EMS programs, timesteps an hour.

    Example: `zenostat buildings office-medium hospital`
    """
    from models import catalog

    entries = [catalog.find_building(name) for name in building] if building else list(catalog.buildings())
    facts = _facts(entries)
    if as_json:
        show_json([{"name": entry.name} | asdict(found) for entry, found in zip(entries, facts, strict=True)])
        return
    rows = [_cells(entry.name, found) for entry, found in zip(entries, facts, strict=True)]
    numbers = [name for name in COLUMNS if name not in ("building", "HVAC", "fuels")]
    title = f"{len(rows)} building" + ("s" if len(rows) > 1 else "")
    show(title, COLUMNS, rows, right=numbers, wrap=("building", "fuels", "HVAC"))


def _facts(entries: Sequence[Entry]) -> list[BuildingSummary]:
    """The facts of each, converted side by side where they must be: the work is in child processes."""
    from models.building.summary import listed_summaries

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = pool.map(listed_summaries, entries)
        bar = track(found, "reading models", len(entries), console=err, transient=True, disable=not err.is_terminal)
        return list(bar)


def _cells(name: str, facts: BuildingSummary) -> tuple[str, ...]:
    return (
        name,
        f"{facts.floor_area_m2:,.0f}",
        f"{facts.conditioned_area_m2:,.0f}",
        str(facts.zones),
        str(facts.conditioned_zones),
        str(facts.ems_programs),
        str(facts.steps_per_hour),
        ", ".join(facts.fuels),
        facts.hvac,
    )
