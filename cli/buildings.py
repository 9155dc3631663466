"""`zenostat buildings`: a table of the available buildings."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import track

from zenostat.cli.console import err
from zenostat.cli.tables import AsJson, show, show_json
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zenostat.models.building.summary import BuildingSummary
    from zenostat.models.catalog import Entry

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
        list[str] | None, typer.Argument(help="Short names, IDF or epJSON files, or parts of names. Default: all.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List buildings with floor area, conditioned area, zones, HVAC, fuels, EMS programs and timesteps per hour.

    Example: `zenostat buildings office-medium hospital`
    """
    from zenostat.models import catalog

    entries = [catalog.find_building(name) for name in building] if building else list(catalog.buildings())
    summaries = _summaries(entries)
    if as_json:
        show_json([{"name": entry.name} | asdict(summary) for entry, summary in zip(entries, summaries, strict=True)])
        return
    rows = [_cells(entry.name, summary) for entry, summary in zip(entries, summaries, strict=True)]
    numbers = [name for name in COLUMNS if name not in ("building", "HVAC", "fuels")]
    title = counted(len(rows), "building")
    show(title, COLUMNS, rows, right=numbers, wrap=("building", "fuels", "HVAC"))


def _summaries(entries: Sequence[Entry]) -> list[BuildingSummary]:
    """Summarize all buildings in parallel; threads suffice, since conversions run in child processes."""
    from zenostat.models.building.summary import listed_summaries

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        summaries = pool.map(listed_summaries, entries)
        bar = track(summaries, "reading models", len(entries), console=err, transient=True, disable=not err.is_terminal)
        return list(bar)


def _cells(name: str, summary: BuildingSummary) -> tuple[str, ...]:
    return (
        name,
        f"{summary.floor_area_m2:,.0f}",
        f"{summary.conditioned_area_m2:,.0f}",
        str(summary.zones),
        str(summary.conditioned_zones),
        str(summary.ems_programs),
        str(summary.steps_per_hour),
        ", ".join(summary.fuels),
        summary.hvac,
    )
