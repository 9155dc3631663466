"""The picture of an episode's last day: a title, and panels over a common time axis."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.style import context

from zenostat.agent_sdk.envs.episode_history import EpisodeHistory
from zenostat.agent_sdk.rewards import Reward
from zenostat.topics.messages import Manifest
from zenostat.views.rendering.artists import HEIGHT, INK, LEFT, MUTED, RIGHT, WIDTH
from zenostat.views.rendering.data import Window, term_names
from zenostat.views.rendering.panels import ROW_PX, Panel
from zenostat.views.rendering.quantities import FrameQuantities
from zenostat.views.rendering.scale import format_time, format_time_tick
from zenostat.views.rendering.text import Pixels, Style, TextPainter

_DPI = 100
_TOP_PX, _BOTTOM_PX, _GAP_PX, _LEAST_PX = 38, 24, 10, 34
_TITLE_Y, _TIME_Y, _EDGE_PX = 18, HEIGHT - 12, 10
_TITLE, _CLOCK, _TICK = Style(10.5, "bold", INK), Style(9.0, "normal", MUTED), Style(7.6, "normal", MUTED)


class EpisodeFrame:
    """Draws histories of one node's episodes; the figure is built once and reused.

    A picture depends on its history alone, not on what was drawn before.

    Args:
        manifest: The node's manifest.
        reward: The reward, whose comfort band is shown; None if there is none.

    Attributes:
        panels: The panels of the latest picture, from top to bottom.
    """

    def __init__(self, manifest: Manifest, reward: Reward | None) -> None:
        self._manifest = manifest
        self._quantities = FrameQuantities(manifest, reward)
        self._dimensions = len(manifest.task.discrete_actions) or len(manifest.task.actions)
        self._terms: tuple[str, ...] | None = None
        self._begin = manifest.time_at(0)
        with context("default"):  # not the user's own style
            self._text = TextPainter()
        self.panels: list[Panel] = []

    def draw(self, history: EpisodeHistory) -> Pixels:
        """Draw a history, shape (640, 960, 3), 0 to 255."""
        terms = term_names(history)
        if self._terms != terms:
            self._terms = terms
            with context("default"):
                self._build(terms)
        window = Window(history, self._manifest, self._dimensions)
        for panel in self.panels:
            panel.update(window)
        self._canvas.draw()
        picture = np.asarray(self._canvas.buffer_rgba())[..., :3].copy()
        for panel in self.panels:
            panel.paint(picture, self._text)
        self._paint_title(picture, window)
        return picture

    def _build(self, terms: tuple[str, ...]) -> None:
        """Create the figure: each panel gets the height of its legend, and a share of the rest by weight."""
        figure = Figure((WIDTH / _DPI, HEIGHT / _DPI), _DPI, facecolor="white")
        self._canvas: Any = FigureCanvasAgg(figure)
        self.panels = self._quantities.panels(terms)
        least = [max(ROW_PX * panel.row_count, _LEAST_PX) for panel in self.panels]
        free = HEIGHT - _TOP_PX - _BOTTOM_PX - _GAP_PX * (len(self.panels) - 1) - sum(least)
        weights, top = sum(panel.weight for panel in self.panels), float(_TOP_PX)
        for panel, needed in zip(self.panels, least, strict=True):
            height = needed + free * panel.weight / weights
            panel.attach(figure, top, height)
            top += height + _GAP_PX

    def _paint_title(self, picture: Pixels, window: Window) -> None:
        manifest, text, now = self._manifest, self._text, window.times[-1]
        step = round((now - self._begin) / manifest.timestep)
        clock = f"{format_time(now)}  ·  step {step:,} of {manifest.steps:,}"
        text.paint(picture, WIDTH - _EDGE_PX, _TITLE_Y, clock, _CLOCK, "right")
        room = WIDTH - LEFT - _EDGE_PX - text.width(clock, _CLOCK) - 20
        name = manifest.task.scenario or manifest.building
        title = f"{name} · {manifest.location}" if manifest.location else name
        if text.width(title, _TITLE) > room:
            title = text.shortened(name, _TITLE, room)
        text.paint(picture, LEFT, _TITLE_Y, title, _TITLE)
        first, last = window.limits
        for hours in window.ticks:
            x = LEFT + (RIGHT - LEFT) * (hours - first) / (last - first)
            text.paint(picture, x, _TIME_Y, format_time_tick(window.origin, hours), _TICK, "center")
