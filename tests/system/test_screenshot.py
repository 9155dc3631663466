"""Screenshots of recordings: what their pixels show, and how each failure is reported."""

import contextlib
import os
import shutil
import signal
import subprocess
from datetime import datetime
from io import BytesIO
from pathlib import Path

import numpy as np
import psutil
import pytest
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from PIL import Image
from rerun.encodings import TimeRange, TimeRangeBoundary
from support.nodes import until
from support.run_cli import ZENOSTAT, plain, run_in_process

import zenostat
from zenostat.bridge.transport.session import open_session
from zenostat.topics.errors import ViewerError
from zenostat.views.live.screenshot import Drawing, Screenshot, draw
from zenostat.views.live.stream import RerunStream
from zenostat.views.live.viewer import has_vulkan, serving, web_viewer

needs_vulkan = pytest.mark.skipif(
    not has_vulkan(), reason="no Vulkan driver is installed; on Debian: apt install mesa-vulkan-drivers libvulkan1"
)

SIZE = (640, 400)
RED, GREEN = (255, 40, 40), (40, 255, 40)
DAY = (datetime(2017, 7, 3), datetime(2017, 7, 4))


def _recording(path: Path, *, samples: int = 97) -> Path:
    """Write a day of two constant series, red in the upper view and green in the lower one, over an axis of the day."""
    axis = rrb.TimeAxis(view_range=TimeRange(*(TimeRangeBoundary.absolute(seconds=_seconds(end)) for end in DAY)))
    with rr.RecordingStream("zenostat") as recording:
        recording.set_sinks(rr.FileSink(str(path)))
        views = []
        for name, color in (("upper", RED), ("lower", GREEN)):
            recording.log(name, rr.SeriesLines(colors=color, widths=3), static=True)
            if samples:
                times = np.datetime64(DAY[0], "ns") + np.arange(samples) * np.timedelta64(15, "m")
                values = rr.Scalars.columns(scalars=np.full(samples, 20.0))
                rr.send_columns(name, [rr.TimeColumn("simulated", timestamp=times)], values, recording=recording)
            views.append(rrb.TimeSeriesView(origin=name, name=name, axis_x=axis))
        panel = rrb.TimePanel(state="expanded", timeline="simulated", play_state="following")
        recording.send_blueprint(rrb.Blueprint(rrb.Vertical(*views), panel))
        recording.disconnect()
    return path


def _seconds(moment: datetime) -> float:
    return (moment - datetime(1970, 1, 1)).total_seconds()


def _pixels(picture: Path | bytes) -> NDArray[np.int16]:
    with Image.open(BytesIO(picture) if isinstance(picture, bytes) else picture) as image:
        return np.asarray(image.convert("RGB")).astype(np.int16)


