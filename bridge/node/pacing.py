"""Times at which a node server's next timestep may begin: pace, pauses, single steps and deadlines."""

from __future__ import annotations

import sched
from collections.abc import Callable
from time import monotonic

from zenostat.bridge.exchange.step_schedule import StepSchedule
from zenostat.bridge.node.served_node import ServedNode
from zenostat.topics import keys
from zenostat.topics.errors import EpisodeAborted, RequestRejected
from zenostat.topics.messages import Ack, EventKind, Message, Mode, Pause, Resume, SetPace, State, StepRequest

_PACED = Mode.PACED

_SUSPENDED_S = 0.5
"""A deadline that is noticed this much later means that the node's process has been suspended."""


class Pacing:
    """Pace, pauses and deadlines of one server; for its thread.

    Attributes:
        pace: the schedule in mode `paced`.
        paused: whether it is paused, except for `steps_left` timesteps.
        steps_left: timesteps that remain to be begun while paused.
    """

    def __init__(self, server: ServedNode) -> None:
        self._server = server
        self.pace = StepSchedule(server.plant.description.run_period.step_s, server.manifest.speed)
        self.paused = False
        self.steps_left = 0
        self._timesteps = 0  # since the start, of all episodes; the schedule counts them
        self._step_elapsed_s = 0.0  # elapsed in the timestep in which it was paused
        self._deadline_at_s = 0.0
        self._timer_event: sched.Event | None = None

    @property
    def speed(self) -> float:
        """Simulated time per wall-clock time in mode `paced`."""
        return self.pace.speed

    @property
    def unfinished_steps(self) -> int:
        """Timesteps that were requested while paused and are not simulated yet, with the present one; thread-safe."""
        exchange = self._server.exchange
        if not self.paused or exchange.state in (State.ENDED, State.FAILED):
            return 0
        return self.steps_left + (exchange.state is State.RUNNING)

    def declare(self) -> None:
        """Answer requests on pace, pauses and steps."""
        subscriptions = self._server.subscriptions
        subscriptions.request(keys.PACE, SetPace, self._set_pace)
        subscriptions.request(keys.PAUSE, Pause, self._pause)
        subscriptions.request(keys.RESUME, Resume, self._resume)
        subscriptions.request(keys.STEP, StepRequest, self._step)

    # A timestep

    def may_step(self) -> bool:
        """Return whether the next timestep is due; if it is not, the server's thread is woken when it is."""
        if self._is_stopped:
            return False
        if self._server.exchange.mode is not _PACED or self.steps_left:
            return True
        due_s = self.pace.due_s(self._timesteps + 1)
        if monotonic() >= due_s:
            return True
        self._call_at(due_s, self._server.subscriptions.notify)
        return False

    def step_started(self) -> None:
        """Record that a timestep begins."""
        if self._timer_event is not None:
            self.cancel()
        if self.steps_left:
            self.steps_left, self._step_elapsed_s = self.steps_left - 1, 0.0

    def record_sample(self, now_s: float) -> None:
        """Record that the sample of the timestep is published."""
        self._timesteps += 1
        if self._server.exchange.mode is not _PACED or self.paused:
            return
        if self.pace.record_sample(now_s, self._timesteps):
            self._publish_overrun()

    def begin(self) -> None:
        """Begin the schedule of an episode at the sample that is published next."""
        self._step_elapsed_s, self.steps_left = 0.0, 0
        self.pace.rebase(monotonic(), self._timesteps)

    def apply(self, request: SetPace | Pause | Resume | StepRequest) -> None:
        """Set what a request sets, apart from the schedule, which `begin` or `resume_at` begins."""
        match request:
            case SetPace():
                self.pace.speed = request.speed or self._server.manifest.speed
                self._server.set_mode(request.mode, self.pace.speed)
            case Pause() | Resume():
                self.paused, self.steps_left = isinstance(request, Pause), 0
            case StepRequest():
                self.steps_left += request.steps

    def resume_at(self, now_s: float) -> None:
        """Begin the schedule at the present sample of a node that goes on, and the deadline of its step."""
        self.pace.rebase(now_s, self._timesteps)
        self.wait(now_s)

    def wait(self, now_s: float) -> None:
        """Start the deadline of the present step, unless the node is paused."""
        exchange = self._server.exchange
        deadline_s = exchange.deadline_s
        if deadline_s is not None and exchange.mode is Mode.LOCKSTEP and not self._is_stopped:
            due_s = self._deadline_at_s = now_s + deadline_s

            def notice() -> None:
                late_s = monotonic() - due_s
                self._server.subscriptions.post(lambda: self._on_deadline(late_s))

            self._call_at(due_s, notice)

    def cancel(self) -> None:
        """Cancel the pending wake-up or deadline."""
        event, self._timer_event = self._timer_event, None
        if event is not None:
            self._server.timer.cancel(event)

    @property
    def _is_stopped(self) -> bool:
        """Whether it is paused and has no steps left."""
        return self.paused and not self.steps_left

    def _call_at(self, due_s: float, call: Callable[[], None]) -> None:
        """Let the timer call `call` at `due_s`; replaces the previous call."""
        self.cancel()
        self._timer_event = self._server.timer.at(due_s, call)

    def _on_deadline(self, late_s: float) -> None:
        # The task may run after its step has ended; the present step then has a later deadline.
        server, now_s = self._server, monotonic()
        if self._is_stopped or server.exchange.mode is not Mode.LOCKSTEP or now_s < self._deadline_at_s:
            return
        server.receive_commands()  # those that have arrived while the node was occupied, by a trial for instance
        if late_s >= _SUSPENDED_S and server.exchange.awaiting():  # they may be on their way
            text = f"the node was suspended for {late_s:.1f} s or more; the deadline of the step starts again"
            server.event(server.exchange.event(EventKind.WARNING, text))
            self.wait(now_s)
            return
        try:
            server.publish_events(server.exchange.fallback.on_deadline(now_s))
        except EpisodeAborted as error:
            server.fail(error)

    def _publish_overrun(self) -> None:
        pace, exchange = self.pace, self._server.exchange
        if pace.overruns & (pace.overruns - 1) == 0:  # the 1st, 2nd, 4th, 8th …; the status contains the count
            max_lag = f"at most {pace.max_lag_s:.3g} s so far"
            text = f"overrun {pace.overruns}: the sample of step {exchange.step[0]} was late, {max_lag}"
            self._server.event(exchange.event(EventKind.PACE, text))

    # Requests

    def _set_pace(self, request: SetPace) -> Message:
        if (request.speed is not None) is not (request.mode is Mode.PACED):
            raise RequestRejected("only the mode 'paced' has a speed, and needs one")
        server, mode, now_s = self._server, request.mode, monotonic()
        self.cancel()
        self._step_elapsed_s = self._elapsed_in_step_s(now_s)
        self.apply(request)
        self.pace.rebase(now_s, self._timesteps, self._step_elapsed_s)
        self.wait(now_s)
        server.publications.manifest(server.manifest)
        text = f"{self.speed:g} times the wall clock" if mode is Mode.PACED else str(mode)
        return self._publish(text, request.source)

    def _elapsed_in_step_s(self, now_s: float) -> float:
        """Return the simulated time elapsed in the present timestep according to the clock."""
        if self.paused:
            return self._step_elapsed_s
        return self.pace.elapsed_in_step_s(now_s, self._timesteps) if self._server.exchange.mode is Mode.PACED else 0.0

    def _pause(self, request: Pause) -> Message:
        self._step_elapsed_s = self._elapsed_in_step_s(monotonic())
        self.apply(request)
        self.cancel()
        return self._publish("paused", request.source)

    def _resume(self, request: Resume) -> Message:
        if self.paused:
            now_s = monotonic()
            self.apply(request)
            self.pace.rebase(now_s, self._timesteps, self._step_elapsed_s)
            self.wait(now_s)
        return self._publish("resumed", request.source)

    def _step(self, request: StepRequest) -> Message:
        if not self.paused:
            raise RequestRejected("the node is not paused; pause it first")
        if self._server.exchange.state in (State.ENDED, State.FAILED):
            raise RequestRejected("the episode is over; reset it first")
        self.apply(request)
        self.wait(monotonic())
        return self._publish(f"steps left: {self.steps_left}", request.source)

    def _publish(self, text: str, source: str) -> Message:
        server = self._server
        server.event(server.exchange.event(EventKind.PACE, text, source))
        return Ack(episode=server.exchange.episode)
