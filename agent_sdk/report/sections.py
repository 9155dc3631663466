"""Sections of a report in their order, with the figures of each."""

from __future__ import annotations

from dataclasses import dataclass

from agent_sdk.evaluation.trace import WeatherTrace
from agent_sdk.report.figures import actuators, carpets, comfort, energy, reward, weather
from agent_sdk.report.figures.base import Figure
from agent_sdk.report.runs import Comparison
from agent_sdk.report.summary import worst_zones

_ZONES = 3


@dataclass(frozen=True)
class Section:
    """A heading and the figures below it."""

    anchor: str
    title: str
    figures: tuple[Figure, ...]


def sections(comparison: Comparison) -> list[Section]:
    """Return the sections with figures; those without any data are left out."""
    curves = comparison.curves
    zones = worst_zones(comparison, _ZONES)
    hours = [
        carpets.electricity(curves),
        *(carpets.zone(curves, label, number) for number, label in enumerate(zones, 1)),
    ]
    entries = [
        ("end-use", "Energy by end use", [energy.end_uses(curves)]),
        ("duration", "Load duration", [energy.duration(curves)]),
        ("hours", "Hour by hour", hours),
        ("control", "Set-points and actuators", [actuators.timeline(curves)]),
        ("periods", "Energy over time", [energy.periods(curves)]),
        ("comfort", "Comfort by zone", [comfort.degree_hours(curves)]),
        ("climate", "Weather", [weather.weather(_weathers(comparison), curves[0].quantities.begins[0])]),
        ("rewards", "Reward", [reward.reward(curves)]),
    ]
    kept = [
        (anchor, title, tuple(figure for figure in group if figure is not None)) for anchor, title, group in entries
    ]
    return [
        Section(anchor, group[0].title if len(group) == 1 else title, group) for anchor, title, group in kept if group
    ]


def _weathers(comparison: Comparison) -> list[tuple[str, WeatherTrace]]:
    """Return the weather of each episode; all controllers have the same."""
    reference = comparison.reference
    series = reference.weathers or (reference.quantities.weather,)
    first = reference.quantities.weather
    known = [first, *series[1:]]
    names = reference.weather_names
    labels = [
        f"episode {place + 1}" + (f", {names[place]}" if place < len(names) else "") for place in range(len(known))
    ]
    return [(label, trace) for label, trace in zip(labels, known, strict=True) if trace is not None]


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
        "reward": any(quantities.trace.terms for quantities in every),
    }
    return [name for name, is_measured in checks.items() if not is_measured]