def _cursor(pixels: NDArray[np.int16]) -> int:
    """Return the column of the cursor: a light line from top to bottom."""
    rows = pixels[pixels.shape[0] // 4 : pixels.shape[0] * 3 // 4].min(axis=2)
    return int(np.percentile(rows, 5, axis=0).argmax())


@pytest.mark.slow
@needs_vulkan
def test_screenshot__draws_each_view_at_the_requested_time(scratch):
    path, columns = _recording(scratch / "run.rrd"), []
    for hour in (6, 12, 18):
        picture = scratch / f"{hour}.png"
        draw(path, Screenshot(picture, f"07-03T{hour:02}:00", *SIZE))
        pixels = _pixels(picture)
        assert pixels.shape == (SIZE[1], SIZE[0], 3)
        for part, color in ((slice(0, SIZE[1] // 2), RED), (slice(SIZE[1] // 2, None), GREEN)):
            half = pixels[part]
            line = np.all(abs(half - color) < 60, axis=2).any(axis=0)  # columns that the series crosses
            assert line.sum() > 0.8 * SIZE[0]
            columns.append(_cursor(half))
    upper, lower = np.diff(columns[::2]), np.diff(columns[1::2])
    assert np.all(upper > 0.2 * SIZE[0])
    assert abs(upper[0] - upper[1]) <= 2  # six hours each
    assert np.array_equal(upper, lower)


@pytest.mark.slow
@needs_vulkan
def test_screenshot__screenshot_has_no_panels_and_no_notices(scratch):
    """Notices are lighter boxes at the top right, the top panel has orange warnings, the time panel buttons."""
    draw(_recording(scratch / "run.rrd"), Screenshot(scratch / "run.png", None, *SIZE))
    pixels = _pixels(scratch / "run.png")
    background = pixels[SIZE[1] // 4, SIZE[0] // 2]
    assert (pixels[30:150, -300:] == background).all(axis=2).mean() > 0.8
    red, green, blue = np.moveaxis(pixels, 2, 0)
    assert not ((red > 200) & (abs(green - 120) < 60) & (blue < 60)).any()
    assert not ((blue > red + 60) & (blue > green + 60)).any()


@pytest.mark.slow
@needs_vulkan
def test_screenshot__each_view_of_a_real_run_shows_its_data(scratch, episode_bus):
    path = scratch / "run.rrd"
    with (
        open_session(connect=[episode_bus.endpoint]) as session,
        RerunStream(session, "*", [rr.FileSink(str(path))]) as stream,
    ):
        with zenostat.connect(episode_bus.endpoint, affinity="off") as bus, bus.controller("office") as link:
            assert len(list(link)) == 97
        until(lambda: stream.pump() or stream.samples >= 97, "all samples have come")
    with serving("--headless", "--hide-welcome-screen", "--window-size", "1280x720") as server:
        drawing = Drawing(server, path, str(path))
        first, last = (drawing.image(Screenshot(path, f"07-03T{hour}:00", 1280, 720)) for hour in ("06", "18"))
        views, pictures = drawing.viewer.get_state().views, _open_views(drawing)
        drawing = Drawing(server, path, str(path))
        drawing.image(Screenshot(path, "07-03T18:00", 1280, 720, tab="Control"))
        open_views = _open_views(drawing)
        in_control = {view.name for view in drawing.viewer.get_state().views if view.view_id in open_views}
    assert np.any(np.asarray(first) != np.asarray(last))
    assert not [view.reports for view in views if any(report.severity == "error" for report in view.reports)]
    shown = [view for view in views if view.view_id in pictures]
    in_first_tab = {"Now", "Zone temperatures (°C)", "Outdoor temperature (°C)", "Events and faults"}
    assert in_first_tab <= {view.name for view in shown}
    assert {
        "Effective heating setpoints (°C)",
        "Effective cooling setpoints (°C)",
        "Who sets each actuator",
    } <= in_control
    assert not in_control & in_first_tab
    assert "3D" in {view.view_class for view in shown}
    for view in shown:
        pixels = pictures[view.view_id]
        if view.view_class == "TimeSeries":
            is_colored = pixels.max(axis=2) - pixels.min(axis=2) > 40  # frames, titles, axes and the cursor are gray
            assert is_colored.sum() > 100, view.name
        else:
            colors, counts = np.unique(pixels.reshape(-1, 3), axis=0, return_counts=True)
            assert counts.max() < 0.98 * counts.sum(), view.name
            assert len(colors) > 20, view.name


def _open_views(drawing: Drawing) -> dict[str, NDArray[np.int16]]:
    """Return the pixels of each view of the open tab."""
    pictures = {}
    for view in drawing.viewer.get_state().views:
        with contextlib.suppress(ConnectionError):  # in another tab
            pictures[view.view_id] = _pixels(drawing.viewer.take_screenshot(view.view_id))
    return pictures


@pytest.mark.slow
@needs_vulkan
def test_screenshot__cursor_of_nodes_of_different_years_is_where_simulated_time_is(scratch):
    """Two nodes, nine years apart, six hours after each began."""
    path, columns = _two_years(scratch / "run.rrd"), []
    for number, at in enumerate(("2017-07-03T06:00", "2026-01-12T06:00")):
        picture = scratch / f"{number}.png"
        draw(path, Screenshot(picture, at, *SIZE))
        columns.append(_cursor(_pixels(picture)))
    assert columns[0] == pytest.approx(SIZE[0] / 4, abs=0.05 * SIZE[0])
    assert columns[0] == columns[1]
    with pytest.raises(
        ViewerError, match=r"--at 2018-01-01T00:00 is outside of the recorded time, 2017-07-03T00:00 to"
    ):
        draw(path, Screenshot(scratch / "run.png", "2018-01-01T00:00", *SIZE))


def _two_years(path: Path) -> Path:
    """Write a day of two nodes on the timeline of the time since each one's begin."""
    axis = rrb.TimeAxis(view_range=TimeRange(*(TimeRangeBoundary.absolute(seconds=s) for s in (0, 86400))))
    with rr.RecordingStream("zenostat") as recording:
        recording.set_sinks(rr.FileSink(str(path)))
        elapsed = np.arange(97) * np.timedelta64(15, "m").astype("m8[ns]")
        for node, begin in (("north", "2017-07-03"), ("south", "2026-01-12")):
            simulated = rr.TimeColumn("simulated", timestamp=np.datetime64(begin, "ns") + elapsed)
            times = [simulated, rr.TimeColumn("elapsed", duration=elapsed)]
            values = rr.Scalars.columns(scalars=np.full(97, 20.0))
            rr.send_columns(f"{node}/episode_0000/power", times, values, recording=recording)
        view = rrb.TimeSeriesView(origin="north", axis_x=axis)
        panel = rrb.TimePanel(timeline="elapsed", play_state="following")
        recording.send_blueprint(rrb.Blueprint(view, panel))
        recording.disconnect()
    return path


@pytest.mark.slow
@needs_vulkan
@pytest.mark.parametrize(("samples", "at", "reason"), [
    (97, "07-05T12:00", "--at 07-05T12:00 is outside of the recorded time, 2017-07-03T00:00 to 2017-07-04T00:00"),
    (0, None, "run.rrd has no samples"),
])  # fmt: skip
def test_screenshot__what_cannot_be_drawn_is_reported(scratch, samples, at, reason):
    path = _recording(scratch / "run.rrd", samples=samples)
    with pytest.raises(ViewerError, match=reason):
        draw(path, Screenshot(scratch / "run.png", at, *SIZE))
    assert not (scratch / "run.png").exists()


@pytest.mark.slow
@needs_vulkan
def test_screenshot__recording_without_its_end_is_drawn(scratch):
    """A killed monitor leaves such a file."""
    whole = _recording(scratch / "whole.rrd").read_bytes()
    path, picture = scratch / "run.rrd", scratch / "run.png"
    path.write_bytes(whole[: int(len(whole) * 0.9)])
    draw(path, Screenshot(picture, None, *SIZE))
    assert (np.all(abs(_pixels(picture) - RED) < 60, axis=2)).any()


def test_screenshot__file_that_is_no_recording_is_reported(scratch):
    path = scratch / "run.rrd"
    path.write_text("no recording")
    with pytest.raises(ViewerError, match=r"run\.rrd is not a recording"):
        draw(path, Screenshot(scratch / "run.png"))


def test_screenshot__no_screenshot_without_a_vulkan_driver(scratch, monkeypatch):
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"):
        monkeypatch.setenv(name, os.devnull)
    with pytest.raises(ViewerError, match="needs a Vulkan driver"):
        draw(_recording(scratch / "run.rrd"), Screenshot(scratch / "run.png"))


@pytest.mark.parametrize(("options", "reason"), [
    (["--screenshot", "run.jpg"], "run.jpg: expected a .png file"),
    (["--screenshot", "nowhere/run.png"], "cannot write run.png: there is no folder"),
    (["--screenshot", "run.png", "--at", "noon"], "--at noon: expected a date and time such as 2017-07-03T08:00"),
    (["--screenshot", "run.png", "--at", "02-30T08:00"], "'02-30T08:00' is not a valid date and time"),
    (["--screenshot", "run.png", "--size", "10x10"], "--size 10x10: expected width and height in pixels"),
    (["--screenshot", "run.png", "--tab", "Controls"], "--tab Controls: there is no tab 'Controls'; did you mean"),
    (["--at", "07-03"], "--at 07-03 needs --screenshot FILE.png"),
    (["--tab", "Control"], "--tab Control needs --screenshot FILE.png"),
    (["--web", "--screenshot", "run.png"], "--web and --screenshot exclude each other"),
    ([], "a window needs a display, and neither DISPLAY nor WAYLAND_DISPLAY is set"),
])  # fmt: skip
def test_screenshot__options_that_are_not_valid_are_reported_before_anything_starts(
    scratch, monkeypatch, options, reason
):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    (scratch / "run.rrd").touch()
    done = run_in_process("view", "run.rrd", *options, cwd=scratch, columns=300)
    assert (done.returncode, done.stdout) == (2, "")
    assert reason in plain(done.stderr)


@pytest.mark.parametrize(("options", "reason"), [
    (["--save", "run.txt"], "--save run.txt: expected a .rrd file"),
    (["--save", "nowhere/run.rrd"], "cannot write run.rrd: there is no folder"),
    (["--size", "640x480"], "--size 640x480 needs --screenshot FILE.png"),
])  # fmt: skip
def test_monitor__checks_its_files_first(scratch, options, reason):
    done = run_in_process("monitor", *options, cwd=scratch, columns=300)
    assert (done.returncode, done.stdout) == (2, "")
    assert reason in plain(done.stderr)


@pytest.mark.slow
@needs_vulkan
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_screenshot__interrupted_screenshot_leaves_no_viewer(scratch, number):
    _recording(scratch / "run.rrd")
    command = [*ZENOSTAT, "view", "run.rrd", "--screenshot", "run.png"]
    program = subprocess.Popen(command, cwd=scratch, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        viewers: list[psutil.Process] = []
        until(lambda: bool(viewers) or viewers.extend(_viewers(program.pid)), "the viewer runs")
        program.send_signal(number)
        printed, _ = program.communicate(timeout=60)
    finally:
        program.kill()
        program.wait()
    gone, _ = psutil.wait_procs(viewers, timeout=60)
    assert gone == viewers
    assert printed == ""
    left = {path.name for path in scratch.iterdir()} - {"run.rrd"}
    if number == signal.SIGKILL:  # nobody is left to remove the viewer's folder
        (folder,) = left
        shutil.rmtree(scratch / folder)
    else:
        assert (program.returncode, left) == (130 if number == signal.SIGINT else 143, set())


def _viewers(parent: int) -> list[psutil.Process]:
    return [child for child in psutil.Process(parent).children(recursive=True) if child.name() == "rerun"]


@needs_vulkan
def test_screenshot__viewer_that_dies_is_reported(scratch):
    path = _recording(scratch / "run.rrd")
    with serving("--headless") as server:
        server.process.kill()
        server.process.wait()
        with pytest.raises(ViewerError, match="the rerun program was killed by SIGKILL"):
            Drawing(server, path, str(path)).image(Screenshot(scratch / "run.png"))


def test_screenshot__page_shows_a_recording_until_it_is_closed(scratch):
    with web_viewer(_recording(scratch / "run.rrd")) as (page, url):
        assert url in page
    assert [path.name for path in scratch.iterdir()] == ["run.rrd"]
