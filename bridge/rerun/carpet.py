"""A carpet of zones over time: an image with a row for each zone, for long episodes and many zones."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from bridge.display.colors import comfort_colors
from bridge.rerun.recording import EpisodeLog
from bridge.rerun.samples import Floats, SampleBlock
from bridge.rerun.timelines import WITHIN_COLOR

CARPET = "carpet"
MAX_COLUMNS = 1400
"""Largest width of the carpet in pixels."""

_ASPECT = 2.6
_EMPTY = 34
_GAP = (14, 14, 14)
_TEXT = (225, 225, 225)
_MAX_LABELS = 16


class Carpet:
    """The deviation of each zone from its comfort band that is farthest from the band, by column of time.

    Args:
        zones: number of zones.
        steps: number of timesteps of the episode.
    """

    def __init__(self, zones: int, steps: int) -> None:
        self._per_column = max(1, -(-(steps + 1) // MAX_COLUMNS))
        self.deviations: Floats = np.full((zones, -(-(steps + 1) // self._per_column)), np.nan)

    def add(self, steps: NDArray[np.int64], deviations: Floats) -> None:
        """Add deviations in K of samples, shape (n, zones)."""
        columns = np.minimum(steps // self._per_column, self.deviations.shape[1] - 1)
        for column in np.unique(columns):
            rows = deviations[columns == column]
            candidates = np.concatenate([self.deviations[:, column][None, :], rows])
            distances = np.where(np.isnan(candidates), -1.0, np.abs(candidates))
            farthest = distances.argmax(axis=0)
            self.deviations[:, column] = candidates[farthest, np.arange(candidates.shape[1])]

    def column_of(self, step: int) -> int:
        """Return the column of a step."""
        return step // self._per_column


def row_height(zones: int, columns: int) -> int:
    """Return the height of a zone's row in pixels."""
    return max(3, round(columns / _ASPECT / max(zones, 1)))


def picture(deviations: Floats, height: int) -> NDArray[np.uint8]:
    """Return the pixels of a carpet, shape (zones * height, columns, 3); unknown values are dark."""
    pixels = comfort_colors(deviations)
    pixels[deviations == 0] = WITHIN_COLOR
    pixels[np.isnan(deviations)] = _EMPTY
    tall = np.repeat(pixels, height, axis=0)
    if height > 4:
        tall[height - 1 :: height] = _GAP
    return tall


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Return an RGB picture of shape (height, width, 3) as PNG (ISO/IEC 15948), rows filtered by `Up`."""
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1)
    above = np.vstack([np.zeros_like(rows[:1]), rows[:-1]])
    filtered = np.empty((len(rows), rows.shape[1] + 1), np.uint8)
    filtered[:, 0] = 2
    filtered[:, 1:] = rows - above
    header = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(filtered.tobytes(), 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


class CarpetView:
    """Logs the carpet of an episode; its image replaces the previous one.

    Args:
        log: where to log.
        zones: labels of the zones.
        steps: number of timesteps of the episode.
        begin: simulated time of the first sample.
        step_s: length of a timestep in s.
    """

    def __init__(self, log: EpisodeLog, zones: Sequence[str], steps: int, begin: np.datetime64, step_s: float) -> None:
        self._log, self._zones = log, zones
        self._carpet = Carpet(len(zones), steps)
        columns = self._carpet.deviations.shape[1]
        self._scale = max(1, MAX_COLUMNS // columns)
        self._height = row_height(len(zones), columns * self._scale)
        self._label(begin, steps, step_s)

    def _label(self, begin: np.datetime64, steps: int, step_s: float) -> None:
        stride = -(-len(self._zones) // _MAX_LABELS)
        shown = range(0, len(self._zones), stride)
        end = begin + np.timedelta64(round(steps * step_s), "s")
        days = np.arange(begin.astype("M8[D]"), end.astype("M8[D]") + 1)
        ticks = (
            [day for day in days if str(day).endswith("-01")] if len(days) > 45 else [*days[:: max(1, len(days) // 10)]]
        )
        bottom = len(self._zones) * self._height
        places, texts = [], []
        for place in shown:
            places.append((-0.12 * self._carpet.deviations.shape[1] * self._scale, (place + 0.5) * self._height))
            texts.append(self._zones[place])
        for day in ticks:
            step = int((day - begin) / np.timedelta64(1, "s") / step_s)
            if 0 <= step <= steps:
                places.append((self._carpet.column_of(step) * self._scale, bottom + 18.0))
                texts.append(day.astype("M8[s]").item().strftime("%-d %b"))
        self._log.static(
            f"{CARPET}/labels",
            rr.Points2D(places, labels=texts, colors=[_TEXT] * len(texts), radii=0.1, show_labels=True),
        )

    def add(self, block: SampleBlock) -> None:
        """Add samples; `draw` logs them."""
        self._carpet.add(block.steps, block.deviations)

    def draw(self) -> None:
        """Log the image."""
        pixels = np.repeat(picture(self._carpet.deviations, self._height), self._scale, axis=1)
        self._log.static(CARPET, rr.EncodedImage(contents=png(pixels), media_type="image/png"))
