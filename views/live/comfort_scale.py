"""The legend of the building in 3D: the colors of the comfort scale, and the limits of the band at the cursor."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np
import rerun as rr
from PIL import Image, ImageDraw, ImageFont

from zenostat.metrics.comfort import band_text
from zenostat.views.display.colors import COMFORT_RANGE_K, RGB, WITHIN, comfort_color
from zenostat.views.live.recording import EpisodeLog
from zenostat.views.live.samples import SampleBlock

COMFORT_SCALE = "comfort_scale"

_GROUND: RGB = (16, 18, 20)
_TEXT: RGB = (225, 225, 225)
_FONT_PX, _GAP_PX, _BAND_PX = 20, 10, 400


def comfort_legend(within: RGB = WITHIN) -> list[tuple[str, RGB]]:
    """Return texts and colors of the comfort scale; `within` is the color within the band."""
    half = COMFORT_RANGE_K / 2
    steps = (-COMFORT_RANGE_K, -half, 0.0, half, COMFORT_RANGE_K)
    ends = f"{COMFORT_RANGE_K:g} K"
    texts = (f"{ends} below", f"{half:g} K", "within the comfort band", f"{half:g} K", f"{ends} above")
    return [(text, comfort_color(k) if k else within) for text, k in zip(texts, steps, strict=True)]


def draw_legend(
    draw: ImageDraw.ImageDraw,
    font: ImageFont.ImageFont | ImageFont.FreeTypeFont,
    x: float,
    y: float,
    legend: Sequence[tuple[str, RGB]],
) -> float:
    """Draw colors with texts beside them from (x, y) on; return where they end."""
    for text, color in legend:
        draw.rectangle((x, y + 2, x + _FONT_PX, y + _FONT_PX), fill=color)
        x += _FONT_PX + _GAP_PX
        draw.text((x, y + _FONT_PX / 2), text, _TEXT, font, anchor="lm")
        x += font.getlength(text) + 2 * _GAP_PX
    return x


class ComfortScale:
    """Logs the scale, and the limits of the comfort band over time.

    Args:
        log: where to log.
    """

    def __init__(self, log: EpisodeLog) -> None:
        self._log = log
        self._band = ""
        font, legend = ImageFont.load_default(_FONT_PX), comfort_legend()
        width = draw_legend(ImageDraw.Draw(Image.new("RGB", (1, 1))), font, _GAP_PX, 0, legend)
        image = Image.new("RGB", (round(width) + _BAND_PX, _FONT_PX + _GAP_PX), _GROUND)
        draw_legend(ImageDraw.Draw(image), font, _GAP_PX, _GAP_PX / 2, legend)
        self._place = [width + _BAND_PX / 2, 0.2 * image.height]  # the text is below it
        content = BytesIO()
        image.save(content, "PNG")
        log.static(COMFORT_SCALE, rr.EncodedImage(contents=content.getvalue(), media_type="image/png"))

    def add(self, block: SampleBlock) -> None:
        """Log the limits where they change: from the lowest to the highest of all zones."""
        rows, texts = [], []
        for row, limits in enumerate(zip(*block.outer_limits(), strict=True)):
            band = band_text(*limits, ".1f")
            if band != self._band:
                self._band = band
                rows.append(row)
                texts.append(band)
        if rows:
            points = rr.Points2D.columns(
                positions=np.tile(self._place, (len(rows), 1)),
                labels=texts,
                colors=[list(_TEXT)] * len(rows),
                radii=[0.01] * len(rows),
                show_labels=[True] * len(rows),
            )
            self._log.columns(f"{COMFORT_SCALE}/band", block, points, np.array(rows))
