"""Screenshots of recordings, drawn by a viewer without a window."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TypeVar

import numpy as np
from PIL import Image

from zenostat.topics import atomic_file
from zenostat.topics.calendar import parse_moment, parse_moment_within
from zenostat.topics.errors import InvalidConfig, ViewerError
from zenostat.views.live.recording import ELAPSED, SIMULATED
from zenostat.views.live.tabs import check_tab, open_tab
from zenostat.views.live.viewer import NO_VULKAN, Server, has_vulkan, readable, serving

SIZE = "1920x1080"

_LIMIT_S = 120.0
_SIZES = ((320, 240), (7680, 4320))
_TITLE_BAR = 36
"""Height in pixels of the strip that a viewer leaves empty where its top panel is hidden."""
_NOTICE_FRAMES = 60
"""Frames after which the viewer's notices have gone: they last 4 s of its own clock, at least 0.1 s a frame."""
_BLANK_COLORS = 8
"""Largest number of colors in a picture without any view."""
_PANELS = {
    "top": "PanelBlueprint",
    "blueprint": "PanelBlueprint",
    "selection": "PanelBlueprint",
    "time": "TimePanelBlueprint",
}
_T = TypeVar("_T")


@dataclass(frozen=True)
class Screenshot:
    """A picture to make of a recording.

    Attributes:
        path: a PNG file.
        at: simulated time of the cursor, such as `07-02T17:30`; None for the newest sample.
        width, height: size in pixels.
        tab: name of the tab to show, such as `Control` or, of one of several nodes, `office/Control`; None for the
            first.
    """

    path: Path
    at: str | None = None
    width: int = 1920
    height: int = 1080
    tab: str | None = None


def read_screenshot(path: Path, at: str | None = None, size: str = SIZE, tab: str | None = None) -> Screenshot:
    """Check where a screenshot is written, its time, its size and its tab.

    Raises:
        InvalidConfig: the path is not that of a PNG file which can be written, `at` or `size` has another form, or no
            layout has such a tab.
        ViewerError: no Vulkan driver is installed.
    """
    if path.suffix.lower() != ".png":
        raise InvalidConfig(f"--screenshot {path}: expected a .png file, for example --screenshot run.png")
    check_writable(path)
    if at is not None:
        try:
            parse_moment(at)
        except ValueError as error:
            raise InvalidConfig(f"--at {at}: {error}") from None
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    low, high = _SIZES
    width, height = (int(part) for part in match.groups()) if match else (0, 0)
    if not (low[0] <= width <= high[0] and low[1] <= height <= high[1]):
        raise InvalidConfig(
            f"--size {size}: expected width and height in pixels, from {low[0]}x{low[1]} to {high[0]}x{high[1]}, "
            f"for example --size {SIZE}"
        )
    if tab is not None:
        check_tab(tab)
    if not has_vulkan():
        raise ViewerError(NO_VULKAN)
    return Screenshot(path, at, width, height, tab)


def check_writable(path: Path) -> None:
    """Raise `InvalidConfig` if a file cannot be written at `path`, or an existing one not be changed."""
    atomic_file.check_writable(path, f"cannot write {path.name}")
    if path.exists() and not os.access(path, os.W_OK):
        raise InvalidConfig(f"cannot write {path}: permission denied")


def draw(recording: Path, screenshot: Screenshot) -> None:
    """Draw a recording as its layout has it, without the viewer's panels and notices, and write the picture.

    Raises:
        ViewerError: the viewer cannot be started or ends; the recording has no samples or does not have the time of
            the cursor; it is not drawn in time; or the picture cannot be written.
    """
    options = ("--headless", "--hide-welcome-screen", "--window-size")
    size = f"{screenshot.width}x{screenshot.height + _TITLE_BAR}"
    with (
        readable(recording) as path,
        serving(*options, size, environment={"RUST_LOG": "off"}) as server,  # most notices are lines of its log
    ):
        image = Drawing(server, path, str(recording)).image(screenshot)
    try:
        image.save(screenshot.path)
    except OSError as error:
        raise ViewerError(f"cannot write {screenshot.path}: {error.strerror or error}") from None


