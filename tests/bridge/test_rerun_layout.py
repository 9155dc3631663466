"""The prepared layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import rerun as rr
import rerun.blueprint as rrb
from support.monitor import office, rows, samples, two_storeys

from bridge.display.comfort import default_comfort
from bridge.rerun.layout import blueprint
from bridge.rerun.node_stream import NodeStream
from bridge.rerun.summary import NodeNumbers, NodeRow, markdown, overview, quantity


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


def test_one_node_opens_on_its_building(recording: rr.RecordingStream) -> None:
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


def test_views_show_entities_that_are_logged(recording: rr.RecordingStream) -> None:
    """A path that is logged nowhere would be an empty view."""
    node = _node(recording)
    paths = {node.view.log.path(series.path) for series in node.view.series}
    for view in _views(blueprint([(node.model, node.view)]).root_container):
        if isinstance(view, rrb.TimeSeriesView):
            assert set(view.contents) <= paths
            assert {str(path) for path in view.visualizer_overrides} <= paths


def test_several_nodes_have_an_overview_and_a_tab_each(recording: rr.RecordingStream) -> None:
    nodes = [_node(recording, node=name) for name in ("north", "plain")]
    layout = blueprint([(node.model, node.view) for node in nodes])
    tabs = layout.root_container.contents
    assert [tab.name for tab in tabs] == ["Overview", "north: office-small", "plain: office-small"]
    assert [part.name for part in tabs[0].contents[1].contents] == ["north: office-small", "plain: office-small"]
    assert _views(tabs[0])[-1].contents == ["+ /north/events", "+ /plain/events"]
    kinds = [{type(view) for view in _views(tab)} for tab in tabs]
    assert rrb.Spatial3DView in kinds[1]
    assert rrb.Spatial3DView not in kinds[2]  # it has no geometry
    recording.send_blueprint(layout)


def test_overview_has_a_row_for_each_node_in_order() -> None:
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
def test_one_person_is_not_people(count: float, text: str) -> None:
    assert f"**{text}**" in markdown(NodeNumbers(people=count))


def test_a_number_that_is_not_there_is_a_dash() -> None:
    assert quantity(None, "kW") == "\N{EN DASH}"
    assert quantity(0.0, "people", 0) == "0 people"
