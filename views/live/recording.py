"""Logging below an episode's entity."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from zenostat.topics.errors import ViewerError
from zenostat.views.live.samples import SampleBlock

SIMULATED = "simulated"
ELAPSED = "elapsed"
STEP = "step"


def entity_path(*parts: str) -> str:
    """Return an entity path; `/` within a part divides it. Spaces become `_`, which viewers show without escapes."""
    texts = (text.replace(" ", "_") for path in parts for text in path.split("/") if text)
    return "/" + "/".join(map(rr.escape_entity_path_part, texts))


def episode_path(node: str, episode: int, run: int = 1) -> str:
    """Return the path of an episode's entity; later runs of a node of that name count their episodes anew."""
    return entity_path(node, f"episode_{episode:04}" if run == 1 else f"run_{run}_episode_{episode:04}")


def write_out(recording: rr.RecordingStream, name: str) -> None:
    """Wait until all that was logged is written, also where a viewer that took it as well has ended.

    Raises:
        ViewerError: the recording of this name cannot be written.
    """
    try:
        recording.flush()
    except RuntimeError as error:  # the thread that writes has ended; Rerun does not say why
        if "gRPC" in str(error):
            return
        raise ViewerError(f"cannot write {name}: {error}; its disk may be full") from None


class EpisodeLog:
    """Logs entities of one episode of one node.

    Args:
        recording: where to log.
        root: path of the episode's entity.
        begin: simulated time of sample 0.
    """

    def __init__(self, recording: rr.RecordingStream, root: str, begin: str) -> None:
        self._recording, self.root = recording, root
        self._begin = np.datetime64(begin, "ns")

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
        self.columns_at(name, block.times[rows], block.steps[rows], columns)

    def columns_at(self, name: str, times: NDArray[np.datetime64], steps: NDArray[np.int64], columns: Any) -> None:
        """Log columns with an entry for each of these simulated times (datetime64[ns]) and steps."""
        lines = [
            rr.TimeColumn(SIMULATED, timestamp=times),
            rr.TimeColumn(ELAPSED, duration=times - self._begin),
            rr.TimeColumn(STEP, sequence=steps),
        ]
        rr.send_columns(self.path(name), lines, columns, recording=self._recording)
