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

from zenostat.topics.energyplus_names import THERMOSTAT
from zenostat.topics.messages import Manifest
from zenostat.views.live import series as names
from zenostat.views.live.building_view import BUILDING
from zenostat.views.live.carpet import CARPET
from zenostat.views.live.comfort_scale import COMFORT_SCALE
from zenostat.views.live.episode import EpisodeView, NodeModel
from zenostat.views.live.grid_series import GRID_PATHS
from zenostat.views.live.meshes import BuildingModel
from zenostat.views.live.recording import ELAPSED, SIMULATED, entity_path
from zenostat.views.live.series import Lines
from zenostat.views.live.summary import NUMBERS
from zenostat.views.live.value_sources import SOURCES

OVERVIEW = "overview"
EVENTS = "events"
MAX_PREVIEWS = 8
"""Largest number of nodes of which the overview shows more than a row of numbers."""

_PREVIEW_COLUMNS = 4

MAX_ZONE_PLOTS = 24
"""Largest number of zones with a plot of their own."""

_WIDTH_PX = 1900.0
"""Usual width of the layout, by which the room for legends is measured."""

_RIGHT_PX = 1050.0
"""Width of the plots of the first tab."""

_LEGEND_PX, _LETTER_PX, _AXIS_PX = 36.0, 6.9, 30.0
"""Width of a legend without its texts, of a letter, and of the labels of the vertical axis."""

_LogColumn = Literal["EntityPath", "LogLevel", "Body"]

_HIDDEN_TIMES = [TimelineColumn(name, visible=False) for name in (SIMULATED, ELAPSED)]
"""The columns of times are too narrow for them; each text begins with its time."""

_BACKGROUND = (16, 18, 20)


def blueprint(nodes: Sequence[tuple[NodeModel, EpisodeView]]) -> rrb.Blueprint:
    """Return the layout: the tabs of one node, or an overview and a tab for each of several."""
    timeline = common_timeline([model.manifest for model, _ in nodes])
    pages = [_NodePage(model, view, timeline, len(nodes)) for model, view in nodes]
    tabs = [page.tabs() for page in pages]
    root = tabs[0] if len(tabs) == 1 else rrb.Tabs(_overview(pages), *tabs, active_tab=0)
    panel = rrb.TimePanel(state="collapsed", timeline=timeline, play_state="Following")
    return rrb.Blueprint(root, panel, collapse_panels=True)


def common_timeline(manifests: Sequence[Manifest]) -> str:
    """Return the timeline on which the cursor is in the episodes of all nodes at once.

    It is simulated time if the episodes overlap; else, as for nodes of different years, the time since each begin.
    """
    begins, ends = zip(*((manifest.begin, manifest.end) for manifest in manifests), strict=True)
    is_common = max(map(datetime.fromisoformat, begins)) < min(map(datetime.fromisoformat, ends))
    return SIMULATED if is_common or len(manifests) == 1 else ELAPSED


def _overview(pages: Sequence[_NodePage]) -> rrb.Container:
    parts: list[tuple[rrb.View | rrb.Container, float]] = [
        (rrb.TextDocumentView(origin=entity_path(OVERVIEW), name="Nodes"), min(0.9 + 0.25 * len(pages), 3.0))
    ]
    previews = [page.preview() for page in pages[:MAX_PREVIEWS]]
    if previews:
        parts.append((rrb.Grid(*previews, grid_columns=min(len(previews), _PREVIEW_COLUMNS)), 5.0))
    contents = [f"+ {path}" for page in pages for path in page.event_paths]
    events = _log_view("/", "Events of all nodes", contents=contents, columns=["EntityPath", "LogLevel", "Body"])
    parts.append((events, 1.5))
    return rrb.Vertical(*(part for part, _ in parts), row_shares=[share for _, share in parts], name="Overview")


