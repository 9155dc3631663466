"""The messages of one node: its episodes, events, alarms and faults."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import datetime
from itertools import groupby
from typing import NamedTuple

import numpy as np
import rerun as rr

from zenostat.metrics.roles import roles
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import BadMessage, InvalidConfig
from zenostat.topics.messages import AlarmChange, AlarmState, Event, EventKind, Geometry, Manifest, Sample
from zenostat.views.live.episode import EpisodeView, NodeModel
from zenostat.views.live.layout import EVENTS
from zenostat.views.live.meshes import building_model
from zenostat.views.live.recording import EpisodeLog, episode_path
from zenostat.views.live.samples import ComfortFactory, RewardFactory
from zenostat.views.live.summary import NodeNumbers, NodeStatus

_WARNINGS = (
    EventKind.FAILED, EventKind.REJECTED, EventKind.LATE, EventKind.ACCEPTED_LATE, EventKind.WARNING, EventKind.FAULT,
    EventKind.FALLBACK,
)  # fmt: skip
_BEGINS, _ENDS = " begins", " ends"
_FAULTS_SET = "faults are set: "
PRESENT = (AlarmState.ACTIVE, AlarmState.ACKNOWLEDGED)
"""States of an alarm whose condition is present."""

HistoryReader = Callable[[Manifest, int, int], tuple[int, Floats] | None]
"""Return the samples of an episode up to a step: the first step, and a table of shape (n, points + actuators)."""

StatusReader = Callable[[Manifest], NodeStatus]
"""Return the alarms and faults of a node at its latest sample."""


class _LoggedEvent(NamedTuple):
    episode: int
    step: int
    moment: datetime
    text: str
    level: str


class NodeStream:
    """Logs the messages of one node.

    Args:
        recording: where to log.
        manifest: of the node.
        geometry: of its building, if it has one.
        comfort, reward: as of `RerunStream`.
        history: reads the samples that precede the first one of an episode; by default they count as missed.
        status: reads the alarms and faults that go on without an event: before the first one, and from a snapshot.
        run: number of the node among those of its name that the recording has, from 1.

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
        history: HistoryReader | None = None,
        status: StatusReader | None = None,
        run: int = 1,
    ) -> None:
        self._recording, self._geometry = recording, geometry
        self._comfort, self._reward, self._history, self._read_status = comfort, reward, history, status
        self._run = run
        self.model = self._model(manifest)
        self.view: EpisodeView | None = None
        self.samples: list[Sample] = []
        self._events: list[_LoggedEvent] = []
        self.logged_s = time.monotonic()
        self.missed = 0
        self.is_connected = True
        self._alarms: dict[str, None] = {}
        self._faults: dict[str, None] = {}
        self._status, self._statuses = NodeStatus(), list[NodeStatus]()  # now, and at each of `samples`
        self._set_status(NodeStatus() if status is None else status(manifest))
        self._episode = self._step = -1
        self._first_steps: dict[int, int] = {}  # of the latest episode whose start was announced
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
        return NodeModel(manifest, its_roles, self._comfort(manifest), self._geometry, building, self._run)

    def set_manifest(self, manifest: Manifest) -> None:
        """Take a new manifest, as after faults were set; plots begin anew if points differ."""
        self.flush()
        before, self._queried = self.model.manifest, None
        self.model = self._model(manifest)
        if self.view is not None and (before.points != manifest.points or before.actuators != manifest.actuators):
            self._begin_view()

    def add_sample(self, sample: Sample, *, queried: bool = False) -> int:
        """Gather a sample; return the number of new samples, with those of the history that precede it."""
        position = (sample.episode[0], sample.step[0])
        if queried:
            self._queried = position
        elif self._queried is not None:
            if position <= self._queried:
                return 0  # not newer than the queried sample
            self._queried = None
        count = 1
        if sample.episode[0] != self._episode:
            count += self._begin_episode(*position)
        elif sample.step[0] <= self._step:
            return 0  # both received and queried
        else:
            self.missed += sample.step[0] - self._step - 1
        self._step = sample.step[0]
        self.samples.append(sample)
        self._statuses.append(self._status)
        return count

    def _begin_episode(self, episode: int, step: int) -> int:
        """Begin the views of an episode whose first sample is at `step`; return the number of earlier samples."""
        self.flush()
        self.draw()
        manifest = self.model.manifest
        # An episode that goes on from a snapshot, or in a branch, does not begin at step 0.
        first = self._first_steps.get(episode, step if manifest.branch_of else 0)
        if self._episode != -1:
            if first > 0 and self._read_status is not None:
                self._set_status(self._read_status(manifest))
            else:
                self._set_status(NodeStatus((), tuple(self._faults)))  # the node clears alarms
        self._episode = episode
        view = self._begin_view()
        known = self._history(manifest, episode, step - 1) if self._history and step > first else None
        if known is None:
            self.missed += max(0, step - first)
            return 0
        oldest, table = known
        if episode not in self._first_steps and len(table) + 1 < manifest.history_samples:
            first = oldest  # nothing has been replaced yet
        view.add_history(oldest, table)
        self.missed += max(0, oldest - first)
        return len(table)

    def _begin_view(self) -> EpisodeView:
        reward = None
        if self._reward is not None:
            try:
                reward = self._reward(self.model.manifest)
            except InvalidConfig:  # the node lacks the points
                self._reward = None
        self.view = EpisodeView(self._recording, self.model, self._episode, reward)
        self._is_layout_changed = True
        return self.view

    def _set_status(self, status: NodeStatus) -> None:
        self._status = status
        self._alarms, self._faults = dict.fromkeys(status.alarms), dict.fromkeys(status.faults)

    def _update_status(self, step: int) -> None:
        """Take a new status from a step on; the event of a step may come after its sample."""
        self._status = NodeStatus(tuple(self._alarms), tuple(self._faults))
        for index, sample in enumerate(self.samples):
            if sample.step[0] >= step:
                self._statuses[index] = self._status
        if self.view is not None and not self.samples and step <= self._step:
            self.view.set_status(self._status)

    def numbers(self) -> NodeNumbers:
        """Return the latest numbers."""
        numbers = self.view.numbers if self.view is not None else NodeNumbers()
        numbers.alarms, numbers.faults = self._status
        return numbers

    def flush(self) -> None:
        """Log the gathered samples and events."""
        self.logged_s = time.monotonic()
        self._log_events()
        samples, self.samples = self.samples, []
        statuses, self._statuses = self._statuses, []
        if samples and self.view is not None:
            had_reward = self.view.reward is not None
            self.view.add(samples, statuses)
            self._is_layout_changed |= (self.view.reward is not None) != had_reward
            self._is_drawn = False

    def _log_events(self) -> None:
        manifest = self.model.manifest
        events, self._events = self._events, []
        for episode, group in groupby(events, key=lambda event: event.episode):
            logged = [*group]
            log = EpisodeLog(self._recording, episode_path(manifest.node, episode, self._run), manifest.begin)
            times = np.array([event.moment for event in logged], "M8[ns]")
            steps = np.array([event.step for event in logged])
            texts, levels = [event.text for event in logged], [event.level for event in logged]
            log.columns_at(EVENTS, times, steps, rr.TextLog.columns(text=texts, level=levels))

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
        """Gather an event for its episode, step and simulated time; `BadMessage` if there is no such time."""
        manifest = self.model.manifest
        moment = manifest.time_at(event.step)
        if event.kind == EventKind.STARTED:
            self._first_steps = {event.episode: event.step}
        elif event.kind == EventKind.FAULT:
            self._on_fault(event)
        elif event.alarm is not None:
            if event.alarm.slot != 0:
                return  # only the first slot is shown
            self._on_alarm(event.alarm, event.step)
        is_alarm = event.alarm is not None and event.alarm.state is AlarmState.ACTIVE
        level = "WARN" if is_alarm or event.kind in _WARNINGS else "INFO"
        text = f"{event.kind.replace('_', ' ')}: {event.text}" + (f" ({event.source})" if event.source else "")
        text = f"{moment.day} {moment:%b %H:%M}  {text}"
        self._events.append(_LoggedEvent(event.episode, event.step, moment, text, level))

    def _on_alarm(self, change: AlarmChange, step: int) -> None:
        if change.state in PRESENT:
            self._alarms[change.alarm] = None
        else:
            self._alarms.pop(change.alarm, None)
        self._update_status(step)

    def _on_fault(self, event: Event) -> None:
        text = event.text
        if text.startswith(_FAULTS_SET):
            names = f", {text.removeprefix(_FAULTS_SET)}, "  # one that is in both plans goes on without an event
            self._faults = {name: None for name in self._faults if f", {name}, " in names}
        elif text.endswith(_BEGINS):
            self._faults[text.removesuffix(_BEGINS)] = None
        elif text.endswith(_ENDS):
            self._faults.pop(text.removesuffix(_ENDS), None)
        self._update_status(event.step)
