"""Sections of a report in their order, with the figures of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zenostat.metrics.episode_weather import EpisodeWeather
from zenostat.views.report.figures import actuators, carpets, comfort, energy, months, reward, weather
from zenostat.views.report.figures.base import Figure
from zenostat.views.report.runs import Comparison, Run
from zenostat.views.report.summary import worst_zones

_ZONES = 3


@dataclass(frozen=True)
class Section:
    """A heading and the figures below it."""

    anchor: str
    title: str
    figures: tuple[Figure, ...]

    @property
    def is_single(self) -> bool:
        """Whether it has one figure, under the section's own heading."""
        return len(self.figures) == 1 and self.figures[0].title == self.title


def sections(comparison: Comparison) -> tuple[Section, ...]:
    """Return the sections with figures, which are drawn once; those without any data are left out."""
    if "sections" not in comparison.derived:
        comparison.derived["sections"] = tuple(_draw(comparison))
    drawn: tuple[Section, ...] = comparison.derived["sections"]
    return drawn


def _draw(comparison: Comparison) -> list[Section]:
    curves = comparison.curves
    zones = worst_zones(comparison, _ZONES)
    hours = [
        carpets.electricity(curves),
        *(carpets.zone(curves, label, number) for number, label in enumerate(zones, 1)),
    ]
    entries: list[tuple[str, str, list[Figure | None]]] = [
        ("end-use", "", [energy.end_uses(curves)]),
        ("duration", "", [energy.duration(curves)]),
        ("hours", "Hour by hour", hours),
        ("control", "", [actuators.timeline(curves)]),
        ("periods", "", [energy.periods(curves)]),
        ("period-uses", "", [months.end_uses_by_period(curves)]),
        ("comfort", "", [comfort.degree_hours(curves)]),
        ("climate", "", [weather.weather(_weathers(comparison), _weather_begin(comparison.reference))]),
        ("rewards", "", [reward.reward(curves)]),
    ]
    kept = []
    for anchor, title, group in entries:
        figures = tuple(figure for figure in group if figure is not None)
        if figures:
            kept.append(Section(anchor, title or figures[0].title, figures))
    return kept


def _weathers(comparison: Comparison) -> list[tuple[str, EpisodeWeather]]:
    """Return the weather of each episode; all controllers have the same."""
    reference = comparison.reference
    series = reference.weathers or (reference.quantities.weather,)
    first = reference.quantities.weather
    known = [first, *series[1:]]
    names = reference.weather_names
    several = len(set(names)) > 1
    labels = [
        f"episode {place + 1}" + (f", {names[place]}" if several and place < len(names) else "")
        for place in range(len(known))
    ]
    return [(label, weather) for label, weather in zip(labels, known, strict=True) if weather is not None]


def _weather_begin(run: Run) -> np.datetime64:
    """Return when the weather of an episode begins; that of a weather file begins before a run that joins later."""
    begin: np.datetime64 = run.quantities.begins[0]
    if run.weathers and run.weathers[0] is not None:
        begin -= np.timedelta64(round(int(run.trajectory.step[0]) * run.trajectory.manifest.step_s), "s")
    return begin


def _has_kpi(comparison: Comparison, name: str) -> bool:
    return any(result.kpis.get(name) is not None for run in comparison.runs for result in run.results)


def not_measured(comparison: Comparison) -> list[str]:
    """Return what the scenario does not measure, by name."""
    every = [curve.quantities for curve in comparison.curves]
    checks = {
        "electricity": any("electricity" in quantities.energy_kwh for quantities in every),
        "electricity of the HVAC": any("hvac_electricity" in quantities.energy_kwh for quantities in every),
        "end uses": any(quantities.end_uses for quantities in every),
        "zone temperatures": any(quantities.comfort is not None for quantities in every),
        "occupants": any(zone.occupants is not None for quantities in every for zone in quantities.roles.zones),
        "weather": any(quantities.weather is not None for quantities in every),
        "reward": any(quantities.trajectory.terms for quantities in every),
        "cost (no price)": _has_kpi(comparison, "cost_tot"),
        "emissions (no factor)": _has_kpi(comparison, "emis_tot"),
    }
    return [name for name, is_measured in checks.items() if not is_measured]
