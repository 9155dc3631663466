"""The prepared layout."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from support import builders
from support.monitor import office, rows, samples, two_storeys

from zenostat.metrics.comfort import default_comfort
from zenostat.topics.errors import InvalidConfig, ViewerError
from zenostat.views.live.layout import blueprint
from zenostat.views.live.node_stream import NodeStream
from zenostat.views.live.summary import NodeNumbers, NodeRow, markdown, overview, quantity
from zenostat.views.live.tabs import Blueprint, check_tab, open_tab


def _node(recording: rr.RecordingStream, **changes: Any) -> NodeStream:
    manifest = office(**changes)
    node = NodeStream(
        recording, manifest, two_storeys() if changes.get("node") != "plain" else None, default_comfort, None
    )
    for sample in samples(manifest, rows(2)):
        node.add_sample(sample)
    node.flush()
    return node


def _views(part: Any) -> list[Any]:
    if isinstance(part, rrb.Container):
        return [view for child in part.contents for view in _views(child)]
    return [part]


@pytest.fixture
def recording(scratch: Path) -> rr.RecordingStream:
    rr.set_strict_mode(True)
    stream = rr.RecordingStream("zenostat")
    stream.set_sinks(rr.FileSink(str(scratch / "run.rrd")))
    return stream


def test_rerun_layout__one_node_opens_on_its_building(recording: rr.RecordingStream) -> None:
    node = _node(recording)
    layout = blueprint([(node.model, node.view)])
    first, *others = layout.root_container.contents
    assert [tab.name for tab in (first, *others)] == ["Building", "Zones", "Energy", "Control", "Events"]
    names = [view.name for view in _views(first)]
    assert names[0] == "Now"
    assert names[1].startswith("office-small: zones against")
    assert "Outdoor temperature (°C)" in names
    assert "End uses (kW)" in names
    assert layout.time_panel.play_state == "Following"
    recording.send_blueprint(layout)


def test_rerun_layout__views_show_entities_that_are_logged(recording: rr.RecordingStream) -> None:
    """A path that is logged nowhere would be an empty view."""
    node = _node(recording)
    paths = {node.view.log.path(series.path) for series in node.view.series}
    for view in _views(blueprint([(node.model, node.view)]).root_container):
        if isinstance(view, rrb.TimeSeriesView):
            assert set(view.contents) <= paths
            assert len(view.contents) == len(set(view.contents))
            assert {str(path) for path in view.visualizer_overrides} <= paths


def test_rerun_layout__several_nodes_have_an_overview_and_a_tab_each(recording: rr.RecordingStream) -> None:
    nodes = [_node(recording, node=name) for name in ("north", "plain")]
    layout = blueprint([(node.model, node.view) for node in nodes])
    tabs = layout.root_container.contents
    assert [tab.name for tab in tabs] == ["Overview", "north: office-small", "plain: office-small"]
    assert [part.name for part in tabs[0].contents[1].contents] == ["north: office-small", "plain: office-small"]
    assert _views(tabs[0])[-1].contents == [
        f"+ /{name}{part}/events" for name in ("north", "plain") for part in ("/episode_0000", "")
    ]
    kinds = [{type(view) for view in _views(tab)} for tab in tabs]
    assert rrb.Spatial3DView in kinds[1]
    assert rrb.Spatial3DView not in kinds[2]  # it has no geometry
    recording.send_blueprint(layout)


def test_rerun_layout__nodes_of_different_years_have_a_cursor_in_common(recording: rr.RecordingStream) -> None:
    """On the timeline of the time since each one's begin; nodes whose episodes overlap share simulated time."""
    north = _node(recording, node="north")
    for begin, end, timeline in (
        ("2017-07-01T06:00:00", "2017-07-02T00:00:00", "simulated"),
        ("2026-01-12T00:00:00", "2026-01-14T00:00:00", "elapsed"),
    ):
        south = _node(recording, node="south", begin=begin, end=end)
        layout = blueprint([(node.model, node.view) for node in (north, south)])
        assert layout.time_panel.timeline == timeline
        plots = [view for view in _views(layout.root_container) if isinstance(view, rrb.TimeSeriesView)]
        first = {view.properties["TimeAxis"].view_range.as_arrow_array()[0].as_py()["start"] for view in plots}
        assert len(first) == (1 if timeline == "elapsed" else 2)


def test_rerun_layout__one_zone_is_drawn_once(recording: rr.RecordingStream) -> None:
    room = builders.manifest(
        sensors=[builders.sensor("room_temperature", "").model_copy(update={"key": ""})],
        actuators=[builders.actuator("heating_setpoint")],
    )
    node = NodeStream(recording, room, None, default_comfort, None)
    for sample in samples(room, [[20.0], [21.0]]):
        node.add_sample(sample)
    node.flush()
    first, *_ = blueprint([(node.model, node.view)]).root_container.contents
    titles = [view.name for view in _views(first)]
    assert titles.count("Room (°C)") == 1
    assert len(titles) == len(set(titles))


