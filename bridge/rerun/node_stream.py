"""The messages of one node: its episodes, events, controllers and faults."""

from __future__ import annotations

import time
from collections.abc import Iterable
from datetime import datetime, timedelta

import numpy as np
import rerun as rr

from bridge.display.roles import roles
from bridge.rerun.episode import EpisodeView, NodeModel
from bridge.rerun.layout import EVENTS
from bridge.rerun.meshes import building_model
from bridge.rerun.recording import SIMULATED, STEP, entity_path
from bridge.rerun.samples import ComfortFactory, RewardFactory
from bridge.rerun.summary import NodeNumbers, NodeStatus
from topics.errors import BadMessage, InvalidConfig
from topics.messages import AlarmState, Event, EventKind, Geometry, Manifest, Sample

_WARNINGS = (
    EventKind.FAILED, EventKind.REJECTED, EventKind.LATE, EventKind.ACCEPTED_LATE, EventKind.WARNING, EventKind.FAULT,
    EventKind.FALLBACK,
)  # fmt: skip
_BEGINS, _ENDS = " begins", " ends"
_FAULTS_SET = "faults are set: "


class NodeStream:
    """Logs the messages of one node.

    Args:
        recording: where to log.
        manifest: of the node.
        geometry: of its building, if it has one.
        comfort, reward: as of `RerunStream`.

    Attributes:
        model: what all episodes share.
        view: the running episode; None before the first sample.
        samples: those that are not logged yet.
        logged_s: monotonic time of the last logging.
        missed: number of samples that were lost.
        is_connected: whether the node is on the bus.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        manifest: Manifest,
        geometry: Geometry | None,
        comfort: ComfortFactory,
        reward: RewardFactory | None,
    ) -> None:
        self._recording, self._geometry = recording, geometry
        self._comfort, self._reward = comfort, reward
        self.model = self._model(manifest)
        self.view: EpisodeView | None = None
        self.samples: list[Sample] = []
        self.logged_s = time.monotonic()
        self.missed = 0
        self._faults: dict[str, None] = {}
        self.is_connected = True
        self._controllers: dict[str, None] = {}
        self._status, self._statuses = NodeStatus(), list[NodeStatus]()  # now, and at each of `samples`
        self._episode = self._step = -1
        self._queried: tuple[int, int] | None = None  # position of a queried sample; later batches may have older ones
        self._is_layout_changed = True
        self._is_drawn = True

    def _model(self, manifest: Manifest) -> NodeModel:
        its_roles = roles(manifest)
        building = None
        if self._geometry is not None:
            try:
                building = building_model(self._geometry, [zone.key for zone in its_roles.zones])
            except BadMessage:
                self._geometry = None
        return NodeModel(manifest, its_roles, self._comfort(manifest), self._geometry, building)

    def set_manifest(self, manifest: Manifest) -> None:
        """Take a new manifest, as after faults were set; the next sample begins new plots if points differ."""
        self.flush()
        before, self._queried = self.model.manifest, None
        self.model = self._model(manifest)
        if before.points != manifest.points or before.actuators != manifest.actuators:
            self._episode = -1

    def set_controller(self, name: str, *, is_connected: bool) -> None:
        """Record a controller's connection or disconnection."""
        if is_connected:
            self._controllers[name] = None
        else:
            self._controllers.pop(name, None)
        self._update_status()

    def set_faults(self, names: Iterable[str]) -> None:
        """Record the injected faults that are active."""
        self._faults = dict.fromkeys(names)
        self._update_status()

    def add_sample(self, sample: Sample, *, queried: bool = False) -> int:
        """Gather a sample; return 1, or 0 if it is not new."""
        position = (sample.episode[0], sample.step[0])
        if queried:
            self._queried = position
        elif self._queried is not None:
            if position <= self._queried:
                return 0  # not newer than the queried sample
            self._queried = None
        if sample.episode[0] != self._episode:
            self._begin_episode(sample.episode[0])
        elif sample.step[0] <= self._step:
            return 0  # both received and queried
        else:
            self.missed += sample.step[0] - self._step - 1
        self._step = sample.step[0]
        self.samples.append(sample)
        self._statuses.append(self._status)
        return 1

    def _begin_episode(self, episode: int) -> None:
        self.flush()
        self.draw()
        self._episode, self._step = episode, -1
        reward = None
        if self._reward is not None:
            try:
                reward = self._reward(self.model.manifest)
            except InvalidConfig:  # the node lacks the points
                self._reward = None
        self.view = EpisodeView(self._recording, self.model, episode, reward)
        self._is_layout_changed = True

    def _update_status(self) -> None:
        self._status = NodeStatus(tuple(self._controllers), tuple(self._faults))

    def numbers(self) -> NodeNumbers:
        """Return the latest numbers."""
        numbers = self.view.numbers if self.view is not None else NodeNumbers()
        numbers.controllers, numbers.faults = self._status
        return numbers

    def flush(self) -> None:
        """Log the gathered samples."""
        self.logged_s = time.monotonic()
        samples, self.samples = self.samples, []
        statuses, self._statuses = self._statuses, []
        if samples and self.view is not None:
            had_reward = self.view.reward is not None
            self.view.add(samples, statuses)
            self._is_layout_changed |= (self.view.reward is not None) != had_reward
            self._is_drawn = False

    def draw(self) -> None:
        """Log what is drawn as a whole, if there are new samples."""
        if self.view is not None and not self._is_drawn:
            self.view.draw()
            self._is_drawn = True

    def take_layout_change(self) -> bool:
        """Return whether the layout must be sent again, once."""
        is_changed, self._is_layout_changed = self._is_layout_changed, False
        return is_changed

    def add_event(self, event: Event) -> None:
        """Log an event at its step and simulated time."""
        if event.kind == EventKind.FAULT:
            self._on_fault(event.text)
        is_alarm = event.alarm is not None and event.alarm.state is AlarmState.ACTIVE
        level = "WARN" if is_alarm or event.kind in _WARNINGS else "INFO"
        text = f"{event.kind.replace('_', ' ')}: {event.text}" + (f" ({event.source})" if event.source else "")
        manifest = self.model.manifest
        moment = datetime.fromisoformat(manifest.begin) + event.step * timedelta(seconds=manifest.step_s)
        text = f"{moment.day} {moment:%b %H:%M}  {text}"
        rr.send_columns(
            entity_path(manifest.node, EVENTS),
            [
                rr.TimeColumn(SIMULATED, timestamp=[np.datetime64(moment, "ns")]),
                rr.TimeColumn(STEP, sequence=[event.step]),
            ],
            rr.TextLog.columns(text=[text], level=[level]),
            recording=self._recording,
        )

    def _on_fault(self, text: str) -> None:
        if text.startswith(_FAULTS_SET):
            self._faults.clear()
        elif text.endswith(_BEGINS):
            self._faults[text.removesuffix(_BEGINS)] = None
        elif text.endswith(_ENDS):
            self._faults.pop(text.removesuffix(_ENDS), None)
        self._update_status()
