"""The prepared layout: a tab for each aspect of a node, an overview of several nodes."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TimelineColumn
from rerun.encodings import TimeRange, TimeRangeBoundary

from bridge.rerun import series as names
from bridge.rerun.building_view import BUILDING
from bridge.rerun.carpet import CARPET
from bridge.rerun.episode import EpisodeView, NodeModel
from bridge.rerun.meshes import BuildingModel
from bridge.rerun.recording import SIMULATED, entity_path
from bridge.rerun.series import Lines
from bridge.rerun.summary import NUMBERS
from bridge.rerun.timelines import SOURCES, ZONES
from topics.energyplus_names import THERMOSTAT

OVERVIEW = "overview"
EVENTS = "events"
MAX_LEGEND = 20
"""Largest number of lines in a plot with a visible legend."""

MAX_PREVIEWS = 8
"""Largest number of nodes of which the overview shows more than a row of numbers."""

MAX_ZONE_PLOTS = 24
"""Largest number of zones with a plot of their own."""

_LEGEND_SHARE, _WIDE_LEGEND_SHARE = 0.3, 0.12
"""Free time at the right of plots of half and of full width, as a share of the episode: their legends cover no line."""

_LogColumn = Literal["EntityPath", "LogLevel", "Body"]

_HIDDEN_TIME = TimelineColumn(SIMULATED, visible=False)
"""The column of times is too narrow for them; each text begins with its time."""

_BACKGROUND = (16, 18, 20)


def blueprint(nodes: Sequence[tuple[NodeModel, EpisodeView]]) -> rrb.Blueprint:
    """Return the layout: the tabs of one node, or an overview and a tab for each of several."""
    pages = [_NodePage(model, view) for model, view in nodes]
    tabs = [page.tabs() for page in pages]
    root = tabs[0] if len(tabs) == 1 else rrb.Tabs(_overview(pages), *tabs, active_tab=0)
    panel = rrb.TimePanel(state="collapsed", timeline=SIMULATED, play_state="Following")
    return rrb.Blueprint(root, panel, collapse_panels=True)


def _overview(pages: Sequence[_NodePage]) -> rrb.Container:
    parts: list[tuple[rrb.View | rrb.Container, float]] = [
        (rrb.TextDocumentView(origin=entity_path(OVERVIEW), name="Nodes"), min(0.9 + 0.25 * len(pages), 3.0))
    ]
    previews = [page.preview() for page in pages[:MAX_PREVIEWS]]
    if previews:
        parts.append((rrb.Grid(*previews, grid_columns=min(len(previews), 4)), 5.0))
    contents = [f"+ {page.events_path}" for page in pages]
    events = _log_view("/", "Events of all nodes", contents=contents, columns=["EntityPath", "LogLevel", "Body"])
    parts.append((events, 1.5))
    return rrb.Vertical(*(part for part, _ in parts), row_shares=[share for _, share in parts], name="Overview")


class _NodePage:
    """The tabs of one node."""

    def __init__(self, model: NodeModel, view: EpisodeView) -> None:
        self._model, self._view = model, view
        self._series = {series.path: series for series in view.series}
        begin, end = (datetime.fromisoformat(text) for text in (model.manifest.begin, model.manifest.end))
        self._axis = _time_axis(begin, end + _LEGEND_SHARE * (end - begin))
        self._wide_axis = _time_axis(begin, end + _WIDE_LEGEND_SHARE * (end - begin))
        self._whole_axis = _time_axis(begin, end)

    @property
    def title(self) -> str:
        """Name of the node and of its building."""
        return f"{self._model.manifest.node}: {self._model.manifest.building}"

    @property
    def events_path(self) -> str:
        """Entity of the node's events."""
        return entity_path(self._model.manifest.node, EVENTS)

    def _path(self, name: str) -> str:
        return self._view.log.path(name)

    def tabs(self) -> rrb.Container:
        """Return all tabs."""
        parts = [self.main(), self.zones(), self.energy(), self.control(), self.others(), self.events()]
        return rrb.Tabs(*(part for part in parts if part is not None), active_tab=0, name=self.title)

    def preview(self) -> rrb.Container:
        """Return what the overview shows of the node: its building, temperatures and power."""
        building = self._building(self.title)
        temperatures = self._plots([names.TEMPERATURE_RANGE]) or self._plots([names.TEMPERATURES])
        plots = [*temperatures, *self._plots([names.POWER])] or [self._plot(series) for series in self._view.series[:2]]
        parts = [building, *plots] if building is not None else plots
        shares = [2.0, *[1.0] * len(plots)] if building is not None else None
        return rrb.Vertical(*parts, row_shares=shares, name=self.title)

    def main(self) -> rrb.Container:
        """Return the first tab: the building, its numbers, zones over time and the most important plots."""
        numbers = rrb.TextDocumentView(origin=self._path(NUMBERS), name="Now")
        if not self._model.roles.zones:
            plots = [self._plot(series) for series in self._view.series]
            return rrb.Vertical(numbers, rrb.Grid(*plots), self._events(), row_shares=[1, 7, 2], name="Plant")
        building = self._building(f"{self._model.manifest.building}: zones against the comfort band")
        left = [part for part in (building, self._zones_over_time()) if part is not None]
        if self._model.building is None:
            left += self._plots([names.TEMPERATURES])
        power = self._plots([names.END_USES]) or self._plots([names.POWER])
        right = [
            *((plot, 3.2) for plot in self._plots([names.TEMPERATURE_RANGE]) or self._plots([names.TEMPERATURES])),
            *((plot, 1.7) for plot in self._plots([names.OUTDOORS])),
            *((plot, 3.2) for plot in power),
            (self._events(), 1.7),
        ]
        columns = rrb.Horizontal(
            rrb.Vertical(*left, row_shares=[5, 4][: len(left)]),
            rrb.Vertical(*(part for part, _ in right), row_shares=[share for _, share in right]),
            column_shares=[1, 1],
        )
        return rrb.Vertical(numbers, columns, row_shares=[1, 9], name="Building")

    def _building(self, title: str) -> rrb.View | None:
        building = self._model.building
        if building is None:
            return None
        return rrb.Spatial3DView(
            origin=self._path(BUILDING),
            name=title,
            background=rrb.Background(kind="SolidColor", color=_BACKGROUND),
            line_grid=rrb.LineGrid3D(visible=False),
            eye_controls=_camera(building),
        )

    def _zones_over_time(self) -> rrb.View | None:
        if self._model.comfort is None:
            return None
        title = "Zones over time: blue below, orange above the comfort band"
        if self._model.has_carpet:
            return rrb.Spatial2DView(
                origin=self._path(CARPET), name=title, background=rrb.Background(kind="SolidColor", color=_BACKGROUND)
            )
        return rrb.StateTimelineView(
            origin=self._path(ZONES), name=f"{title}; dark while unoccupied", time_view=self._whole_axis
        )

    def zones(self) -> rrb.Container | None:
        """Return the tab of the zones: all temperatures, and a plot of each zone with its setpoints."""
        zones = self._model.roles.zones
        if not zones:
            return None
        several = self._plots([names.TEMPERATURES, names.OCCUPANTS, names.HUMIDITY], is_wide=True)
        parts: list[rrb.Container] = [rrb.Vertical(*several, name="All zones")]
        if len(zones) <= MAX_ZONE_PLOTS:
            plots = [self._zone_plot(place) for place in range(len(zones))]
            parts.append(rrb.Grid(*plots, name="Each zone with its setpoints"))
        return rrb.Tabs(*parts, name="Zones") if len(parts) > 1 else rrb.Vertical(*several, name="Zones")

    def _zone_plot(self, place: int) -> rrb.View:
        zone = self._model.roles.zones[place]
        contents: list[str] = []
        overrides: dict[rr.encodings.EntityPath | str, rrb.VisualizableArchetype] = {}
        for path, color in (
            (names.TEMPERATURES, None),
            (names.HEATING_SETPOINTS, names.HEATING),
            (names.COOLING_SETPOINTS, names.COOLING),
        ):
            series = self._series.get(path)
            if series is None or zone.label not in series.names:
                continue
            is_visible = [name == zone.label for name in series.names]
            colors = [list(color)] * len(series.names) if color is not None else None
            contents.append(self._path(path))
            widths = [2.0 if color is None else 1.2] * len(series.names)
            overrides[self._path(path)] = rr.SeriesLines(visible_series=is_visible, colors=colors, widths=widths)
        return rrb.TimeSeriesView(
            origin=self._path(""),
            contents=contents,
            overrides=overrides,
            name=zone.label,
            axis_x=self._whole_axis,
            plot_legend=rrb.PlotLegend(visible=False),
        )

    def energy(self) -> rrb.Container | None:
        """Return the tab of power and energy."""
        plots = self._plots([names.END_USES, names.POWER, names.ENERGY], is_wide=True)
        return rrb.Vertical(*plots, name="Energy") if plots else None

    def control(self) -> rrb.Container | None:
        """Return the tab of setpoints, value sources and the reward."""
        commanded = self._model.manifest.actuators
        if not commanded:
            return None
        kinds = (names.COMMANDS, names.ACTUATORS)
        actuators = [self._plot(series) for path, series in self._series.items() if path.startswith(kinds)]
        # A thermostat's own actuators report these setpoints as their effective values.
        is_other = any(actuator.component_type.casefold() != THERMOSTAT.casefold() for actuator in commanded)
        setpoints = self._plots([names.HEATING_SETPOINTS, names.COOLING_SETPOINTS]) if is_other else []
        sources = rrb.StateTimelineView(
            origin=self._path(SOURCES), name="Who sets each actuator", time_view=self._whole_axis
        )
        left: list[rrb.View] = [*actuators, *setpoints]
        right: list[rrb.View] = [sources]
        if self._view.reward is not None:
            right.append(self._plot(self._view.reward))
        return rrb.Horizontal(rrb.Vertical(*left), rrb.Vertical(*right), name="Control")

    def others(self) -> rrb.Container | None:
        """Return the tab of the points without a role, by unit."""
        plots = [self._plot(series) for path, series in self._series.items() if path.startswith(names.OTHERS)]
        return rrb.Grid(*plots, name="Other points") if plots else None

    def events(self) -> rrb.Container:
        """Return the tab of all events."""
        return rrb.Vertical(self._events(), name="Events")

    def _events(self) -> rrb.View:
        return _log_view(self.events_path, "Events and faults")

    def _plots(self, paths: Sequence[str], *, is_wide: bool = False) -> list[rrb.View]:
        return [self._plot(self._series[path], is_wide=is_wide) for path in paths if path in self._series]

    def _plot(self, lines: Lines, *, is_wide: bool = False) -> rrb.View:
        contents = [self._path(lines.path)]
        if lines.path in (names.TEMPERATURE_RANGE, names.TEMPERATURES) and names.BAND_PATH in self._series:
            contents.append(self._path(names.BAND_PATH))
        return rrb.TimeSeriesView(
            origin=self._path(""),
            contents=contents,
            name=lines.title,
            axis_x=self._wide_axis if is_wide else self._axis,
            plot_legend=rrb.PlotLegend(corner="RightTop", visible=len(lines.names) <= MAX_LEGEND),
        )


