"""Requests about the recording of a node."""

from __future__ import annotations

from pathlib import Path

from zenostat.bridge.client.requests import Requests, build
from zenostat.topics import keys
from zenostat.topics.messages import OnFull, RecordingStatus, StartRecording, StopRecording


class RecordingRequests(Requests):
    """Base class of `Bus`: requests about the recording of a node."""

    def record(
        self,
        node: str,
        path: str | Path,
        *,
        now: bool = False,
        overwrite: bool = False,
        on_full: OnFull | str = OnFull.WAIT,
        source: str = "",
    ) -> RecordingStatus:
        """Let a node record everything to a file on its machine, from the next reset of all slots; return its state.

        Args:
            node: The node's name.
            path: Absolute path of a file with the suffix `.mcap`, or of a folder, on the node's machine.
            now: Begin at once; what is before the next reset cannot be verified.
            overwrite: Replace a recording at that path.
            on_full: If the disk is slower than the node, `wait` for it, or `stop` the recording.
            source: Name of the requester, for the event that reports it.

        Raises:
            InvalidConfig: The file exists or cannot be created, or `on_full` is neither.
            RequestRejected: The node is recording already, or the path is relative.
        """
        request = build(StartRecording, path=str(path), now=now, overwrite=overwrite, on_full=on_full, source=source)
        return self._ask(keys.RECORD, node, request, RecordingStatus)

    def stop_recording(self, node: str, *, source: str = "") -> RecordingStatus:
        """End a node's recording; return its state once the file is complete.

        Raises:
            RequestRejected: The node is not recording.
        """
        return self._ask(keys.STOP_RECORDING, node, StopRecording(source=source), RecordingStatus)
