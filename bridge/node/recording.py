"""The recording of a node: start, stop, and the records that let a plant repeat its episodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zenostat.bridge.node.manifest import located_geometry
from zenostat.bridge.node.plant import Plant, RepeatablePlant, WeatherTable
from zenostat.bridge.recording.channels import EPISODES, MANIFESTS, SNAPSHOTS, STATES, WEATHER
from zenostat.topics import keys
from zenostat.topics.errors import InvalidConfig, RequestRejected, ZenostatError
from zenostat.topics.messages import (
    EventKind,
    Message,
    OnFull,
    RecordingState,
    RecordingStatus,
    StartRecording,
    StopRecording,
)
from zenostat.topics.recording import WEATHER_COLUMNS, RecordedEpisode, RecordedSnapshot, RecordedState, RecordedWeather

if TYPE_CHECKING:
    from zenostat.bridge.node.server import NodeServer
    from zenostat.bridge.recording.complete_part import Written
    from zenostat.bridge.recording.recorder import Attachments, Recorder


class RecordingManager:
    """The recordings of a node, one at a time. Its methods are for the server's thread, unless noted.

    Args:
        server: the node on the bus.
        plant: that it simulates.
        cpus: cores of the thread that writes; empty leaves it to the system.
    """

    def __init__(self, server: NodeServer, plant: Plant, *, cpus: tuple[int, ...] = ()) -> None:
        self._server, self._plant, self._cpus = server, plant, cpus
        self._recorder: Recorder | None = None
        self._created: Recorder | None = None
        self._status: Callable[[], RecordingStatus] | None = None
        self._armed: StartRecording | None = None
        self._weather: tuple[str, WeatherTable] | None = None

    def declare(self) -> None:
        """Answer requests about recordings."""
        subscriptions = self._server.subscriptions
        subscriptions.request(keys.RECORD, StartRecording, self._start)
        subscriptions.request(keys.STOP_RECORDING, StopRecording, self._stop)

    def status(self) -> RecordingStatus | None:
        """Return the status of the present or the latest recording; thread-safe."""
        status = self._status
        return None if status is None else status()

    # Start and stop

    def start(self, path: Path, *, overwrite: bool = False, on_full: OnFull = OnFull.WAIT, source: str = "") -> None:
        """Record from now on.

        Raises:
            InvalidConfig: the file exists, or cannot be created; or the libraries are missing.
        """
        from zenostat.bridge.recording.file import open_recording  # few nodes record
        from zenostat.bridge.recording.recorder import attachments

        manifest, description, geometry = self._server.manifest, self._plant.description, located_geometry(self._plant)
        descriptor = open_recording(path, overwrite=overwrite)
        self._record(descriptor, path, lambda: attachments(manifest, description, geometry), on_full)
        self._publish(f"recording to {path}", source)

    def go_on(self, descriptor: int, written: Written, *, on_full: OnFull = OnFull.WAIT) -> None:
        """Append to a recording from now on; the recorder closes the descriptor."""
        self._record(descriptor, written.path, dict, on_full, written)

    def _record(
        self, descriptor: int, path: Path, contents: Attachments, on_full: OnFull, written: Written | None = None
    ) -> None:
        from zenostat.bridge.recording.recorder import Recorder

        server = self._server
        recorder = Recorder(
            descriptor,
            path,
            server.manifest.node,
            contents,
            on_full=on_full,
            on_stopped=lambda reason: server.subscriptions.post(lambda: self._on_stopped(recorder, reason)),
            cpus=self._cpus,
            written=written,
        )
        recorder.is_ending = lambda: server.stopping
        recorder.record(MANIFESTS, server.manifest)
        self._recorder, self._created, self._status = recorder, recorder, recorder.status
        server.record(recorder)

    def _start(self, request: StartRecording) -> Message:
        from zenostat.bridge.recording.file import check_library, check_path, recording_path

        if (status := self.status()) is not None and status.state in (RecordingState.ARMED, RecordingState.RECORDING):
            raise RequestRejected(f"the node is recording to {status.path}; stop that recording first")
        record = Path(request.path)
        if not record.is_absolute():
            raise RequestRejected(f"{request.path!r} is relative; the node needs an absolute path on its machine")
        if not record.parent.is_dir():  # a mistyped path shall not create folders
            raise RequestRejected(f"cannot record to {record}: the node's machine has no folder {record.parent}")
        check_library()
        path = recording_path(record, self._server.manifest.node)
        check_path(path, overwrite=request.overwrite)
        if request.now:
            self.start(path, overwrite=request.overwrite, on_full=request.on_full, source=request.source)
        else:
            self._arm(path, request)
        status = self.status()
        assert status is not None
        return status

    def _arm(self, path: Path, request: StartRecording) -> None:
        self._armed = request.model_copy(update={"path": str(path)})
        armed = RecordingStatus(path=str(path), state=RecordingState.ARMED)
        self._status = lambda: armed
        self._publish(f"the next reset of all slots begins a recording to {path}", request.source)

    def _stop(self, request: StopRecording) -> Message:
        status = self.status()
        if status is None or status.state not in (RecordingState.ARMED, RecordingState.RECORDING):
            raise RequestRejected("the node is not recording")
        if self._armed is not None:
            self._armed = None
            ended = status.model_copy(update={"state": RecordingState.ENDED})
            self._status = lambda: ended
            return ended
        self._publish(f"the recording to {status.path} ends", request.source)
        self.close()
        status = self.status()
        assert status is not None
        return status

    def close(self) -> None:
        """Complete the file, if the node is recording; idempotent."""
        if self._recorder is not None:
            self._recorder = None
            self._server.record(None)
        if self._created is not None:
            self._created.close()

    def _on_stopped(self, recorder: Recorder, reason: str) -> None:
        if recorder is self._recorder:
            self._recorder = None
            self._server.record(None)
            self._publish(f"the recording to {recorder.path} stopped: {reason}", "")

    def _publish(self, text: str, source: str) -> None:
        server = self._server
        server.event(server.exchange.event(EventKind.RECORDING, text, source))

    # Records

    def begin_episodes(
        self, steps: Mapping[int, int], seeds: Sequence[int | None], source: str, snapshot: str = ""
    ) -> None:
        """Record the start of episodes, before their first sample is published.

        Args:
            steps: the first sample of each slot.
            seeds: of these slots.
            source: the controller that asked for the reset.
            snapshot: the name of the snapshot that the node returned to.
        """
        armed = self._armed
        if armed is not None and not snapshot and len(steps) == self._server.manifest.slots:
            self._start_armed(armed)
        if self._recorder is None:
            return
        plant, slots = self._plant, [*steps]
        if not snapshot and len(slots) == self._server.manifest.slots:
            self._recorder.record(STATES, self._state())
        self._recorder.record(
            EPISODES,
            RecordedEpisode(
                slots=slots,
                episode=[self._server.exchange.episode[slot] for slot in slots],
                step=[*steps.values()],
                seeds=[*seeds],
                weather=[plant.site(slot).weather for slot in slots],
                inputs=[plant.episode_inputs(slot) for slot in slots] if isinstance(plant, RepeatablePlant) else [],
                snapshot=snapshot,
                source=source,
            ),
        )
        for slot in slots:
            self._record_weather(slot)

    def _state(self) -> RecordedState:
        """Return what the node has besides its plant."""
        server = self._server
        injection, alarms = server.injection, server.alarms
        return RecordedState(
            claims=server.exchange.claims.messages(),
            mode=server.exchange.mode,
            speed=server.pacing.speed,
            paused=server.pacing.paused,
            alarms=None if alarms is None else alarms.rules.model_dump(mode="json", exclude_unset=True),
            faults=None if injection is None else injection.plan,
            fault_episodes=[] if injection is None else injection.episodes,
        )

    def _record_weather(self, slot: int) -> None:
        """Record the weather of an episode; reading its file takes 0.1 s, so the same weather is read once."""
        plant, recorder = self._plant, self._recorder
        inputs = f"{plant.episode_inputs(slot)}" if isinstance(plant, RepeatablePlant) else ""
        if not inputs or self._weather is None or self._weather[0] != inputs:
            try:
                self._weather = inputs, plant.weather(slot, WEATHER_COLUMNS)
            except ZenostatError:  # the plant has no weather, or other columns
                return
        columns, units, step_s, values = self._weather[1]
        run_period = plant.description.run_period
        rows = max(round(run_period.steps * run_period.step_s / step_s), 1)
        assert recorder is not None
        recorder.record(
            WEATHER,
            RecordedWeather(
                slot=slot,
                episode=self._server.exchange.episode[slot],
                columns=columns,
                units=units,
                step_s=step_s,
                values=np.ascontiguousarray(values[:rows], "<f8").tobytes(),
            ),
        )

    def snapshot(self, name: str, episode: list[int], step: list[int]) -> None:
        """Record that a snapshot was taken."""
        if self._recorder is not None:
            self._recorder.record(SNAPSHOTS, RecordedSnapshot(snapshot=name, episode=episode, step=step))

    def _start_armed(self, request: StartRecording) -> None:
        self._armed = None
        try:
            self.start(Path(request.path), overwrite=request.overwrite, on_full=request.on_full, source=request.source)
        except InvalidConfig as error:
            stopped = RecordingStatus(path=request.path, state=RecordingState.STOPPED, reason=str(error))
            self._status = lambda: stopped
            self._publish(f"the recording to {request.path} stopped: {error}", request.source)