class _NodePage:
    """The tabs of one node."""

    def __init__(self, model: NodeModel, view: EpisodeView, timeline: str, nodes: int) -> None:
        self._model, self._view = model, view
        self._series = {series.path: series for series in view.series}
        begin, end = (datetime.fromisoformat(text) for text in (model.manifest.begin, model.manifest.end))
        self._length_s = (end - begin).total_seconds()
        self._begin_s = (begin - datetime(1970, 1, 1)).total_seconds() if timeline == SIMULATED else 0.0
        self._preview_px = _WIDTH_PX / min(nodes, _PREVIEW_COLUMNS)

    @property
    def title(self) -> str:
        """Name of the node and of its building."""
        return f"{self._model.manifest.node}: {self._model.manifest.building}"

    @property
    def event_paths(self) -> tuple[str, ...]:
        """Entities of the episode's events, and of notices about the node."""
        return self._path(EVENTS), entity_path(self._model.manifest.node, EVENTS)

    def _path(self, name: str) -> str:
        return self._view.log.path(name)

    def tabs(self) -> rrb.Container:
        """Return all tabs."""
        parts = [self.main(), self.zones(), self.energy(), self.grid(), self.control(), self.others(), self.events()]
        return rrb.Tabs(*(part for part in parts if part is not None), active_tab=0, name=self.title)

    def preview(self) -> rrb.Container:
        """Return what the overview shows of the node: its building, temperatures and power."""
        building = self._building(self.title)
        series = [self._temperatures(), self._series.get(names.POWER)]
        shown = [part for part in series if part is not None] or self._view.series[:2]
        plots = [self._plot(part, self._preview_px) for part in shown]
        parts = [building, *plots] if building is not None else plots
        shares = [2.0, *[1.0] * len(plots)] if building is not None else None
        return rrb.Vertical(*parts, row_shares=shares, name=self.title)

    def main(self) -> rrb.Container:
        """Return the first tab: the building, its numbers, zones over time and the most important plots."""
        numbers = rrb.TextDocumentView(origin=self._path(NUMBERS), name="Now")
        if not self._model.roles.zones:
            plots = [self._plot(series) for series in self._view.series if series.path not in GRID_PATHS]
            return rrb.Vertical(numbers, rrb.Grid(*plots), self._events(), row_shares=[1, 7, 2], name="Plant")
        building = self._building(f"{self._model.manifest.building}: zones against the comfort band")
        scale = None if building is None or self._model.comfort is None else self._scale()
        power = self._series.get(names.END_USES) or self._series.get(names.POWER)
        shown = ((self._temperatures(), 3.2), (self._series.get(names.OUTDOORS), 1.7), (power, 3.2))
        drawn = [(lines, share) for lines, share in shown if lines is not None]
        legend = _legend([lines for lines, _ in drawn])
        right: list[tuple[rrb.View, float]] = [(self._plot(lines, _RIGHT_PX, legend), share) for lines, share in drawn]
        rows_share = 4.0 if building is not None else min(4.0, 1.0 + 0.3 * len(self._model.roles.zones))
        left = [
            (part, share)
            for part, share in ((building, 5.0), (scale, 0.45), (self._zones_over_time(), rows_share))
            if part is not None
        ]
        if building is None and power is not None:
            left.append(right.pop())
        right.append((self._events(), 1.7))
        columns = rrb.Horizontal(
            rrb.Vertical(*(part for part, _ in left), row_shares=[share for _, share in left]),
            rrb.Vertical(*(part for part, _ in right), row_shares=[share for _, share in right]),
            column_shares=[_WIDTH_PX - _RIGHT_PX, _RIGHT_PX],
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

    def _scale(self) -> rrb.View:
        return rrb.Spatial2DView(
            origin=self._path(COMFORT_SCALE),
            name="Comfort band",
            titlebar=False,
            background=rrb.Background(kind="SolidColor", color=_BACKGROUND),
        )

    def _zones_over_time(self) -> rrb.View | None:
        if self._model.comfort is None:
            return None
        return _picture_view(self._path(CARPET), "Zones over time")

    def _temperatures(self) -> Lines | None:
        """Return the extremes of all zones, or the temperature of the only one."""
        return self._series.get(names.TEMPERATURE_RANGE) or self._series.get(names.TEMPERATURES)

    def zones(self) -> rrb.Container | None:
        """Return the tab of the zones: all temperatures, and a plot of each zone with its setpoints."""
        zones = self._model.roles.zones
        if not zones:
            return None
        several = self._plots([names.TEMPERATURES, names.OCCUPANTS, names.HUMIDITY], _WIDTH_PX)
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
            (names.TEMPERATURES, names.ZONE),
            (names.HEATING_SETPOINTS, names.HEATING),
            (names.COOLING_SETPOINTS, names.COOLING),
        ):
            series = self._series.get(path)
            if series is None or zone.label not in series.names:
                continue
            is_visible = [name == zone.label for name in series.names]
            colors = [list(color)] * len(series.names)
            contents.append(self._path(path))
            widths = [2.0 if path == names.TEMPERATURES else 1.2] * len(series.names)
            overrides[self._path(path)] = rr.SeriesLines(visible_series=is_visible, colors=colors, widths=widths)
        return rrb.TimeSeriesView(
            origin=self._path(""),
            contents=contents,
            overrides=overrides,
            name=zone.label,
            axis_x=self._axis((), _WIDTH_PX),
            plot_legend=rrb.PlotLegend(visible=False),
        )

    def energy(self) -> rrb.Container | None:
        """Return the tab of power and energy."""
        plots = self._plots([names.END_USES, names.POWER, names.ENERGY], _WIDTH_PX)
        return rrb.Vertical(*plots, name="Energy") if plots else None

    def grid(self) -> rrb.Container | None:
        """Return the tab of an electric grid: loading and voltage by line and bus, and who draws how much."""
        plots = self._plots(GRID_PATHS, _WIDTH_PX)
        return rrb.Vertical(*plots, name="Grid") if plots else None

    def control(self) -> rrb.Container | None:
        """Return the tab of setpoints, value sources and the reward."""
        commanded = self._model.manifest.actuators
        if not commanded:
            return None
        kinds = (names.COMMANDS, names.ACTUATORS)
        commands, effective = (self._plots([path for path in self._series if path.startswith(kind)]) for kind in kinds)
        # A thermostat's own actuators report these setpoints as their effective values.
        is_other = any(actuator.component_type.casefold() != THERMOSTAT.casefold() for actuator in commanded)
        setpoints = self._plots([names.HEATING_SETPOINTS, names.COOLING_SETPOINTS]) if is_other else []
        left = rrb.Tabs(
            rrb.Vertical(*effective, *setpoints, name="Effective values"),
            rrb.Vertical(*commands, name="Commanded values"),
        )
        right: list[rrb.View] = [_picture_view(self._path(SOURCES), "Who sets each actuator")]
        if self._view.reward is not None:
            right.append(self._plot(self._view.reward))
        return rrb.Horizontal(left, rrb.Vertical(*right), name="Control")

    def others(self) -> rrb.Container | None:
        """Return the tab of the points without a role, by unit."""
        plots = [self._plot(series) for path, series in self._series.items() if path.startswith(names.OTHERS)]
        return rrb.Grid(*plots, name="Other points") if plots else None

    def events(self) -> rrb.Container:
        """Return the tab of all events."""
        return rrb.Vertical(self._events(), name="Events")

    def _events(self) -> rrb.View:
        contents = [f"+ {path}" for path in self.event_paths]
        return _log_view(self._path(EVENTS), "Events and faults", contents)

    def _plots(self, paths: Sequence[str], width_px: float = _WIDTH_PX / 2) -> list[rrb.View]:
        """Return plots above each other, with one axis: that of the longest name in their legends."""
        series = [self._series[path] for path in paths if path in self._series]
        return [self._plot(lines, width_px, _legend(series)) for lines in series]

    def _plot(self, lines: Lines, width_px: float = _WIDTH_PX / 2, legend: Sequence[str] | None = None) -> rrb.View:
        contents = [self._path(lines.path)]
        if lines.path in (names.TEMPERATURE_RANGE, names.TEMPERATURES) and names.BAND_PATH in self._series:
            contents.append(self._path(names.BAND_PATH))
        return rrb.TimeSeriesView(
            origin=self._path(""),
            contents=contents,
            name=lines.title,
            axis_x=self._axis(_legend([lines]) if legend is None else legend, width_px),
            plot_legend=rrb.PlotLegend(corner="RightTop", visible=len(lines.names) > 1),  # one is named in the title
        )

    def _axis(self, legend: Sequence[str], width_px: float) -> rrb.TimeAxis:
        """Return the axis of an episode, with free time at its right that the legend covers, and no more."""
        free_px = _LEGEND_PX + _LETTER_PX * max(map(len, legend)) if legend else 0.0
        share = free_px / max(width_px - _AXIS_PX - free_px, free_px, 1.0)
        return _time_axis(self._begin_s, self._begin_s + (1.0 + share) * self._length_s)


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
        columns=rrb.TextLogColumns(timeline_columns=_HIDDEN_TIMES, text_log_columns=list(columns)),
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


def _legend(plots: Sequence[Lines]) -> list[str]:
    """Return the names in the legends of plots; a plot of one line has none."""
    return [name for lines in plots if len(lines.names) > 1 for name in lines.names]


def _picture_view(path: str, name: str) -> rrb.View:
    return rrb.Spatial2DView(origin=path, name=name, background=rrb.Background(kind="SolidColor", color=_BACKGROUND))


def _time_axis(first_s: float, last_s: float) -> rrb.TimeAxis:
    boundaries = (TimeRangeBoundary.absolute(seconds=seconds) for seconds in (first_s, last_s))
    return rrb.TimeAxis(view_range=TimeRange(*boundaries), zoom_lock=False)
