"""Pictures with a labeled row for each zone or actuator, and a column for each part of an episode."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from zenostat.topics.messages import Manifest
from zenostat.views.display.colors import RGB
from zenostat.views.live.comfort_scale import draw_legend
from zenostat.views.live.recording import EpisodeLog
from zenostat.views.live.samples import SampleBlock

MAX_COLUMNS = 1400
"""Largest number of columns; the smallest width of the rows in pixels is half of it."""

EMPTY: RGB = (34, 34, 34)
"""Color of what has not been simulated yet."""

_GROUND: RGB = (16, 18, 20)
_TEXT: RGB = (225, 225, 225)
_CURSOR: RGB = (255, 255, 255)
_FONT_PX, _GAP_PX = 20, 8
_MAX_LABEL_PX, _MAX_ROW_PX = 420, 80


class Columns:
    """The columns of an episode: each has the same number of consecutive samples.

    Args:
        steps: number of timesteps of the episode.

    Attributes:
        count: number of columns.
    """

    def __init__(self, steps: int) -> None:
        self._per_column = max(1, -(-(steps + 1) // MAX_COLUMNS))
        self.count = -(-(steps + 1) // self._per_column)

    def of(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the column of each step."""
        return np.minimum(steps // self._per_column, self.count - 1)


class RowPicture:
    """Logs the picture, which replaces the previous one, and a line at the time of the cursor.

    Args:
        log: where to log.
        path: entity of the picture.
        names: labels of the rows.
        columns: of the episode.
        manifest: of the node.
        aspect: width by height.
    """

    def __init__(
        self, log: EpisodeLog, path: str, names: Sequence[str], columns: Columns, manifest: Manifest, aspect: float
    ) -> None:
        self._log, self._path, self._names, self._columns = log, path, list(names), columns
        self._steps, self._step_s = manifest.steps, manifest.step_s
        self._begin = np.datetime64(manifest.begin, "s")
        self._font = ImageFont.load_default(_FONT_PX)
        self._scale = max(1, MAX_COLUMNS // columns.count)
        width = columns.count * self._scale
        labels = (self._font.getlength(name) for name in self._names)
        self._left = round(min(max(labels, default=0.0), _MAX_LABEL_PX)) + 2 * _GAP_PX
        self._top = _FONT_PX + 2 * _GAP_PX
        margins = self._top + _FONT_PX + 3 * _GAP_PX
        height = round(((width + self._left) / aspect - margins) / max(len(names), 1))
        self._row = min(max(3, height), _MAX_ROW_PX)
        self._bottom = self._top + self._row * len(names)
        self._size = (self._left + width + _GAP_PX, self._bottom + _FONT_PX + 3 * _GAP_PX)
        self._column = -1

    def add(self, block: SampleBlock) -> None:
        """Move the cursor's line to the columns of new samples."""
        columns = self._columns.of(block.steps)
        rows = np.flatnonzero(np.diff(columns, prepend=self._column))
        self._column = int(columns[-1])
        if len(rows):
            x = self._left + (columns[rows] + 0.5) * self._scale
            strips = np.stack([np.stack([x, np.full(len(x), y)], axis=1) for y in (self._top, self._bottom)], axis=1)
            lines = rr.LineStrips2D.columns(strips=strips, colors=[_CURSOR] * len(x), radii=[-0.75] * len(x))
            self._log.columns(f"{self._path}/cursor", block, lines, rows)

    def draw(self, pixels: NDArray[np.uint8], legend: Sequence[tuple[str, RGB]]) -> None:
        """Log the picture.

        Args:
            pixels: colors, shape (rows, columns, 3).
            legend: texts above the rows, each with its color.
        """
        image = Image.new("RGB", self._size, _GROUND)
        draw = ImageDraw.Draw(image)
        tall = np.repeat(np.repeat(pixels, self._row, axis=0), self._scale, axis=1)
        if self._row > 8:
            tall[self._row - 1 :: self._row] = _GROUND
        image.paste(Image.fromarray(tall), (self._left, self._top))
        draw_legend(draw, self._font, self._left, _GAP_PX, legend)
        self._draw_labels(draw)
        self._draw_days(draw)
        content = BytesIO()
        image.save(content, "PNG")
        self._log.static(self._path, rr.EncodedImage(contents=content.getvalue(), media_type="image/png"))

    def _draw_labels(self, draw: ImageDraw.ImageDraw) -> None:
        stride = -(-(_FONT_PX + 2) // self._row)  # where rows are lower than the text, only some have a label
        for place in range(0, len(self._names), stride):
            text = self._names[place]
            while self._font.getlength(text) > _MAX_LABEL_PX:
                text = text[:-2] + "…"
            y = self._top + (place + 0.5) * self._row
            draw.text((self._left - _GAP_PX, y), text, _TEXT, self._font, anchor="rm")

    def _draw_days(self, draw: ImageDraw.ImageDraw) -> None:
        end = self._begin + np.timedelta64(round(self._steps * self._step_s), "s")
        days = np.arange(self._begin.astype("M8[D]"), end.astype("M8[D]") + 1)
        is_long = len(days) > 45
        ticks = [day for day in days if str(day).endswith("-01")] if is_long else days[:: max(1, len(days) // 10)]
        for day in ticks:
            step = int((day - self._begin) / np.timedelta64(1, "s") / self._step_s)
            if 0 <= step < self._steps:
                x = self._left + int(self._columns.of(np.array([step]))[0]) * self._scale
                draw.line((x, self._bottom, x, self._bottom + _GAP_PX), fill=_TEXT)
                moment = day.astype("M8[s]").item()
                y = self._bottom + _GAP_PX + _FONT_PX / 2 + 2
                draw.text((x + 4, y), f"{moment.day} {moment:%b}", _TEXT, self._font, anchor="lm")
