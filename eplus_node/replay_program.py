"""A replay as a program for another program: `python -m zenostat.eplus_node.replay_program`.

Standard input and output are those of a node's program, see `zenostat.bridge.node.program`. The settings are those of
`ReplaySettings`; the program ends with the recording, or when standard input is closed.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field

from zenostat.bridge.node.program import main
from zenostat.bridge.transport.session import open_session
from zenostat.topics.codec import validated
from zenostat.topics.extras import requires_extra
from zenostat.topics.keys import Role

if TYPE_CHECKING:
    from zenostat.bridge.recording.replay import Replay
    from zenostat.topics.messages import Manifest


class ReplaySettings(BaseModel):
    """Settings of a replay; others are ignored.

    Attributes:
        file: the recording.
        name: of the node on the bus.
        speed: simulated seconds per second.
        connect: endpoints of the bus.
        keys: folder of keys; the certificate of a node is presented. None: a bus without keys.
        check: whether the recording is only opened.
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    file: Path
    name: str
    speed: Annotated[float, Field(gt=0)]
    connect: tuple[str, ...]
    keys: Path | None = None
    check: bool = False


class ReplayProgram:
    """A replay that is served until the end of its recording.

    Args:
        settings: what is replayed, and where.

    Raises (on entering):
        InvalidRecording: the file cannot be replayed.
        NameInUse: a node of that name is on the bus.
        MissingExtra: the extra `recording` is not installed.
    """

    _replay: Replay

    def __init__(self, settings: ReplaySettings) -> None:
        self.settings = settings
        self._close = ExitStack()

    @property
    def manifest(self) -> Manifest:
        """The manifest of the node on the bus."""
        return self._replay.manifest

    def check(self) -> None:
        """Open the recording; errors as on entering."""
        with self._reader():
            pass

    def _reader(self) -> Any:
        with requires_extra("recording", "a recording", "mcap and zstandard"):
            from zenostat.bridge.recording.reader import RecordingReader
        return RecordingReader(self.settings.file)

    def __enter__(self) -> Self:
        settings = self.settings
        with ExitStack() as undo:
            reader = undo.enter_context(self._reader())
            from zenostat.bridge.recording.replay import Replay
            from zenostat.eplus_node.verify_recording import RecordedPlant

            session = undo.enter_context(open_session(connect=settings.connect, keys=settings.keys, role=Role.NODE))
            semantic = RecordedPlant(reader, exact=True).semantic_turtle
            replay = Replay(reader, session, name=settings.name, speed=settings.speed, semantic=semantic)
            self._replay = undo.enter_context(replay)
            self._close = undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._close.close()

    def serve(self) -> None:
        """Publish the recording to its end; `InvalidConfig` if it has no samples."""
        self._replay.run(threading.Event())


def _create(fields: Mapping[str, Any]) -> ReplayProgram:
    return ReplayProgram(validated(ReplaySettings, fields))


if __name__ == "__main__":
    main(_create)