class Drawing:
    """A recording that a headless viewer draws.

    Attributes:
        viewer: Rerun's client of the viewer.
    """

    def __init__(self, server: Server, recording: Path, name: str) -> None:
        from rerun.experimental import ViewerClient

        self._server, self._recording, self._name = server, recording, name
        self._deadline = time.monotonic() + _LIMIT_S
        self.viewer = self._call(lambda: ViewerClient.connect(server.url))

    def image(self, screenshot: Screenshot) -> Image.Image:
        """Return the picture, once two in a row are equal."""
        viewer = self.viewer
        self._call(lambda: viewer.open(str(self._recording.absolute())))
        while self._call(viewer.get_state).loading:
            time.sleep(0.1)
        timeline = self._arrange(screenshot.tab)
        cursor_ns = self._cursor_ns(timeline, screenshot.at)
        if timeline == ELAPSED:
            elapsed = np.timedelta64(cursor_ns, "ns")
            self._call(lambda: viewer.set_time(timeline, duration=elapsed, play_state="paused"))
        else:
            moment = np.datetime64(cursor_ns, "ns")
            self._call(lambda: viewer.set_time(timeline, timestamp=moment, play_state="paused"))
        for _ in range(_NOTICE_FRAMES):  # each answer takes a frame
            self._call(viewer.get_state)
        before = b""
        while True:
            now = self._call(viewer.take_screenshot)
            if now == before:
                image = Image.open(BytesIO(now)).convert("RGB")
                image = image.crop((0, _TITLE_BAR, screenshot.width, screenshot.height + _TITLE_BAR))
                if image.getcolors(_BLANK_COLORS) is None and not self._call(viewer.get_state).loading:
                    return image
            before = now

    def _cursor_ns(self, timeline: str, at: str | None) -> int:
        """Return the place of the cursor: the newest sample, or simulated time `at` of the first node that has it."""
        first_ns, last_ns = self._recorded(timeline)
        if at is None or timeline == SIMULATED:
            return _cursor(at, first_ns, last_ns)
        errors = []
        for begin_ns in _begins(self._recording):
            try:
                return _cursor(at, begin_ns + first_ns, begin_ns + last_ns) - begin_ns
            except ViewerError as error:
                errors.append(error)
        raise errors[0]

    def _recorded(self, timeline: str) -> tuple[int, int]:
        """Return the first and the last time on a timeline in ns: since 1970, or since the begin of the episode."""
        for opened in self._call(self.viewer.get_state).recordings:
            for line in opened.timelines:
                if line.name == timeline and line.start is not None and line.end is not None:
                    return line.start, line.end
        raise ViewerError(f"{self._name} has no samples: there is nothing to draw")

    def _arrange(self, tab: str | None) -> str:
        """Hide the panels, and open a tab; return the layout's timeline."""
        blueprint = self._call(lambda: self.viewer.get_blueprint("recording")).blueprint
        for panel, archetype in _PANELS.items():
            blueprint.setdefault(f"/{panel}_panel", {}).setdefault(archetype, {})["state"] = "Hidden"
        blueprint["/time_panel"]["TimePanelBlueprint"]["play_state"] = "Paused"
        if tab is not None:
            open_tab(blueprint, tab)
        self._call(lambda: self.viewer.set_blueprint(blueprint, "recording"))
        return str(blueprint["/time_panel"]["TimePanelBlueprint"].get("timeline", SIMULATED))

    def _call(self, request: Callable[[], _T]) -> _T:
        """Return the viewer's answer; it has 15 s for each, which a busy machine may exceed."""
        while True:
            if time.monotonic() > self._deadline:
                raise ViewerError(f"the viewer did not draw {self._name} within {_LIMIT_S:.0f} s")
            try:
                return request()
            except (TimeoutError, ConnectionError):
                self._server.check()
            except RuntimeError as error:
                raise ViewerError(f"the viewer cannot draw {self._name}: {error}") from None
            time.sleep(0.1)


def _begins(recording: Path) -> list[int]:
    """Return the simulated times at which the recorded episodes begin, in ns since 1970, sorted by their paths."""
    from rerun.chunk import RrdReader

    begins: dict[str, int] = {}
    for chunk in RrdReader(str(recording)).stream():
        if not chunk.is_static:
            node, _, episode = str(chunk.entity_path).lstrip("/").partition("/")
            path = f"{node}/{episode.partition('/')[0]}"
            if path not in begins:
                batch = chunk.to_record_batch()
                simulated, elapsed = (batch.column(name)[0].value for name in (SIMULATED, ELAPSED))
                begins[path] = simulated - elapsed
    return [begin for _, begin in sorted(begins.items())]


def _cursor(at: str | None, first_ns: int, last_ns: int) -> int:
    """Return the time of the cursor in ns since 1970: `at` in the recorded year that has it, or the last sample's."""
    if at is None:
        return last_ns
    first, last = (np.datetime64(ns, "ns").astype("datetime64[s]").item() for ns in (first_ns, last_ns))
    try:
        moment = parse_moment_within(at, first, last)
    except ValueError as error:  # 29 February in another year
        raise ViewerError(f"--at {at}: {error}") from None
    if first <= moment <= last:
        return int(np.datetime64(moment, "ns").astype(np.int64))
    raise ViewerError(f"--at {at} is outside of the recorded time, {first:%Y-%m-%dT%H:%M} to {last:%Y-%m-%dT%H:%M}")
