"""`zenostat weathers`: a table of the available weather files."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.tables import AsJson, show, show_json
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    from zenostat.models.weather.summary import WeatherSummary

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
        list[str] | None, typer.Argument(help="Short names, EPW files, or parts of names. Default: all.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List weather files with location, climate zone (ASHRAE 169), mean temperature and humidity, and days covered.

    Example: `zenostat weathers USA_CO_Denver USA_FL_Miami`
    """
    from zenostat.models import catalog
    from zenostat.models.weather.summary import weather_summary

    entries = [catalog.find_weather(name) for name in weather] if weather else list(catalog.weathers())
    summaries = [weather_summary(entry.path) for entry in entries]
    if as_json:
        show_json([{"name": entry.name} | asdict(summary) for entry, summary in zip(entries, summaries, strict=True)])
        return
    rows = [_cells(entry.name, summary) for entry, summary in zip(entries, summaries, strict=True)]
    numbers = [name for name in COLUMNS if name not in ("weather", "place", "climate\nzone", "days", "years")]
    show(counted(len(rows), "weather file"), COLUMNS, rows, right=numbers, wrap=("weather", "place", "years", "days"))


def _cells(name: str, summary: WeatherSummary) -> tuple[str, ...]:
    first, last = (f"{month:02}-{day:02}" for month, day in (summary.first, summary.last))
    return (
        name,
        summary.place,
        f"{summary.latitude_deg:.2f}",
        f"{summary.longitude_deg:.2f}",
        f"{summary.elevation_m:.0f}",
        summary.climate_zone,
        f"{summary.mean_temperature_degC:.1f}",
        f"{summary.mean_humidity_pct:.0f}",
        f"{first} to {last}",
        summary.years,
    )
