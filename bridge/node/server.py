"""A node server: connects an exchange (rules), a plant and Zenoh. Each node and each branch has one.

One thread does all the work of a server. It waits for a message, passes it to the exchange, and when the exchange is
ready, lets the plant simulate a timestep and publishes the sample. All other work (requests, writes, a signal, the
death of an engine) is posted to a task queue by the thread that receives it, which then wakes this one with a message
that never leaves the process.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np
import zenoh

from zenostat.bridge.exchange.intake import RATE_LIMITED
from zenostat.bridge.exchange.latency import LatencyWindow
from zenostat.bridge.exchange.revocation import revoke
from zenostat.bridge.exchange.step_exchange import StepExchange, Trigger
from zenostat.bridge.node.fault_injection import NO_FAULTS, FaultInjection, FaultState
from zenostat.bridge.node.history import History
from zenostat.bridge.node.pacing import Pacing
from zenostat.bridge.node.plant import RunningPlant, WaitingPlant, WarningPlant
from zenostat.bridge.node.publications import Publications
from zenostat.bridge.node.request_handlers import RequestHandlers
from zenostat.bridge.node.sample_encoding import SampleEncoder
from zenostat.bridge.node.subscriptions import COMMAND_QUEUE, Subscriptions
from zenostat.bridge.node.trials import TrialSteps
from zenostat.bridge.recording.channels import SAMPLES
from zenostat.bridge.runtime.timer import Timer
from zenostat.topics import codec, errors, keys
from zenostat.topics.client_protocol import ZENOH
from zenostat.topics.errors import EpisodeAborted, RequestRejected, SimulatorError
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import Event, EventKind, Manifest, Mode, Query, Sample, State, Statistics

if TYPE_CHECKING:
    from zenostat.bridge.alarms.monitor import AlarmMonitor, AlarmSnapshot
    from zenostat.bridge.node.access import Access
    from zenostat.bridge.recording.recorder import Recorder

# For the hot path: in Python 3.11, looking up an enum's member raises and catches an error.
_LOCKSTEP, _WAITING, _ENDED = Mode.LOCKSTEP, State.WAITING, State.ENDED

MAX_PLANT_WARNINGS = 20

Observer = Callable[["NodeServer"], None]


class Stopped(BaseException):
    """Raised in a server's thread by a signal or a stop request."""


