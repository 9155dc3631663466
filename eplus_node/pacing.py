"""When a runner's next timestep begins, as far as the clock or a person has a say: pace, pauses, steps, deadlines."""

from __future__ import annotations

import sched
from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING

from bridge.exchange.step_schedule import StepSchedule
from topics import keys
from topics.errors import EpisodeAborted, RequestRejected
from topics.messages import Ack, EventKind, Message, Mode, Pause, Resume, SetPace, State, StepRequest

if TYPE_CHECKING:
    from eplus_node.server import NodeServer

_PACED = Mode.PACED


class Pacing:
    """The clock's part of a runner, whose thread calls everything here.

    Attributes:
        pace: the schedule of mode `paced`.
        paused: whether it stands still, but for `steps_left` timesteps.
        steps_left: timesteps to go while it is paused.
    """

    def __init__(self, runner: NodeServer) -> None:
        self._runner = runner
        self.pace = StepSchedule(runner.plan.period.step_s, runner.manifest.speed)
        self.paused = False
        self.steps_left = 0
        self._timesteps = 0  # of all episodes and slots: what the schedule counts
        self._into_s = 0.0  # of the timestep in which it was paused
        self._overdue_at_s = 0.0
        self._alarm: sched.Event | None = None

    def declare(self) -> None:
        """Answers what is asked for on the bus."""
        inlets = self._runner.inlets
        inlets.request(keys.PACE, SetPace, self._set_pace)
        inlets.request(keys.PAUSE, Pause, self._pause)
        inlets.request(keys.RESUME, Resume, self._resume)
        inlets.request(keys.STEP, StepRequest, self._go_steps)

    # A timestep

    def may_step(self) -> bool:
        """Whether the next timestep is due by the clock; if not, the runner's thread is woken when it is."""
        if self._stands:
            return False
        if self._runner.exchange.mode is not _PACED or self.steps_left:
            return True
        due_s = self.pace.due_s(self._timesteps + 1)
        if monotonic() >= due_s:
            return True
        self._call_at(due_s, self._runner.inlets.notify)
        return False

    def step_started(self) -> None:
        """A timestep begins."""
        if self._alarm is not None:
            self.cancel()
        if self.steps_left:
            self.steps_left, self._into_s = self.steps_left - 1, 0.0

    def record_sample(self, now_s: float) -> None:
        """Its sample has come."""
        self._timesteps += 1
        if self._runner.exchange.mode is not _PACED or self.paused:
            return
        if self.pace.record_sample(now_s, self._timesteps):
            self._overran()

    def begin(self) -> None:
        """An episode begins at the sample that is published next: the schedule begins there, too."""
        self._into_s, self.steps_left = 0.0, 0
        self.pace.rebase(monotonic(), self._timesteps)

    def wait(self, now_s: float) -> None:
        """From now on the present step waits no longer than it may; not while the node stands still."""
        exchange = self._runner.exchange
        deadline_s = exchange.deadline_s
        if deadline_s is not None and exchange.mode is Mode.LOCKSTEP and not self._stands:
            self._overdue_at_s = now_s + deadline_s
            self._call_at(self._overdue_at_s, lambda: self._runner.inlets.post(self._overdue))

    def cancel(self) -> None:
        """Nothing is to be done later any more."""
        alarm, self._alarm = self._alarm, None
        if alarm is not None:
            self._runner.timer.cancel(alarm)

    @property
    def _stands(self) -> bool:
        """Whether it stands still because somebody said so."""
        return self.paused and not self.steps_left

    def _call_at(self, due_s: float, call: Callable[[], None]) -> None:
        """Has the timer's thread do something later, in place of what it was to do later."""
        self.cancel()
        self._alarm = self._runner.timer.at(due_s, call)

    def _overdue(self) -> None:
        # It may come from the shelf after its step has gone on; the present one has a later deadline then.
        runner = self._runner
        if self._stands or runner.exchange.mode is not Mode.LOCKSTEP or monotonic() < self._overdue_at_s:
            return
        try:
            runner.publish_events(runner.exchange.on_deadline())
        except EpisodeAborted as error:
            runner.fail(error)

    def _overran(self) -> None:
        pace, exchange = self.pace, self._runner.exchange
        if pace.overruns & (pace.overruns - 1) == 0:  # the first, the second, the fourth…: the count is in the status
            at_worst = f"{pace.max_lag_s:.3g} s at worst"
            text = f"overrun {pace.overruns}: the sample of step {exchange.step[0]} came late, {at_worst}"
            self._runner.event(exchange.event(EventKind.PACE, text))

    # Requests

    def _set_pace(self, asked: SetPace) -> Message:
        if (asked.speed is not None) is not (asked.mode is Mode.PACED):
            raise RequestRejected("a speed and the mode 'paced' go together; the other modes have none")
        runner = self._runner
        mode, speed, now_s = asked.mode, asked.speed or runner.manifest.speed, monotonic()
        self.cancel()
        self._into_s = self._went_s(now_s)
        runner.exchange.mode, self.pace.speed = mode, speed
        self.pace.rebase(now_s, self._timesteps, self._into_s)
        self.wait(now_s)
        runner.manifest = runner.manifest.model_copy(update={"mode": mode, "speed": speed})
        runner.outlets.manifest(runner.manifest)
        return self._told(f"{speed:g} times the wall clock" if mode is Mode.PACED else str(mode), asked.source)

    def _went_s(self, now_s: float) -> float:
        """How far the present timestep has gone by the clock, in simulated seconds."""
        if self.paused:
            return self._into_s
        return self.pace.elapsed_in_step_s(now_s, self._timesteps) if self._runner.exchange.mode is Mode.PACED else 0.0

    def _pause(self, asked: Pause) -> Message:
        self._into_s = self._went_s(monotonic())
        self.paused, self.steps_left = True, 0
        self.cancel()
        return self._told("paused", asked.source)

    def _resume(self, asked: Resume) -> Message:
        if self.paused:
            now_s = monotonic()
            self.paused, self.steps_left = False, 0
            self.pace.rebase(now_s, self._timesteps, self._into_s)
            self.wait(now_s)
        return self._told("goes on", asked.source)

    def _go_steps(self, asked: StepRequest) -> Message:
        if not self.paused:
            raise RequestRejected("the node is not paused; pause it first")
        if self._runner.exchange.state in (State.ENDED, State.FAILED):
            raise RequestRejected("the episode is over; reset it first")
        self.steps_left += asked.steps
        self.wait(monotonic())
        return self._told(f"timesteps to go: {self.steps_left}", asked.source)

    def _told(self, text: str, source: str) -> Message:
        runner = self._runner
        runner.event(runner.exchange.event(EventKind.PACE, text, source))
        return Ack(episode=runner.exchange.episode)