def test_rerun_layout__plots_have_free_time_for_their_legend_and_none_without_one(
    recording: rr.RecordingStream,
) -> None:
    """A letter of a legend takes about 6.5 px of the 950 that half of a usual screen has for a plot."""
    node = _node(recording)
    names = {node.view.log.path(series.path): series.names for series in node.view.series}
    tabs = {tab.name: tab for tab in blueprint([(node.model, node.view)]).root_container.contents}
    begin, end = (np.datetime64(text, "ns") for text in (office().begin, office().end))
    episode_ns = (end - begin).astype(int)
    lengths = set()
    for tab, width_px in ((tabs["Control"], 950), (tabs["Zones"].contents[0], 1900)):
        for view in (view for view in _views(tab) if isinstance(view, rrb.TimeSeriesView)):
            legend = next(names[path] for path in view.contents)
            begin, end = view.properties["TimeAxis"].view_range.as_arrow_array()[0].as_py().values()
            free_px = width_px * (1.0 - episode_ns / (end - begin))
            if len(legend) == 1:
                assert free_px == pytest.approx(0.0)
            else:
                assert 0 < free_px - 6.5 * max(map(len, legend)) < 80
            is_visible = view.properties["PlotLegend"].visible.as_arrow_array()[0].as_py()
            assert is_visible == (len(legend) > 1)
            lengths.add(len(legend))
    assert lengths == {1, 2}


def test_rerun_layout__tabs_are_found_by_name() -> None:
    for name in ("Building", "Plant", "Other points", "Overview", "office/Control"):
        check_tab(name)
    with pytest.raises(InvalidConfig, match="--tab control: there is no tab 'control'; did you mean 'Control'"):
        check_tab("control")
    with pytest.raises(InvalidConfig, match="no tab 'Overview'"):
        check_tab("office/Overview")


def _viewer_blueprint(*nodes: str) -> Blueprint:
    """The containers of a layout as a viewer reports them: tabs of one node, or of several nodes beside an overview."""
    containers: Blueprint = {}

    def tabs(name: str, title: str, children: list[str]) -> str:
        fields = {"container_kind": "Tabs", "display_name": title, "contents": children}
        containers[f"/container/{name}"] = {"ContainerBlueprint": fields}
        return f"container/{name}"

    def leaf(name: str, title: str) -> str:
        fields = {"container_kind": "Vertical", "display_name": title, "contents": f"view/{name}"}
        containers[f"/container/{name}"] = {"ContainerBlueprint": fields}
        return f"container/{name}"

    pages = [
        tabs(node, f"{node}: small", [leaf(f"{node}-{tab}", tab) for tab in ("Building", "Control")]) for node in nodes
    ]
    root = pages[0] if len(pages) == 1 else tabs("root", "", [leaf("overview", "Overview"), *pages])
    containers["/viewport"] = {"ViewportBlueprint": {"root_container": root.partition("/")[2]}}
    return containers


@pytest.mark.parametrize(
    ("nodes", "name", "active"),
    [
        (["office"], "Control", {"office": "container/office-Control"}),
        (["north", "south"], "Overview", {"root": "container/overview"}),
        (["north", "south"], "south", {"root": "container/south"}),
        (["north", "south"], "south/Control", {"root": "container/south", "south": "container/south-Control"}),
    ],
)
def test_rerun_layout__tab_is_opened(nodes: list[str], name: str, active: dict[str, str]) -> None:
    layout = _viewer_blueprint(*nodes)
    open_tab(layout, name)
    for container, child in active.items():
        assert layout[f"/container/{container}"]["ContainerBlueprint"]["active_tab"] == child


def test_rerun_layout__tab_of_several_nodes_needs_the_nodes_name() -> None:
    with pytest.raises(ViewerError, match="several nodes have the tab 'Control'; did you mean 'north/Control' or"):
        open_tab(_viewer_blueprint("north", "south"), "Control")
    with pytest.raises(ViewerError, match="--tab Zones: the layout has no tab 'Zones'"):
        open_tab(_viewer_blueprint("office"), "Zones")


def test_rerun_layout__overview_has_a_row_for_each_node_in_order() -> None:
    warm = NodeNumbers(low_degc=20.04, high_degc=27.0, hvac_kw=12.34, facility_kwh=12345.6, occupied_kh=1.0)
    rows = [NodeRow("south", "hospital", NodeNumbers(), is_connected=False), NodeRow("north", "office", warm)]
    _, _, north, south = overview(rows).splitlines()
    assert "| **north** | office |" in north
    for text in ("20.0 to 27.0 °C", "12.3 kW", "12,346 kWh", "1.0 K h", "none"):
        assert text in north
    assert "**south** (gone)" in south


@pytest.mark.parametrize(
    ("count", "text"), [(0.0, "0 people"), (0.6, "1 person"), (1.0, "1 person"), (2.0, "2 people")]
)
def test_rerun_layout__one_person_is_not_people(count: float, text: str) -> None:
    assert f"**{text}**" in markdown(NodeNumbers(people=count))


def test_rerun_layout__number_that_is_not_there_is_a_dash() -> None:
    assert quantity(None, "kW") == "\N{EN DASH}"
    assert quantity(0.0, "people", 0) == "0 people"
