"""Logging below an episode's entity."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from bridge.rerun.samples import SampleBlock

SIMULATED = "simulated"
STEP = "step"


def entity_path(*parts: str) -> str:
    """Return an entity path; `/` within a part divides it. Spaces become `_`, which viewers show without escapes."""
    texts = (text.replace(" ", "_") for path in parts for text in path.split("/") if text)
    return "/" + "/".join(map(rr.escape_entity_path_part, texts))


class EpisodeLog:
    """Logs entities of one episode of one node.

    Args:
        recording: where to log.
        root: path of the episode's entity.
    """

    def __init__(self, recording: rr.RecordingStream, root: str) -> None:
        self._recording, self.root = recording, root

    def path(self, name: str) -> str:
        """Return the path of an entity below the episode's."""
        return self.root + entity_path(name)

    def static(self, name: str, *archetypes: Any) -> None:
        """Log what holds at all times."""
        self._recording.log(self.path(name), *archetypes, static=True)

    def columns(
        self, name: str, block: SampleBlock, columns: Any, rows: NDArray[np.intp] | slice = slice(None)
    ) -> None:
        """Log columns with an entry for each of these rows of a block."""
        times = [
            rr.TimeColumn(SIMULATED, timestamp=block.times[rows]),
            rr.TimeColumn(STEP, sequence=block.steps[rows]),
        ]
        rr.send_columns(self.path(name), times, columns, recording=self._recording)
