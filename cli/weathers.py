"""`zenostat weathers`: the weather files that can be named, and what they are."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from cli.tables import show, show_json

if TYPE_CHECKING:
    from models.weather.summary import WeatherSummary

COLUMNS = (
    "weather",
    "place",
    "latitude\n(°)",
    "longitude\n(°)",
    "elevation\n(m)",
    "climate\nzone",
    "mean\n(°C)",
    "humidity\n(%)",
    "days",
    "years",
)


def weathers(
    weather: Annotated[
        list[str] | None, typer.Argument(help="Short names, paths to an EPW, or parts of names; all if none.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Lists weather files with their place, climate zone (ASHRAE 169), means and the days that they cover.

    Example: `zenostat weathers USA_CO_Denver USA_FL_Miami`
    """
    from models import catalog
    from models.weather.summary import weather_summary

    entries = [catalog.find_weather(name) for name in weather] if weather else list(catalog.weathers())
    facts = [weather_summary(entry.path) for entry in entries]
    if as_json:
        show_json([{"name": entry.name} | asdict(found) for entry, found in zip(entries, facts, strict=True)])
        return
    rows = [_cells(entry.name, found) for entry, found in zip(entries, facts, strict=True)]
    numbers = [name for name in COLUMNS if name not in ("weather", "place", "climate\nzone", "days", "years")]
    show(
        f"{len(rows)} weather file" + ("s" if len(rows) > 1 else ""),
        COLUMNS,
        rows,
        right=numbers,
        wrap=("weather", "place", "years", "days"),
    )


def _cells(name: str, facts: WeatherSummary) -> tuple[str, ...]:
    first, last = (f"{month:02}-{day:02}" for month, day in (facts.first, facts.last))
    return (
        name,
        facts.place,
        f"{facts.latitude_deg:.2f}",
        f"{facts.longitude_deg:.2f}",
        f"{facts.elevation_m:.0f}",
        facts.climate_zone,
        f"{facts.mean_temperature_degC:.1f}",
        f"{facts.mean_humidity_pct:.0f}",
        f"{first} to {last}",
        facts.years,
    )
