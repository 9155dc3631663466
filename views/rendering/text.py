"""Text of pictures, painted from bitmaps that are drawn once for each string.

With Matplotlib's own text, a picture of 70 strings takes 3.1 to 3.7 times as long; if the strings that stay the same
are kept as a background, 1.6 to 3.4 times, because the ticks of an axis change with its values (Matplotlib 3.11).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

Color = tuple[float, float, float]
Pixels = NDArray[np.uint8]

_DPI = 100
_WIDTH, _HEIGHT, _BASELINE = 1000, 28, 19
_LEFT = 4
_CAP_HEIGHT = 0.365
"""Half of the height of digits, as a share of the font size."""


class Style(NamedTuple):
    """Font size in points, weight, and color from 0 to 1."""

    size: float
    weight: str
    color: Color


class TextPainter:
    """Paints text into a picture. matplotlib takes milliseconds for each string, most of which recur in a video."""

    def __init__(self) -> None:
        figure = Figure((_WIDTH / _DPI, _HEIGHT / _DPI), _DPI, facecolor="white")
        self._canvas: Any = FigureCanvasAgg(figure)
        self._text = figure.text(
            _LEFT / _WIDTH, 1.0 - _BASELINE / _HEIGHT, "", va="baseline", color="black", family="DejaVu Sans",
            parse_math=False,
        )  # fmt: skip
        self._bitmap = lru_cache(maxsize=4096)(self._draw)

    def _draw(self, string: str, size: float, weight: str) -> NDArray[np.float32]:
        """Return the coverage of each pixel, 0 to 1, shape (28, width)."""
        self._text.set(text=string, fontsize=size, weight=weight)
        self._canvas.draw()
        coverage = 1.0 - np.asarray(self._canvas.buffer_rgba())[..., 0].astype(np.float32) / np.float32(255.0)
        used = np.flatnonzero(coverage.any(axis=0))
        return coverage[:, used[0] : used[-1] + 1].copy() if used.size else coverage[:, :0].copy()

    def width(self, string: str, style: Style) -> int:
        """Return the width of a string in pixels."""
        return int(self._bitmap(string, style.size, style.weight).shape[1])

    def shortened(self, string: str, style: Style, room_px: float) -> str:
        """Return a string that fits, with an ellipsis if it is cut."""
        if self.width(string, style) <= room_px:
            return string
        least, most = 0, len(string)
        while least < most:
            middle = (least + most + 1) // 2
            fits = self.width(string[:middle].rstrip() + "…", style) <= room_px
            least, most = (middle, most) if fits else (least, middle - 1)
        return string[:least].rstrip() + "…"

    def paint(self, picture: Pixels, x: float, y: float, string: str, style: Style, align: str = "left") -> None:
        """Paint a string into a picture of shape (height, width, 3).

        Args:
            picture: The picture.
            x: Pixels from the left to the string's beginning, center or end, as `align` says.
            y: Pixels from the top to the middle of its digits.
            string: The text.
            style: Font and color.
            align: `left`, `center` or `right`.
        """
        bitmap = self._bitmap(string, style.size, style.weight)
        height, width = bitmap.shape
        shift = {"left": 0.0, "center": 0.5, "right": 1.0}[align] * width
        left = min(max(round(x - shift), 0), picture.shape[1] - width)
        top = round(y + _CAP_HEIGHT * style.size * _DPI / 72.0) - _BASELINE
        first, last = max(-top, 0), min(height, picture.shape[0] - top)
        part = picture[top + first : top + last, left : left + width]
        cover = bitmap[first:last, :, np.newaxis]
        ink = np.array(style.color, np.float32) * np.float32(255.0)
        part[:] = np.rint(part * (1 - cover) + ink * cover).astype(np.uint8)