def _log_view(
    origin: str,
    name: str,
    contents: Sequence[str] = ("$origin/**",),
    columns: Sequence[_LogColumn] = ("LogLevel", "Body"),
) -> rrb.View:
    return rrb.TextLogView(
        origin=origin,
        contents=list(contents),
        name=name,
        columns=rrb.TextLogColumns(timeline_columns=[_HIDDEN_TIME], text_log_columns=list(columns)),
    )


def _camera(building: BuildingModel) -> rrb.EyeControls3D:
    """Return a camera south-west of the building and above it, so that north is up and to the right."""
    width, depth, height = building.high - building.low
    is_flat = height < 0.25 * min(width, depth)
    direction = np.array([-0.22, -0.85, 0.8] if is_flat else [-0.42, -0.85, 0.68])
    distance = (1.75 if is_flat else 2.1) * building.radius_m
    target = building.center - [0.0, 0.0, 0.06 * building.radius_m]
    position = target + distance * direction / np.linalg.norm(direction)
    return rrb.EyeControls3D(kind="Orbital", position=position, look_target=target, eye_up=[0.0, 0.0, 1.0])


def _time_axis(begin: datetime, end: datetime) -> rrb.TimeAxis:
    first, last = ((moment - datetime(1970, 1, 1)).total_seconds() for moment in (begin, end))
    boundaries = (TimeRangeBoundary.absolute(seconds=seconds) for seconds in (first, last))
    return rrb.TimeAxis(view_range=TimeRange(*boundaries), zoom_lock=False)
