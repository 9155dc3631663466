"""The panel of zone temperatures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from typing_extensions import override

from zenostat.metrics.comfort import Comfort
from zenostat.metrics.roles import ZoneRoles
from zenostat.topics.arrays import Floats
from zenostat.views.display.colors import zone_color
from zenostat.views.rendering import artists
from zenostat.views.rendering.data import Window, finite
from zenostat.views.rendering.panels import Curve, Panel, Row, Spread, Values
from zenostat.views.rendering.scale import format_range, format_value
from zenostat.views.rendering.text import Color

_MOST_ZONES, _MOST_SETPOINTS = 5, 3
_BAND: Color = (0.30, 0.66, 0.42)
_SETPOINT: Color = (0.33, 0.35, 0.38)
_SPREAD: Color = (0.42, 0.47, 0.55)
_OCCUPIED: Color = (0.80, 0.74, 0.58)
_UNIT = "°C"
_PLAUSIBLE_DEGC = (10.0, 40.0)
"""Setpoints outside this range switch heating or cooling off; the axis does not extend to them."""


def column(index: int, factor: float = 1.0) -> Values:
    """Return a function that takes a point from the samples, times `factor`."""
    return lambda window: window.values[:, index] * factor


def rgb(color: Sequence[int]) -> Color:
    """Convert a color from 0..255 to 0..1."""
    red, green, blue = (part / 255.0 for part in color)
    return red, green, blue


class ZonePanel(Panel):
    """Temperatures of the zones, with comfort band, setpoints and occupied hours.

    Up to five zones have a curve each. Of more, the range and the median are shown, and the zone that was farthest
    outside its comfort band.

    Args:
        zones: The zones, all of which have a temperature.
        comfort: Their comfort bands, in the same order.
        has_band: Whether the bands are those of a reward, not a default.
    """

    def __init__(self, zones: Sequence[ZoneRoles], comfort: Comfort, *, has_band: bool) -> None:
        self._has_band = has_band
        self._zones, self._has_many = zones, len(zones) > _MOST_ZONES
        self._air = np.array([zone.temperature for zone in zones], np.intp)
        self._comfort = comfort
        self._people = np.array([zone.occupants for zone in zones if zone.occupants is not None], np.intp)
        self._setpoints = [
            [_setpoint(zone.heating_setpoint, zone.heating_actuator) for zone in zones],
            [_setpoint(zone.cooling_setpoint, zone.cooling_actuator) for zone in zones],
        ]
        self._has_setpoints = any(values is not None for kind in self._setpoints for values in kind)
        shown = zones[:1] if self._has_many else zones
        curves = [
            Curve(zone.label, rgb(zone_color(zone.place)), column(zone.temperature or 0), width=1.6) for zone in shown
        ]
        spread = Spread(f"{len(zones)} zones, with median", _SPREAD, lambda window: window.values[:, self._air])
        super().__init__(
            "Zone temperature", _UNIT, curves, [spread] if self._has_many else [], weight=3.2, min_span=4.0
        )

    @property
    @override
    def row_count(self) -> int:
        return super().row_count + self._has_setpoints + 1 + bool(self._people.size)

    @override
    def attach(self, figure: Any, top: float, height: float) -> None:
        super().attach(figure, top, height)
        axes = self.axes
        self._setpoint_lines = [
            [artists.line(axes, _SETPOINT, "--", 1.0, rank=-10, alpha=0.75) for _ in self.curves] for _ in range(2)
        ]
        self._setpoint_row = (
            self.add_row("Setpoints", color=_SETPOINT, dash="--", width=1.0)[0] if self._has_setpoints else Row("")
        )
        self._band = artists.area(axes, _BAND, 0.17)
        self._band_row, _ = self.add_row("Comfort band", area=_BAND)
        self._occupied = artists.stripes(axes, _OCCUPIED, 0.28)
        if self._people.size:
            self.add_row("Occupied", area=_OCCUPIED, alpha=0.45)

    @override
    def update(self, window: Window) -> None:
        low, high = (
            finite(limits, len(self._zones)) for limits in self._comfort.limits_of_samples(window.values, window.begins)
        )
        worst = self._worst_zone(window, low, high)
        if self._has_many:
            self._show_zone(worst)
        setpoints = self._draw_setpoints(window, worst)
        is_common = all(
            np.array_equal(limits, limits[:, [worst] * limits.shape[1]], equal_nan=True) for limits in (low, high)
        )
        bottom, top = low[:, worst], high[:, worst]
        self._band.set_xy(artists.outline(window.hours, bottom, top, held=True))
        of_zone = "" if is_common else f", {self._zones[worst].label}"
        self._band_row.label = ("Comfort band" if self._has_band else "Comfort band (default)") + of_zone
        self._band_row.value = format_range(bottom[-1], top[-1], _UNIT)
        if self._people.size:
            people = window.values[:, self._people].sum(axis=1)
            self._occupied.set_verts(artists.stripe_corners(window.hours, people > 0.0))
        self.includes = tuple(np.concatenate([bottom, top, *setpoints]).tolist())
        super().update(window)

    def _worst_zone(self, window: Window, low: Floats, high: Floats) -> int:
        """Return the zone with the most degree-hours outside its band; without any, the one nearest to its limits."""
        outside = np.fmax(low - window.values[:, self._air], window.values[:, self._air] - high)
        outside = np.nan_to_num(outside, nan=-1e9)
        total = np.maximum(outside, 0.0).sum(axis=0)
        return int(total.argmax()) if total.max() > 0.0 else int(outside.max(axis=0).argmax())

    def _show_zone(self, index: int) -> None:
        """Show this zone as the worst one."""
        zone, curve = self._zones[index], self.curves[0]
        curve.values = column(zone.temperature or 0)
        self._curve_rows[0].label = f"Worst: {zone.label}"
        for artist in (self._lines[0], self._dots[0], self._swatches[0]):
            artist.set_color(rgb(zone_color(zone.place)))

    def _draw_setpoints(self, window: Window, worst: int) -> list[Floats]:
        """Draw the setpoints of all zones if there are a few different ones, else of one zone.

        Returns:
            The setpoints that the axis includes.
        """
        included, latest = [], []
        zones = [worst] if self._has_many else list(range(len(self._zones)))
        values = [[getter(window) if getter else None for getter in kind] for kind in self._setpoints]
        if not all(_is_common([kind[zone] for zone in zones]) for kind in values) and len(zones) > _MOST_SETPOINTS:
            zones = [worst]
        is_common = all(_is_common([kind[zone] for zone in zones]) for kind in values)
        shown = zones[:1] if is_common else zones
        for kind, lines in zip(values, self._setpoint_lines, strict=True):
            for zone, line in zip_longest(shown, lines):
                setpoints = None if zone is None else kind[zone]
                line.set_data(*((), ()) if setpoints is None else artists.corners(window.hours, setpoints, held=True))
                if zone is None or setpoints is None:
                    continue
                line.set_color(_SETPOINT if is_common and len(zones) > 1 else rgb(zone_color(self._zones[zone].place)))
                is_on = (setpoints >= _PLAUSIBLE_DEGC[0]) & (setpoints <= _PLAUSIBLE_DEGC[1])
                included.append(setpoints[is_on])
                latest += [format_value(setpoints[-1], _UNIT)] if is_on[-1] else []
        of_one = len(shown) == 1 and not (is_common and len(zones) == len(self._zones))
        text = "Its setpoints" if self._has_many else f"Setpoints, {self._zones[shown[0]].label}"
        self._setpoint_row.label = text if of_one else "Setpoints"
        self._setpoint_row.value = " to ".join(latest) if len(shown) == 1 else ""
        return included


def _is_common(columns: Sequence[Floats | None]) -> bool:
    """Return whether all zones have the same setpoints, or none."""
    first = columns[0]
    return all(
        column is first is None
        or (column is not None and first is not None and np.array_equal(column, first, equal_nan=True))
        for column in columns
    )


def _setpoint(sensor: int | None, actuator: int | None) -> Values | None:
    if sensor is not None:
        return column(sensor)
    return None if actuator is None else lambda window: window.effective[:, actuator]
