"""Sources of each actuator's value over time: controllers, devices, or nobody."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zenostat.topics.messages import Manifest
from zenostat.views.display.colors import RGB, UNKNOWN, zone_color
from zenostat.views.live.recording import EpisodeLog
from zenostat.views.live.row_picture import EMPTY, Columns, RowPicture
from zenostat.views.live.samples import BASELINE, UNRECORDED, SampleBlock

SOURCES = "sources"

_ASPECT = 1.75
_MAX_LEGEND = 6
_BASELINE_COLOR: RGB = (84, 88, 92)


class SourceColumns:
    """The value source of each actuator by column: of several in a column, the last that is unlike the one before it.

    So a short override is seen in a year.

    Args:
        actuators: number of actuators.
        columns: of the episode.

    Attributes:
        names: the sources, of which `shown` has the indices.
        shown: -1 where nothing has been simulated, shape (actuators, columns).
    """

    def __init__(self, actuators: int, columns: Columns) -> None:
        self._columns = columns
        self.names: dict[str, int] = {BASELINE: 0, UNRECORDED: 1}
        self.shown: NDArray[np.int64] = np.full((actuators, columns.count), -1, np.int64)
        self._column = -1
        self._before = self._latest = np.full(actuators, -1, np.int64)  # at the end of the previous column, and now

    def add(self, steps: NDArray[np.int64], sources: NDArray[np.object_]) -> None:
        """Add the names of the sources at samples, shape (n, actuators); an empty name is baseline control."""
        for name in dict.fromkeys(sources.ravel().tolist()):
            if name:
                self.names.setdefault(name, len(self.names))
        index = {"": 0} | self.names
        table = np.array([[index[name] for name in row] for row in sources.tolist()], np.int64).reshape(sources.shape)
        columns = self._columns.of(steps)
        for column in np.unique(columns):
            if column != self._column:
                self._column, self._before = int(column), self._latest
            for row in table[columns == column]:
                is_new = (row != self._before) | (self.shown[:, column] < 0)
                self.shown[is_new, column] = row[is_new]
                self._latest = row


class SourcesView:
    """Logs the value sources of an episode.

    Args:
        log: where to log.
        actuators: labels of the actuators.
        manifest: of the node.
    """

    def __init__(self, log: EpisodeLog, actuators: Sequence[str], manifest: Manifest) -> None:
        columns = Columns(manifest.steps)
        self._sources = SourceColumns(len(actuators), columns)
        self._picture = RowPicture(log, SOURCES, actuators, columns, manifest, _ASPECT)

    def add(self, block: SampleBlock) -> None:
        """Add samples; `draw` logs them."""
        self._sources.add(block.steps, block.sources)
        self._picture.add(block)

    def draw(self) -> None:
        """Log the picture."""
        names = list(self._sources.names)
        colors = [_BASELINE_COLOR, UNKNOWN, *map(zone_color, range(len(names) - 2)), EMPTY]
        used = set(np.unique(self._sources.shown).tolist())
        legend = [(name, colors[place]) for place, name in enumerate(names) if place in used]
        if len(legend) > _MAX_LEGEND:
            legend = [*legend[:_MAX_LEGEND], (f"and {len(legend) - _MAX_LEGEND} more", EMPTY)]
        self._picture.draw(np.array(colors, np.uint8)[self._sources.shown], legend)
