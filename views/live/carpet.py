"""The zones over time: how far each is from its comfort band, and whether it is occupied."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest
from zenostat.views.display.colors import RGB, comfort_colors
from zenostat.views.live.comfort_scale import comfort_legend
from zenostat.views.live.recording import EpisodeLog
from zenostat.views.live.row_picture import EMPTY, Columns, RowPicture
from zenostat.views.live.samples import SampleBlock

CARPET = "zones_over_time"
WITHIN_COLOR: RGB = (116, 124, 118)  # darker than in other pictures: lit rows would outshine the deviations

_ASPECT = 2.35
_DARK: RGB = (24, 26, 28)
_DARK_SHARE = 0.58


class Carpet:
    """The deviation of each zone from its comfort band that is farthest from the band, by column.

    A column with occupied samples of a zone has the farthest of these.

    Args:
        zones: number of zones.
        columns: of the episode.

    Attributes:
        deviations: in K, NaN if unknown, shape (zones, columns).
        is_occupied: shape (zones, columns).
    """

    def __init__(self, zones: int, columns: Columns) -> None:
        self._columns = columns
        self.deviations: Floats = np.full((zones, columns.count), np.nan)
        self.is_occupied: NDArray[np.bool_] = np.zeros((zones, columns.count), bool)

    def add(self, steps: NDArray[np.int64], deviations: Floats, is_occupied: NDArray[np.bool_]) -> None:
        """Add deviations in K of samples and whether the zones are occupied, each of shape (n, zones)."""
        columns = self._columns.of(steps)
        zones = np.arange(len(self.deviations))
        for column in np.unique(columns):
            rows = columns == column
            candidates = np.concatenate([self.deviations[:, column][None], deviations[rows]])
            occupied = np.concatenate([self.is_occupied[:, column][None], is_occupied[rows]])
            distances = np.where(np.isnan(candidates), -1.0, np.abs(candidates))
            farthest = np.where(occupied & (distances >= 0), distances + 1e6, distances).argmax(axis=0)
            self.deviations[:, column] = candidates[farthest, zones]
            self.is_occupied[:, column] = occupied[farthest, zones]


def picture(deviations: Floats, is_occupied: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the colors of a carpet, shape (zones, columns, 3): dark while unoccupied, darkest where unknown."""
    pixels = comfort_colors(deviations)
    pixels[deviations == 0] = WITHIN_COLOR
    dark = np.rint(pixels + _DARK_SHARE * (np.array(_DARK) - pixels.astype(float))).astype(np.uint8)
    pixels = np.where(is_occupied[..., None], pixels, dark)
    pixels[np.isnan(deviations)] = EMPTY
    return pixels


class CarpetView:
    """Logs the carpet of an episode.

    Args:
        log: where to log.
        zones: labels of the zones.
        manifest: of the node.
    """

    def __init__(self, log: EpisodeLog, zones: Sequence[str], manifest: Manifest) -> None:
        columns = Columns(manifest.steps)
        self._carpet = Carpet(len(zones), columns)
        self._picture = RowPicture(log, CARPET, zones, columns, manifest, _ASPECT)

    def add(self, block: SampleBlock) -> None:
        """Add samples; `draw` logs them."""
        self._carpet.add(block.steps, block.deviations, block.is_occupied)
        self._picture.add(block)

    def draw(self) -> None:
        """Log the picture."""
        legend = [*comfort_legend(WITHIN_COLOR), ("dark: unoccupied", _DARK)]
        self._picture.draw(picture(self._carpet.deviations, self._carpet.is_occupied), legend)
