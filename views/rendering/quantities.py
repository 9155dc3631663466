"""The quantities of a node that a picture shows, and the panels that they belong to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import takewhile
from typing import Any

import numpy as np

from zenostat.agent_sdk.rewards import Reward
from zenostat.metrics.labels import label, point_unit, unit_label
from zenostat.metrics.reward_comfort import comfort, display_comfort
from zenostat.metrics.roles import PointRoles, roles
from zenostat.topics.arrays import Floats
from zenostat.topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT, THERMOSTAT
from zenostat.topics.messages import Action, Actuator, DiscreteAction, Manifest
from zenostat.topics.units import power_kw, quantity
from zenostat.views.display.colors import zone_color
from zenostat.views.rendering.artists import Dash
from zenostat.views.rendering.data import Window
from zenostat.views.rendering.panels import Curve, Panel, Spread, Values
from zenostat.views.rendering.scale import format_value
from zenostat.views.rendering.text import Color
from zenostat.views.rendering.zones import ZonePanel, column, rgb

PALETTE: tuple[Color, ...] = (
    (0.16, 0.36, 0.60), (0.85, 0.45, 0.10), (0.20, 0.55, 0.38), (0.60, 0.32, 0.62), (0.45, 0.45, 0.45),
    (0.72, 0.58, 0.05),
)  # fmt: skip
"""Colors of curves that belong to no zone; distinguishable with color vision deficiencies."""

_MOST_CURVES = 6
_MOST_TERMS = 4
_MOST_NOTES = 4
_MOST_POINT_PANELS = 3
_HEATING: Color = (0.72, 0.16, 0.16)
_COOLING: Color = (0.13, 0.33, 0.68)
_REWARD: Color = (0.10, 0.10, 0.12)
_OUTDOOR: Color = (0.35, 0.42, 0.52)
_PEOPLE: Color = (0.46, 0.42, 0.32)


class FrameQuantities:
    """Chooses what is shown of a node.

    Args:
        manifest: The node's manifest.
        reward: The reward, whose comfort band is shown; None if there is none.
    """

    def __init__(self, manifest: Manifest, reward: Reward | None) -> None:
        self._manifest, self._reward, self._roles = manifest, reward, roles(manifest)

    def panels(self, terms: Sequence[str]) -> list[Panel]:
        """Create the panels from top to bottom.

        Args:
            terms: Names of the reward's terms.
        """
        point_roles = self._roles
        zones = point_roles.zones
        bands = display_comfort(self._manifest, self._reward)
        has_band = comfort(self._manifest, self._reward) is not None
        panels: list[Panel] = [ZonePanel(zones, bands, has_band=has_band)] if bands is not None else []
        if point_roles.outdoor_temperature is not None:
            outdoor = Curve("Outdoor air", _OUTDOOR, column(point_roles.outdoor_temperature))
            panels.append(Panel("Outdoor temperature", "°C", [outdoor], weight=0.8, min_span=4.0))
        people = [zone.occupants for zone in point_roles.zones if zone.occupants is not None]
        if people:
            panels.append(self._people(people))
        panels += self._power(point_roles)
        if not zones:
            panels += self._points(point_roles, _MOST_POINT_PANELS)
        panels += self._actions()
        if self._reward is not None:
            panels.append(_reward_panel(terms))
        return panels

    def _people(self, people: Sequence[int]) -> Panel:
        indices = np.array(people, np.intp)

        def total(window: Window) -> Floats:
            return np.asarray(window.values[:, indices].sum(axis=1))

        curve = Curve("In all zones", _PEOPLE, total, held=True, width=1.0)
        return Panel("Occupancy", "people", [curve], weight=0.5, from_zero=True, is_filled=True, min_span=2.0)

    def _power(self, point_roles: PointRoles) -> list[Panel]:
        curves = [
            Curve(source.label, PALETTE[i], column(source.index, source.to_kw), held=True)
            for i, source in enumerate((point_roles.facility_power, point_roles.hvac_power))
            if source is not None
        ]
        if not curves:
            return []
        return [Panel("Electric power", "kW", curves, weight=1.3, from_zero=True, is_filled=True)]

    def _points(self, point_roles: PointRoles, most: int) -> list[Panel]:
        """Create panels of all points by unit, for a plant without zones."""
        groups: dict[str, list[tuple[str, Values]]] = {}
        for index in (index for indices in point_roles.others.values() for index in indices):
            point = self._manifest.points[index]
            if quantity(point.unit) in ("energy", "power"):
                unit, factor = "kW", power_kw(point.unit, self._manifest.step_s)
            else:
                unit, factor = point_unit(point), 1.0
            groups.setdefault(unit, []).append((point_roles.labels[index], column(index, factor)))
        panels = []
        for unit, members in [*groups.items()][:most]:
            curves = [Curve(text, PALETTE[i % len(PALETTE)], values) for i, (text, values) in enumerate(members)]
            title = members[0][0] if len(members) == 1 else {"°C": "Temperature", "kW": "Power"}.get(unit, "Points")
            panels += [_panel(title, unit, curves, {f"{len(members)} points": list(range(len(members)))}, weight=2.0)]
        return panels

    def _actions(self) -> list[Panel]:
        task = self._manifest.task
        if task.discrete_actions:
            return [self._choices(task.discrete_actions)]
        by_unit: dict[str, list[int]] = {}
        for index, action in enumerate(task.actions):
            by_unit.setdefault(unit_label(action.unit), []).append(index)
        if len(by_unit) > 2:
            return [self._scaled_actions(task.actions)]
        by_name = {actuator.name: actuator for actuator in self._manifest.actuators}
        panels = []
        for unit, members in by_unit.items():
            curves, groups = [], dict[str, list[int]]()
            for place, index in enumerate(members):
                action = task.actions[index]
                first = by_name[action.actuators[0]]
                curves.append(self._action_curve(index, action, first, place))
                groups.setdefault(first.control_type or unit, []).append(place)
            limits = tuple(x for i in members for x in (task.actions[i].low, task.actions[i].high) if x is not None)
            panels.append(_panel("Action", unit, curves, groups, weight=1.3, limits=limits))
        return panels

    def _choices(self, dimensions: Sequence[DiscreteAction]) -> Panel:
        """Create the panel of discrete actions: the index of the choice, and what it sets."""
        is_single = len(dimensions) == 1
        curves = [
            Curve(
                _common_label(discrete.actions), PALETTE[i % len(PALETTE)], _action(i), held=True,
                row=None if is_single else i, range=(0.0, len(discrete.values) - 1.0),
            )
            for i, discrete in enumerate(dimensions)
        ]  # fmt: skip
        groups = {f"{len(curves)} choices": list(range(len(curves)))}
        most = max(len(discrete.values) for discrete in dimensions) - 1
        title = f"Action: choice, 0 to {most}" if is_single else "Action: choices"
        panel = _panel(title, "", curves, groups, weight=1.2, limits=(0.0, float(most)))
        panel.is_integer = True
        if is_single and len(dimensions[0].actions) <= _MOST_NOTES:
            curves[0].label = "Choice"
            units = {action.name: unit_label(action.unit) for action in self._manifest.task.actions}
            panel.notes = [label(name) for name in dimensions[0].actions]
            panel.note_values = _choice_values(dimensions[0], [units[name] for name in dimensions[0].actions])
        return panel

    def _action_curve(self, index: int, action: Action, first: Actuator, place: int) -> Curve:
        """Create the curve of an action: in the color of its zone, or of heating or cooling."""
        dash: Dash = "--" if first.control_type == COOLING_SETPOINT else "-"
        color = PALETTE[place % len(PALETTE)]
        if first.component_type == THERMOSTAT:
            zones = {zone.key.casefold(): zone_color(zone.place) for zone in self._roles.zones}
            if len(action.actuators) == 1 and len(zones) > 1:
                color = rgb(zones.get(first.key.casefold(), (90, 90, 90)))
            else:
                color = {HEATING_SETPOINT: _HEATING, COOLING_SETPOINT: _COOLING}.get(first.control_type, color)
        return Curve(label(action.name), color, _action(index), held=True, dash=dash)

    def _scaled_actions(self, actions: Sequence[Action]) -> Panel:
        """Create one panel for actions of several units: a row for each or, of many, the share of their ranges."""
        curves = [
            Curve(
                label(action.name), PALETTE[i % len(PALETTE)], _action(i), held=True, row=i,
                range=_range(action), unit=unit_label(action.unit),
            )
            for i, action in enumerate(actions)
        ]  # fmt: skip
        if len(curves) <= _MOST_CURVES:
            return Panel("Action", "", curves, weight=1.5)
        shares = [Curve("", PALETTE[0], _share(curve), held=True) for curve in curves]
        groups = {f"{len(actions)} actions": list(range(len(actions)))}
        return _panel("Action, share of range", "%", shares, groups, weight=1.5, limits=(0.0, 100.0))


def _action(index: int) -> Values:
    return lambda window: window.actions[:, index]


def _common_label(names: Sequence[str]) -> str:
    """Return the words with which all names begin; without any, all names."""
    labels = [label(name) for name in names]
    shared = takewhile(lambda column: len(set(column)) == 1, zip(*(text.split() for text in labels), strict=False))
    return " ".join(column[0] for column in shared) or " + ".join(labels)


def _choice_values(discrete: DiscreteAction, units: Sequence[str]) -> Callable[[Window], Sequence[str]]:
    def values(window: Window) -> Sequence[str]:
        choice = window.actions[-1, 0]
        if np.isnan(choice):
            return [""] * len(units)
        row = discrete.values[int(choice)]
        return [f"{format_value(value, unit)} {unit}".strip() for value, unit in zip(row, units, strict=True)]

    return values


def _range(action: Action) -> tuple[float, float]:
    return (0.0 if action.low is None else action.low), (1.0 if action.high is None else action.high)


def _share(curve: Curve) -> Values:
    low, high = curve.range
    return lambda window: 100.0 * (curve.values(window) - low) / max(high - low, 1e-12)


def _panel(
    title: str, unit: str, curves: Sequence[Curve], groups: dict[str, list[int]], *, weight: float,
    limits: tuple[float, ...] = (),
) -> Panel:  # fmt: skip
    """Create a panel of curves, or, of too many, of the range of each group."""
    if len(curves) <= _MOST_CURVES:
        return Panel(title, unit, curves, weight=weight, includes=limits)
    spreads = []
    for place, (name, members) in enumerate(groups.items()):
        color = {HEATING_SETPOINT: _HEATING, COOLING_SETPOINT: _COOLING}.get(name, PALETTE[place % len(PALETTE)])
        text = name if name[:1].isdigit() else f"{len(members)} {name.lower()}s"
        chosen = [curves[member].values for member in members]
        spreads.append(Spread(text, color, _stack(chosen), held=curves[members[0]].held))
    return Panel(title, unit, (), spreads, weight=weight, includes=limits)


def _stack(columns: Sequence[Values]) -> Values:
    return lambda window: np.column_stack([values(window) for values in columns])


def _reward_panel(terms: Sequence[str]) -> Panel:
    named = list(terms) if len(terms) <= _MOST_TERMS else list(terms[: _MOST_TERMS - 1])
    curves = [Curve("Reward", _REWARD, lambda window: window.rewards, held=True, width=1.6)]
    curves += [
        Curve(f"{label(name)} term", PALETTE[i], _term([name]), held=True, width=1.2) for i, name in enumerate(named)
    ]
    if rest := list(terms[len(named) :]):
        curves.append(Curve(f"{len(rest)} other terms", PALETTE[len(named)], _term(rest), held=True, width=1.2))

    def total(window: Window) -> str:
        return f"sum {format_value(window.total, '')}"

    return Panel("Reward", "", curves, weight=1.2, from_zero=True, min_span=1e-6, total=total)


def _term(names: Sequence[str]) -> Callable[[Window], Any]:
    return lambda window: sum(window.terms[name] for name in names)