class NodeServer:
    """A plant on the bus, under one name.

    Args:
        session: the node's Zenoh session.
        plant: waiting at its samples.
        manifest: the description to publish.
        exchange: at the plant's samples.
        observer: called after each sample and event.
        history: keeps each published sample; None keeps none.
        alarms: evaluated at each sample; None has none.
        folder: for the files of trials; the caller removes it.

    Attributes:
        access: permissions of senders; None without keys. Set it before `declare`.
        stopping: whether the server is about to end; errors of engines are then expected.
        on_stop: called by the thread that receives a stop request.
        stopped_by: the sender of the request that stopped the node; empty if it named none, or before.
        samples: encodes samples.
        trials: answers the requests for trials.
        latest_sample: the encoded latest sample.
        received: the actuator values that the plant received last, after faults; empty before the first timestep.
        on_event: called with each event.
        plant_warnings: the first distinct texts of the plant's warnings, as keys.
    """

    def __init__(
        self,
        session: zenoh.Session,
        plant: RunningPlant,
        manifest: Manifest,
        exchange: StepExchange,
        observer: Observer | None = None,
        history: History | None = None,
        alarms: AlarmMonitor | None = None,
        *,
        folder: Path,
    ) -> None:
        self.session, self.plant, self.manifest = session, plant, manifest
        self.plant_warnings: dict[str, None] = {}
        self._warnings = plant if isinstance(plant, WarningPlant) else None
        self._waiting = plant if isinstance(plant, WaitingPlant) else None
        if self._waiting is not None:
            self._waiting.on_waiting = self._warn
        self.exchange, self.history, self.alarms = exchange, history, alarms
        self._observer = observer
        self._close = ExitStack()
        self.timer = Timer()
        self.injection: FaultInjection | None = None
        self._recorder: Recorder | None = None
        self.pacing = Pacing(self)
        self.requests, self.trials = RequestHandlers(self), TrialSteps(self, folder / "trials")
        self.received = b""
        self._step_latency, self._cycle = LatencyWindow(), LatencyWindow()
        self._sampled_s = 0.0
        self.access: Access | None = None
        self.stopping = False
        self.on_event: Callable[[Event], None] | None = None
        self.on_stop = self.cancel_step
        self._stopped = False
        self.stopped_by = ""
        self.failure = self.failure_error = ""
        self.latest_sample = b""
        self.samples = SampleEncoder(plant, exchange)

    # On the bus

    def declare(self, status: Callable[[Query], bytes] | None = None) -> None:
        """Declare subscribers, queryables and publishers; `status` replaces the server's own."""
        self.subscriptions = self._close.enter_context(Subscriptions(self.session, self.manifest.node))
        self.subscriptions.access = self.access
        self.subscriptions.on_denied = lambda text, sender: self.event(self.exchange.rejected(text, sender))
        self.subscriptions.on_dropped = lambda text, sender: self.event(
            self.exchange.event(EventKind.REJECTED, text, sender)
        )
        self.subscriptions.on_error = self._on_error
        self.requests.declare(status)
        self.trials.declare()
        self.pacing.declare()
        self._close.callback(self.timer.close)
        self.publications = self._close.enter_context(Publications(self.session, self.manifest, self.timer))

    def announce(self) -> None:
        """Declare the server's presence, once everything else is declared."""
        token = keys.NODE_TOKEN.at(self.manifest.node, name=self.manifest.instance)
        self._close.enter_context(self.session.liveliness().declare_token(token))

    def record(self, recorder: Recorder | None) -> None:
        """Record all messages from now on; None ends that."""
        self._recorder = self.publications.recorder = self.subscriptions.recorder = recorder

    def close(self) -> None:
        """End the plant's simulators, leave the bus and close the plant; idempotent."""
        self.trials.collect(wait=True)
        self.plant.end(failed=self.exchange.state is State.FAILED)
        self._close.close()
        self.plant.close()

    # The loop

    def serve(self) -> None:
        """Serve until stopped."""
        try:
            while True:
                if self.exchange.ready_to_step() and self.pacing.may_step():
                    self.step()
                    if self.exchange.fallback_active or self.exchange.mode is not _LOCKSTEP:
                        self._receive_all()  # the next step waits for no command
                else:
                    self._receive(wait=True)
        except Stopped:
            self._stopped = True
            self.exchange.transition(Trigger.STOP)
            self.subscriptions.end()
            text = "the node was stopped by a request or a signal"
            self.event(self.exchange.event(EventKind.STOPPED, text, self.stopped_by))

    def stop_serving(self) -> None:
        """End the loop, in its own thread; a second call (a request, then the owner's end) has no effect."""
        if not self._stopped:
            self._stopped = True
            raise Stopped

    def receive_commands(self) -> None:
        """Receive the commands that have arrived, before the tasks that are pending."""
        for _ in range(COMMAND_QUEUE):
            if (received := self.subscriptions.try_receive()) is None:
                return
            self._receive_message(*received)

    def _receive_all(self) -> None:
        """Receive what arrived during a timestep; one message per step would let several controllers' pile up."""
        for _ in range(COMMAND_QUEUE):
            if not self._receive(wait=False):
                return

    def _receive(self, *, wait: bool) -> bool:
        """Receive a command or run pending tasks; return whether it was a command."""
        received = self.subscriptions.receive(wait=wait)
        if received is None:
            self._run_tasks()
            return False
        self._receive_message(*received)
        return True

    def _receive_message(self, controller: str, message: zenoh.Sample) -> None:
        payload, encoding = message.payload.to_bytes(), str(message.encoding)
        if self._recorder is not None:
            if controller not in self._recorder.senders:
                self._recorder.sender(controller, self.subscriptions.proven(controller), ZENOH)
            self._recorder.received(keys.COMMAND, keys.COMMAND.below(sender=controller), payload, encoding)
        if self.injection is not None and self.injection.link.disturbs_commands:
            self.deliver(controller, lambda: self._receive_command(controller, payload, encoding))
        elif not self.exchange.intake.accept_fast(controller, payload, monotonic(), encoding):
            self._receive_command(controller, payload, encoding)

    def _receive_command(self, controller: str, payload: bytes, encoding: str) -> None:
        exchange, limited = self.exchange, self.exchange.counts.rate_limited
        if self.access is not None and (reason := self.access.denial(keys.COMMAND, controller)):
            event = None if exchange.intake.is_rate_limited(controller) else exchange.rejected(reason, controller)
        else:
            event = exchange.intake.receive_command(controller, payload, monotonic(), encoding)
        if exchange.counts.rate_limited > limited and self._recorder is not None:
            event = exchange.event(EventKind.REJECTED, RATE_LIMITED, controller)  # after too many to be published
        if event is not None:
            self.event(event)

    def deliver(self, controller: str, receive: Callable[[], None]) -> bool:
        """Receive a command as injected faults of the link allow: late, several times, or never.

        Returns:
            Whether it is received at all.
        """
        if self.injection is None or controller not in self.exchange.claims.by_name:
            receive()
            return True
        now_s = monotonic()
        delays = self.injection.link.incoming(controller, now_s)
        for delay_s in delays:
            self._run_after(now_s, delay_s, receive)
        return bool(delays)

    def _run_after(self, now_s: float, delay_s: float, task: Callable[[], None]) -> None:
        if delay_s <= 0.0:
            task()
        else:
            self.timer.at(now_s + delay_s, lambda: self.subscriptions.post(task))

    def _run_tasks(self) -> None:
        self.subscriptions.run_pending()
        self.trials.collect()
        if self.exchange.state is _WAITING and not self.stopping:
            try:
                self.plant.check()
            except SimulatorError as error:
                self.fail(error)

    def step(self) -> None:
        """Simulate a timestep: send the commands to the plant, publish the sample."""
        exchange = self.exchange
        began_s = monotonic()
        commands = exchange.begin_step(began_s)
        self.pacing.step_started()
        if self.injection is not None:
            commands = self.injection.apply_to_commands(commands, exchange.step)
        self.received = commands
        if self._recorder is not None:
            self._recorder.order(commands, exchange.active_slots)
        try:
            last = self.plant.step(commands, exchange.active_slots)
        except SimulatorError as error:
            if self.stopping:
                raise Stopped from None
            self.fail(error)
            return
        exchange.finish_step(last, monotonic())
        self.publish()
        self.publish_warnings()
        self._step_latency.add(self._sampled_s - began_s)
        self.pacing.record_sample(self._sampled_s)
        self._announce_end()

    def finish_steps(self, commands: bytes) -> None:
        """Publish the present sample after several timesteps, of which these were the last commands."""
        self.received = commands
        self.publish()
        self.publish_warnings()
        self._announce_end()

    def publish_warnings(self) -> None:
        """Publish the plant's warnings of the last timesteps as events."""
        if self._warnings is not None:
            for text in self._warnings.drain_step_warnings():
                self._warn(text)

    def _warn(self, text: str) -> None:
        """Publish a warning of the plant."""
        if len(self.plant_warnings) < MAX_PLANT_WARNINGS:
            self.plant_warnings[text] = None
        self.event(self.exchange.event(EventKind.WARNING, text))

    def _announce_end(self) -> None:
        """Publish the event of the end, once the episodes of all slots are over."""
        if self.exchange.state is _ENDED:
            text = f"the run period is over after {self.exchange.step[0]} timesteps"
            self.event(self.exchange.event(EventKind.ENDED, text))

    def publish(self) -> None:
        """Publish the present sample."""
        injection, values = self.injection, self._encode_sample()
        if injection is None:
            self.publications.sample(self.latest_sample)
        else:
            self._publish_with_faults(injection)
        if self._recorder is not None:
            self._recorder.add(SAMPLES, self.latest_sample)
        self.publish_events(self._account(values))
        now_s = monotonic()
        if self._sampled_s:
            self._cycle.add(now_s - self._sampled_s)
        self._sampled_s = now_s
        self.pacing.wait(now_s)
        self._publish_points(values)
        if self._observer is not None:
            self._observer(self)

    def repeat_sample(self) -> bytes:
        """Take the present sample as `publish` does, but publish nothing; return it encoded."""
        self._account(self._encode_sample())
        if self.injection is not None:
            self.injection.drain_transitions()
        if self._warnings is not None:
            self._warnings.drain_step_warnings()
        return self.latest_sample

    def observe(self) -> None:
        """Show the present state, which is not published."""
        if self._observer is not None:
            self._observer(self)

    def go_on(self, text: str) -> None:
        """Publish the latest sample of a node that goes on, and its event; no controller is connected yet."""
        self._sampled_s = monotonic()
        self.publications.sample(self.latest_sample)
        self._publish_points(codec.decode(Sample, self.latest_sample).values)
        self.pacing.resume_at(self._sampled_s)
        self.event(self.exchange.event(EventKind.RESUMED, text))
        for name in [*self.exchange.claims.by_name]:
            self.on_disconnect(name)

    def _encode_sample(self) -> bytes:
        """Encode the present sample as the latest one; return its values."""
        values, fault_free_values = self.plant.values(), b""
        if self.injection is not None:
            fault_free_values, values = values, self.injection.apply_to_sensors(values, self.exchange.step)
        self.latest_sample = self.samples.encode(self.exchange, values, fault_free_values)
        return values

    def _account(self, values: bytes) -> list[Event]:
        """Add the present values to the history, and relinquish what has expired; return the events of the sample."""
        exchange = self.exchange
        expired = exchange.intake.expire(self.elapsed_s) if exchange.commands.has_expiries else []
        if self.history is not None:
            self.history.add(values, self.plant.effective, exchange.episode, exchange.step)
        alarms = self.alarms.update(values, exchange.episode, exchange.step) if self.alarms is not None else []
        return [*expired, *alarms]

    def _publish_points(self, values: bytes) -> None:
        step = self.exchange.step[0]
        self.publications.points.publish(values, self.exchange.episode[0], step, self.samples.time(step))

    def _publish_with_faults(self, injection: FaultInjection) -> None:
        payload, now_s = self.latest_sample, monotonic()
        for text in injection.drain_transitions():
            self.event(self.exchange.event(EventKind.FAULT, text))
        for delay_s in injection.link.outgoing(now_s):
            self._run_after(now_s, delay_s, lambda: self.publications.sample(payload))

    def event(self, event: Event) -> None:
        """Publish an event."""
        self.publications.event(event, event.source if event.source in self.exchange.claims.by_name else "")
        if self.on_event is not None:
            self.on_event(event)
        if self._observer is not None:
            self._observer(self)

    def publish_events(self, events: list[Event]) -> None:
        """Publish several events."""
        for event in events:
            self.event(event)

    # Episodes

    def begin_episodes(self, slots: Sequence[int], seeds: Sequence[int | None]) -> None:
        """Begin episodes in some slots, and the step schedule, at the sample that is published next."""
        if self.injection is not None:
            self.injection.begin(slots, seeds)
        if self.alarms is not None:
            self.alarms.reset(slots)
        self.exchange.fallback_active = False
        self._forget_received(slots)
        self._sampled_s = 0.0
        self.failure = self.failure_error = ""
        self.pacing.begin()

    def _forget_received(self, slots: Sequence[int]) -> None:
        """Record that the plant has received nothing yet in some slots."""
        if self.received and len(slots) < self.manifest.slots:
            values = np.frombuffer(self.received).reshape(self.exchange.shape).copy()
            values[list(slots)] = np.nan
            self.received = values.tobytes()
        else:
            self.received = b""

    def on_disconnect(self, controller: str) -> None:
        """Record that a controller has left; the fallback policy applies after the grace period."""
        events = self.exchange.fallback.on_disconnect(controller, monotonic())
        self.publish_events(events)
        if events:
            grace_s = self.manifest.grace_s
            self.timer.at(monotonic() + grace_s, lambda: self.subscriptions.post(lambda: self._bypass(controller)))

    def on_reconnect(self, controller: str) -> None:
        """Record that a controller is on the bus again; if nobody was waited for, it has the whole deadline."""
        now_s, awaited = monotonic(), self.exchange.awaiting()
        events = self.exchange.fallback.on_reconnect(controller, now_s)
        self.publish_events(events)
        if events and not awaited:
            self.pacing.wait(now_s)

    def revoke(self, name: str) -> None:
        """End the claims of a certificate's name that is revoked, and relinquish what it has set."""
        self.publish_events(revoke(self.exchange, name))

    def revoke_again(self) -> None:
        """End what revoked names have in a former state: that of a snapshot or a recording."""
        holders = {*self.exchange.claims.by_name, *self.exchange.source_names}
        for name in () if self.access is None else sorted(self.access.revoked):
            if any(holder and keys.is_own(name, holder) for holder in holders):
                self.revoke(name)

    def _bypass(self, controller: str) -> None:
        try:
            self.publish_events(self.exchange.fallback.bypass(controller, monotonic(), self.manifest.grace_s))
        except EpisodeAborted as error:
            self.fail(error)

    def _on_error(self, topic: keys.Topic, sender: str, error: Exception) -> None:
        """Report an error of this program in a request; a timestep or a start that it has interrupted fails."""
        traceback.print_exception(error)
        text = f"{topic.key}: internal error: {type(error).__name__}: {error}"
        self.event(self.exchange.event(EventKind.WARNING, text, sender))
        if self.exchange.state in (State.RUNNING, State.STARTING):
            self.fail(error)

    def fail(self, error: Exception) -> None:
        """End the episode after an error or by the fallback policy; a reset begins another one."""
        self.pacing.cancel()
        self.exchange.transition(Trigger.FAIL)
        fields = errors.to_wire(error)
        self.failure, self.failure_error = fields["message"], fields["error"]
        self.event(self.exchange.event(EventKind.FAILED, self.failure, error=self.failure_error))
        self.plant.end(failed=True)

    def set_mode(self, mode: Mode, speed: float) -> None:
        """Change when timesteps begin."""
        self.exchange.mode = mode
        self.describe({"mode": mode, "speed": speed})

    def describe(self, fields: Mapping[str, object]) -> None:
        """Change fields of the manifest, which is not published yet."""
        self.manifest = self.manifest.model_copy(update=fields)

    def check_slot(self, slot: int) -> None:
        """Raise `RequestRejected` if there is no such slot."""
        if slot >= self.manifest.slots:
            raise RequestRejected(f"no slot {slot} on node {self.manifest.node!r}; it has {self.manifest.slots}")

    def inject(self, faults: FaultPlan, previous: FaultInjection | None = None) -> None:
        """Inject these faults in place of the present ones; an empty plan ends the injection.

        Args:
            faults: the plan.
            previous: faults that are equal to one of these keep their state; None begins all of them.

        Raises:
            InvalidConfig: see `FaultInjection`.
        """
        self.injection = FaultInjection(faults, self.plant.description, self.manifest.slots) if faults.faults else None
        if self.injection is not None and self.received:
            self.injection.remember_commands(self.received)
        if self.injection is not None and previous is not None:
            self.injection.adopt(previous)
        if self.injection is not None and self.exchange.state is State.WAITING:  # for commands that answer the sample
            self.injection.link.move(self.exchange.step[0])
        if self.manifest.faults_injected != (self.injection is not None):
            self.describe({"faults_injected": self.injection is not None})

    def restore(self, faults: FaultState | None, received: bytes, alarms: AlarmSnapshot | None) -> None:
        """Restore the faults of a snapshot, the values that the plant had received last, and the alarms."""
        self.received = received
        self.inject((faults or NO_FAULTS)[0])
        if self.injection is not None and faults is not None:
            self.injection.restore(faults)
        if alarms is not None and self.alarms is not None:
            self.alarms.restore(alarms)

    def cancel_step(self) -> None:
        """Interrupt the plant if it is computing; thread-safe."""
        self.stopping = True
        if self.exchange.state in (State.RUNNING, State.STARTING):
            self.plant.interrupt()
        self.trials.interrupt("the node ends")

    @property
    def waiting(self) -> str:
        """Why the running timestep waits for others; empty if it does not. Thread-safe."""
        return "" if self._waiting is None or self.exchange.state is not State.RUNNING else self._waiting.waiting

    @property
    def elapsed_s(self) -> float:
        """Simulated time since all slots began."""
        return self.exchange.commands.timesteps * self.plant.description.run_period.step_s

    def statistics(self) -> Statistics:
        """Return durations of steps, overruns and message counts; thread-safe."""
        counts = self.exchange.counts
        return Statistics(
            step=self._step_latency.summary(),
            cycle=self._cycle.summary(),
            overruns=self.pacing.pace.overruns,
            max_lag_s=self.pacing.pace.max_lag_s,
            missed=counts.missed,
            late=counts.late,
            rejected=counts.rejected,
            duplicate=counts.duplicate,
            rate_limited=counts.rate_limited + self.subscriptions.rate_limited,
            accepted_late=counts.accepted_late,
        )
