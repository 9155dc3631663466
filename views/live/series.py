"""Line plots: which points a node's plots show, and their columns in the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.components import AggregationPolicy, InterpolationMode

from zenostat.metrics.labels import label, point_unit, unit_label
from zenostat.metrics.roles import EndUse, PointRoles, PowerSource
from zenostat.topics.arrays import Floats
from zenostat.topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT
from zenostat.topics.messages import Actuator, Manifest
from zenostat.views.display.colors import OUTDOOR, RGB, end_use_color, zone_color
from zenostat.views.live.samples import SampleBlock
from zenostat.views.live.totals import TotalRows

COLDEST: RGB = (45, 125, 235)
MEDIAN: RGB = (132, 132, 128)
WARMEST: RGB = (235, 95, 25)
BAND: RGB = (60, 150, 60)
ZONE: RGB = MEDIAN
HEATING: RGB = (225, 100, 85)
COOLING: RGB = (30, 135, 245)
FACILITY: RGB = (128, 128, 128)
HVAC: RGB = (185, 90, 205)

TEMPERATURES = "temperatures"
TEMPERATURE_RANGE = "temperature_range"
BAND_PATH = "thermal_comfort_band"  # drawn last, since entities are drawn in alphabetical order
OUTDOORS = "outdoors"
HEATING_SETPOINTS = "heating_setpoints"
COOLING_SETPOINTS = "cooling_setpoints"
HUMIDITY = "humidity"
OCCUPANTS = "occupants"
POWER = "power"
END_USES = "end_uses"
ENERGY = "energy"
REWARD = "reward"
ACTUATORS = "actuators"
COMMANDS = "commands"
OTHERS = "points"

MAX_SMOOTH_ROWS = 2000

Compute = Callable[[SampleBlock, TotalRows], Floats]


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of a plot with one unit, which are one vector of scalars for each sample.

    Attributes:
        path: entity below the episode's.
        title: title of the plot, with the unit.
        names, colors: of the lines, shape (lines,).
        widths: of the lines in points; 1.5 for all if empty.
        is_step: whether a value holds for the whole timestep that ends with its sample.
    """

    path: str
    title: str
    names: Sequence[str]
    colors: Sequence[RGB]
    widths: Sequence[float] = ()
    is_step: bool = False

    def style(self) -> rr.SeriesLines:
        """Return the static style of the lines."""
        return rr.SeriesLines(
            names=list(self.names),
            colors=[list(color) for color in self.colors],
            widths=list(self.widths) or [1.5] * len(self.names),
            # Peaks stay visible where many samples share a pixel.
            aggregation_policy=AggregationPolicy.MinMax,
            interpolation_mode=InterpolationMode.StepBefore if self.is_step else InterpolationMode.Linear,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Series(Lines):
    """Lines that are computed from blocks of samples.

    Attributes:
        compute: returns the lines' values, shape (n, lines).
        is_sparse: whether samples between two that are equal are left out; the lines are the same.
        is_smooth: whether `MAX_SMOOTH_ROWS` of an episode's samples are enough to draw it.
    """

    compute: Compute
    is_sparse: bool = False
    is_smooth: bool = False

    def rows(self, steps: NDArray[np.int64], table: Floats, episode_steps: int) -> NDArray[np.intp]:
        """Return the rows to log of values at these steps of an episode.

        The timestep that sample 0 closes belongs to the warmup: what holds for a timestep begins with sample 1.
        """
        if self.is_step and len(steps) and steps[0] == 0:
            return self.rows(steps[1:], table[1:], episode_steps) + 1
        if self.is_sparse:
            return significant_rows(table)
        if self.is_smooth:
            stride = -(-episode_steps // MAX_SMOOTH_ROWS) or 1
            return np.flatnonzero((steps % stride == 0) | (steps == episode_steps))
        return np.arange(len(steps))


def significant_rows(table: Floats) -> NDArray[np.intp]:
    """Return the indices of the rows that a line needs: the first, the last, and those unlike a neighbor."""
    if len(table) < 3:
        return np.arange(len(table))
    changes = ((table[1:] != table[:-1]) & ~(np.isnan(table[1:]) & np.isnan(table[:-1]))).any(axis=1)
    is_needed = np.ones(len(table), bool)
    is_needed[1:-1] = changes[:-1] | changes[1:]
    return np.flatnonzero(is_needed)


def temperature_range(table: Floats) -> Floats:
    """Return the lowest, the median and the highest value of each row, shape (n, 3); NaN where all are unknown."""
    known = ~np.isnan(table).all(axis=1)
    result = np.full((len(table), 3), np.nan)
    rows = table[known]
    if rows.size:
        result[known] = np.stack([np.nanmin(rows, 1), np.nanmedian(rows, 1), np.nanmax(rows, 1)], axis=1)
    return result


def band_rows(block: SampleBlock) -> Floats:
    """Return the comfort band of the building, shape (n, 4): limits while occupied, then limits at all times.

    Where zones have different bands, it is the band from the lowest to the highest limit. The first two columns are NaN
    while no zone is occupied.
    """
    low, high = block.outer_limits()
    is_occupied = block.is_occupied.any(axis=1)
    return np.stack([np.where(is_occupied, low, np.nan), np.where(is_occupied, high, np.nan), low, high], axis=1)


def all_series(manifest: Manifest, roles: PointRoles, *, has_comfort: bool) -> list[Series]:
    """Return the line plots of a node, without the reward."""
    return [
        *_zone_series(roles, has_comfort=has_comfort),
        *_power_series(roles),
        *_other_series(manifest, roles),
        *_actuator_series(manifest, roles),
    ]


def reward_lines(terms: Sequence[str]) -> Lines:
    """Return the plot of reward terms."""
    return Lines(REWARD, "Reward terms", [label(term) for term in terms], list(map(zone_color, range(len(terms)))))


def vectors(table: Floats) -> rr.ComponentColumnList:
    """Return the rows of a table, shape (n, lines), as one vector of scalars each."""
    return rr.Scalars.columns(scalars=table.ravel()).partition([table.shape[1]] * len(table))


def _of_points(indices: Iterable[int]) -> Compute:
    columns = np.array([*indices], np.intp)
    return lambda block, _: block.values[:, columns]


def _effective(indices: Sequence[int]) -> Compute:
    columns = np.array(indices, np.intp)
    return lambda block, _: block.effective[:, columns]


def _commanded(indices: Sequence[int]) -> Compute:
    columns = np.array(indices, np.intp)
    return lambda block, _: block.commanded[:, columns]


def _zone_series(roles: PointRoles, *, has_comfort: bool) -> list[Series]:
    plots = []
    for path, title, role in (
        (TEMPERATURES, "All zones (°C)", "temperature"),
        (HEATING_SETPOINTS, "Heating setpoints (°C)", "heating_setpoint"),
        (COOLING_SETPOINTS, "Cooling setpoints (°C)", "cooling_setpoint"),
        (HUMIDITY, "Humidity (%)", "humidity"),
        (OCCUPANTS, "Occupants (people)", "occupants"),
    ):
        zones = [zone for zone in roles.zones if getattr(zone, role) is not None]
        if not zones:
            continue
        indices, is_step = [getattr(zone, role) for zone in zones], path not in (TEMPERATURES, HUMIDITY)
        names, colors = [zone.label for zone in zones], [zone_color(zone.place) for zone in zones]
        text = title.replace("All zones", zones[0].label) if len(zones) == 1 else title
        plots.append(Series(path, text, names, colors, compute=_of_points(indices), is_step=is_step, is_sparse=is_step))
    air = np.array([zone.temperature for zone in roles.zones if zone.temperature is not None], np.intp)
    if len(air) > 1:
        plots.append(
            Series(
                TEMPERATURE_RANGE,
                "Zone temperatures (°C)",
                ["Coldest zone", "Median zone", "Warmest zone"],
                [COLDEST, MEDIAN, WARMEST],
                compute=lambda block, _: temperature_range(block.values[:, air]),
                widths=[2.0, 2.0, 2.0],
            )
        )
    if has_comfort:
        plots.append(
            Series(
                BAND_PATH,
                "Comfort band (°C)",
                ["Band, occupied", "Band, occupied", "Band", "Band"],
                [BAND] * 4,
                compute=lambda block, _: band_rows(block),
                widths=[4.0, 4.0, 1.0, 1.0],
                is_step=True,
                is_sparse=True,
            )
        )
    if roles.outdoor_temperature is not None:
        compute = _of_points([roles.outdoor_temperature])
        plots.append(
            Series(OUTDOORS, "Outdoor temperature (°C)", ["Outdoors"], [OUTDOOR], compute=compute, widths=[2.0])
        )
    return plots


def _power_series(roles: PointRoles) -> list[Series]:
    plots = []
    fuels = _other_fuels(roles)
    totals: list[tuple[str, RGB, PowerSource | EndUse]] = [
        (source.label, color, source)
        for color, source in ((FACILITY, roles.facility_power), (HVAC, roles.hvac_power))
        if source is not None
    ]
    shown = [
        *totals,
        *((use_label(fuel), end_use_color(fuel.label, fuel.fuel), fuel) for fuel in fuels if not roles.end_uses),
    ]
    if shown:
        title = "Electric power (kW)" if len(shown) == len(totals) else "Power (kW)"
        names, colors = [name for name, _, _ in shown], [color for _, color, _ in shown]
        compute, widths = _in_kw([source for _, _, source in shown]), [2.0] * len(shown)
        plots.append(Series(POWER, title, names, colors, compute=compute, widths=widths))
    if totals:
        names, colors = [name for name, _, _ in totals], [color for _, color, _ in totals]
        plots.append(
            Series(
                ENERGY,
                "Electricity so far (kWh)",
                names,
                colors,
                compute=_energy(roles),
                widths=[2.0] * len(names),
                is_smooth=True,
            )
        )
    if roles.end_uses:
        uses = [*roles.end_uses, *fuels]
        names, colors = [use_label(use) for use in uses], [end_use_color(use.label, use.fuel) for use in uses]
        plots.append(Series(END_USES, "End uses (kW)", names, colors, compute=_in_kw(uses)))
    return plots


def use_label(use: EndUse) -> str:
    """Return the name of an end use in a legend: `Cooling`, `Water systems (gas)`."""
    text = use.label[:1].upper() + use.label[1:]
    return text if use.fuel == "electricity" else f"{text} ({use.fuel.removeprefix('natural ')})"


def _other_fuels(roles: PointRoles) -> list[EndUse]:
    """Return the fuels of which the node has no end uses."""
    known = {use.fuel for use in roles.end_uses} | {"electricity"}
    return [fuel for fuel in roles.fuels if fuel.fuel not in known]


def _in_kw(sources: Sequence[PowerSource | EndUse]) -> Compute:
    columns = np.array([source.index for source in sources], np.intp)
    factors = np.array([source.to_kw for source in sources])
    return lambda block, _: block.values[:, columns] * factors


def _energy(roles: PointRoles) -> Compute:
    has = (roles.facility_power is not None, roles.hvac_power is not None)

    def compute(_: SampleBlock, totals: TotalRows) -> Floats:
        rows = (totals.facility_kwh, totals.hvac_kwh)
        return np.stack([row for row, is_there in zip(rows, has, strict=True) if is_there], axis=1)

    return compute


def _other_series(manifest: Manifest, roles: PointRoles) -> list[Series]:
    plots = []
    for number, (unit, indices) in enumerate(roles.others.items()):
        text = point_unit(manifest.points[indices[0]]) or unit_label(unit)
        names = [roles.labels[index] for index in indices]
        colors = [zone_color(place) for place in range(len(indices))]
        plots.append(Series(f"{OTHERS}/{number}", _unit_title(text, names), names, colors, compute=_of_points(indices)))
    return plots


_QUANTITIES = {
    "°C": "Temperatures", "K": "Temperature differences", "%": "Percentages", "W": "Power", "kW": "Power",
    "J": "Energy of the timestep", "kg/s": "Mass flow rates", "m³/s": "Volume flow rates", "W/m²": "Power per area",
    "people": "People", "ppm": "Concentrations", "lx": "Illuminance", "m/s": "Speeds", "°": "Angles", "Pa": "Pressures",
}  # fmt: skip


def _unit_title(unit: str, names: Sequence[str]) -> str:
    if len(names) == 1:
        return f"{names[0]} ({unit})" if unit else names[0]
    if not unit:
        return "Counts and ratios"
    return f"{_QUANTITIES.get(unit, 'Other points')} ({unit})"


def _actuator_series(manifest: Manifest, roles: PointRoles) -> list[Series]:
    groups: dict[tuple[str, str], list[int]] = {}
    for index, actuator in enumerate(manifest.actuators):
        groups.setdefault((_setpoint_kind(actuator, index, roles), point_unit(actuator)), []).append(index)
    colors = {zone.heating_actuator: zone_color(zone.place) for zone in roles.zones} | {
        zone.cooling_actuator: zone_color(zone.place) for zone in roles.zones
    }
    plots = []
    for number, ((kind, unit), indices) in enumerate(sorted(groups.items(), key=lambda group: not group[0][0])):
        own = [colors.get(index, zone_color(index)) for index in indices]
        quantity = f"{kind} {'setpoints' if kind or unit == '°C' else 'values'} ({unit})".strip().replace(" ()", "")
        for path, adjective, compute in ((COMMANDS, "Commanded", _commanded), (ACTUATORS, "Effective", _effective)):
            plots.append(
                Series(
                    f"{path}/{number}",
                    f"{adjective} {quantity}",
                    [_actuator_name(index, kind, roles) for index in indices],
                    own,
                    compute=compute(indices),
                    widths=[2.0] * len(indices),
                    is_step=True,
                    is_sparse=True,
                )
            )
    return plots


def _setpoint_kind(actuator: Actuator, index: int, roles: PointRoles) -> str:
    """Return `heating` or `cooling` for the setpoint of a zone; else no text."""
    for kind, control in (("heating", HEATING_SETPOINT), ("cooling", COOLING_SETPOINT)):
        is_zones = any(getattr(zone, f"{kind}_actuator") == index for zone in roles.zones)
        if is_zones or actuator.control_type.casefold() == control.casefold():
            return kind
    return ""


def _actuator_name(index: int, kind: str, roles: PointRoles) -> str:
    """Return the label of an actuator; for the setpoint of one zone that of the zone, as the title has the kind."""
    zones = [zone.label for zone in roles.zones if kind and getattr(zone, f"{kind}_actuator") == index]
    return zones[0] if len(zones) == 1 else roles.actuator_labels[index]
