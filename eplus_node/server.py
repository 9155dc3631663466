"""What a node, and each of its branches, is on the bus: an exchange (rules), engines (EnergyPlus) and Zenoh.

One thread does all the work of a runner: it waits for a message, hands it to the exchange, and when the exchange is
due it lets the engines simulate a timestep and publishes the sample. Whatever else happens (requests, writes, a
signal, an engine's death) is put on a shelf by the thread that hears of it, which then wakes this one with a message
that never leaves the process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from datetime import datetime, timedelta
from pathlib import Path
from time import monotonic

import numpy as np
import psutil
import zenoh

from bridge.exchange.episode import MAX_SOURCE_NAME, StepExchange, Trigger
from bridge.exchange.latency import LatencyWindow
from bridge.runtime.timer import Timer
from eplus_node.config import Plan
from eplus_node.engine.group import EngineGroup
from eplus_node.fault_injection import FaultInjection
from eplus_node.pacing import Pacing
from eplus_node.publications import Publications
from eplus_node.subscriptions import COMMAND_QUEUE, MAX_PENDING, Subscriptions
from models.scenario.episode import series
from models.scenario.schema import dump
from models.weather.epw import find_column
from topics import codec, errors, keys
from topics.errors import EpisodeAborted, RequestRejected, SimulatorError, ZenostatError
from topics.fault_plan import FaultPlan
from topics.messages import (
    ANONYMOUS,
    Ack,
    Claim,
    Event,
    EventKind,
    Flag,
    Manifest,
    Message,
    Mode,
    Query,
    ScenarioText,
    State,
    Statistics,
    Status,
    Stop,
    WeatherQuery,
    WeatherSeries,
    Write,
)

_NO_FLAG, _FIRST, _TRUNCATED = int(Flag.NONE), int(Flag.FIRST), int(Flag.TRUNCATED)
_FALLBACK = int(Flag.FALLBACK)
# For each timestep: Python 3.11 looks at an enum's member by raising and catching an error.
_LOCKSTEP, _WAITING, _ENDED = Mode.LOCKSTEP, State.WAITING, State.ENDED

Observer = Callable[["NodeServer"], None]


class Stopped(BaseException):
    """Raised in a runner's thread by a signal or a stop request."""


class NodeServer:
    """Engines on the bus, under one name.

    Args:
        session: the node's.
        plan: what is simulated.
        manifest: what it is.
        exchange: at the sample at which the engines stand.
        engines: waiting there.
        weather: the file that the present episode of a slot reads.
        observer: told of each sample and event.

    Attributes:
        stopping: it is to end, and what goes wrong with engines is no failure any more.
        interrupt: ends the engines that it may be waiting for; any thread may call it.
        on_stop: called at once, by the thread that hears of a request to stop.
    """

    def __init__(
        self,
        session: zenoh.Session,
        plan: Plan,
        manifest: Manifest,
        exchange: StepExchange,
        engines: EngineGroup,
        weather: Callable[[int], Path],
        observer: Observer | None = None,
    ) -> None:
        self.session, self.plan, self.manifest = session, plan, manifest
        self.exchange, self.engines = exchange, engines
        self.weather_file = weather
        self._observer = observer
        self._close = ExitStack()
        self.timer = Timer()
        self.injection: FaultInjection | None = None
        self.pacing = Pacing(self)
        self._told = b""  # to the engines
        self._step_took, self._cycle = LatencyWindow(), LatencyWindow()
        self._sampled_s = 0.0
        self.stopping = False
        self.interrupt = engines.interrupt
        self.on_stop = self.cancel_step
        self._leaving = False
        self.failure = self.failure_error = ""
        self._latest = b""
        self._begin = plan.period.time(0)
        self._step_time = timedelta(seconds=plan.period.step_s)

    # On the bus

    def declare(self, status: Callable[[Query], bytes] | None = None) -> None:
        """What it answers and hears; `status` in place of its own."""
        inlets = self.inlets = self._close.enter_context(Subscriptions(self.session, self.manifest.node))
        inlets.listen(keys.ACTUATOR, self._write)
        inlets.fetch(keys.MANIFEST, lambda: codec.encode(self._manifest()))
        inlets.fetch(keys.SAMPLE, lambda: self._latest)
        inlets.answer(keys.SCENARIO, lambda _: codec.encode(ScenarioText(text=dump(self.plan.scenario))))
        inlets.answer(keys.STATUS, status or (lambda asked: codec.encode(self.status(memory=asked.memory))))
        inlets.request(keys.CLAIM, Claim, self._claim)
        inlets.request(keys.WEATHER, WeatherQuery, self._weather)
        inlets.request(keys.STOP, Stop, self._stop, at_once=self.on_stop)
        self.pacing.declare()
        inlets.request(keys.FAULTS, FaultPlan, self._set_faults)
        self._close.callback(self.timer.close)
        self.outlets = self._close.enter_context(Publications(self.session, self.manifest, self.timer))

    def announce(self) -> None:
        """Tells of its presence, once all else is there."""
        token = keys.NODE_TOKEN.at(self.manifest.node, name=self.manifest.instance)
        self._close.enter_context(self.session.liveliness().declare_token(token))

    def close(self) -> None:
        """Ends the engines and leaves the bus; twice is fine."""
        self.engines.end(failed=self.exchange.state is State.FAILED)
        self._close.close()

    # The loop

    def serve(self) -> None:
        """Serves until it is told to stop."""
        try:
            while True:
                if self.exchange.ready_to_step() and self.pacing.may_step():
                    self._advance()
                    if self.exchange.fallback_active or self.exchange.mode is not _LOCKSTEP:
                        self._hear_all()  # nobody's answer is waited for
                else:
                    self._listen(wait=True)
        except Stopped:
            self.exchange.transition(Trigger.STOP)
            self.event(self.exchange.event(EventKind.STOPPED, "the node was told to stop"))

    def stop_serving(self) -> None:
        """Ends the loop, in its own thread; told twice (a request, then its owner's end), it goes on ending."""
        if not self._leaving:
            self._leaving = True
            raise Stopped

    def _hear_all(self) -> None:
        """Takes what came during a timestep: of one message at a time, those of several controllers would pile up."""
        for _ in range(COMMAND_QUEUE):
            if not self._listen(wait=False):
                return

    def _listen(self, *, wait: bool) -> bool:
        """Takes a command, or does what is on the shelf; whether it was a command."""
        came = self.inlets.receive(wait=wait)
        if came is None:
            self._clear_shelf()
            return False
        controller, message = came
        payload, said = message.payload.to_bytes(), str(message.encoding)
        self.exchange.now_s = monotonic()
        if self.injection is not None and self.injection.link.disturbs_commands:
            self._hear_late(controller, payload, said)
        elif not self.exchange.accept_fast(controller, payload, said):
            self._hear(controller, payload, said)
        return True

    def _hear(self, controller: str, payload: bytes, said: str) -> None:
        event = self.exchange.receive_command(controller, payload, said)
        if event is not None:
            self.event(event)

    def _hear_late(self, controller: str, payload: bytes, said: str) -> None:
        """A command that an injected fault of the link meets on its way."""
        assert self.injection is not None
        if controller not in self.exchange.claims.by_name:
            self._hear(controller, payload, said)
            return
        now_s = self.exchange.now_s
        for delay_s in self.injection.link.incoming(controller, now_s):
            self._later(now_s, delay_s, lambda: self._hear(controller, payload, said))

    def _later(self, now_s: float, delay_s: float, work: Callable[[], None]) -> None:
        if delay_s <= 0.0:
            work()
        else:
            self.timer.at(now_s + delay_s, lambda: self.inlets.post(work))

    def _clear_shelf(self) -> None:
        self.exchange.now_s = monotonic()
        self.inlets.run_pending()
        if self.exchange.state is _WAITING and not self.engines.alive and not self.stopping:
            try:
                self.engines.raise_if_dead()
            except SimulatorError as error:
                self.fail(error)

    def _advance(self) -> None:
        """One timestep: the commands that rule it to the engines, its sample to the bus."""
        exchange = self.exchange
        self.pacing.step_started()
        began_s = exchange.now_s = monotonic()
        if exchange.commands.has_expiries:
            self.publish_events(exchange.expire(self._passed_s))
        values, source_index = exchange.begin_step()
        if self.injection is not None:
            values = self.injection.apply_to_commands(values, exchange.step)
        self._told = values
        try:
            last = self.engines.step(values, source_index, exchange.active_slots)
        except SimulatorError as error:
            if self.stopping:
                self.inlets.run_pending(most=MAX_PENDING)
            self.fail(error)
            return
        exchange.finish_step(last)
        self.publish()
        self._step_took.add(exchange.now_s - began_s)
        self.pacing.record_sample(exchange.now_s)
        if exchange.state is _ENDED:
            self.event(exchange.event(EventKind.ENDED, f"the run period is over after {exchange.step[0]} timesteps"))

    def publish(self) -> None:
        """The present sample."""
        exchange, counts, engines = self.exchange, self.exchange.counts, self.engines
        steps, fell = exchange.step, _FALLBACK if exchange.fallback_active else _NO_FLAG
        now, times, elapsed_s = self._clock(steps)
        if True in exchange.done or 0 in steps:
            flags = [
                (_TRUNCATED if over else _NO_FLAG if step else _FIRST) | fell
                for over, step in zip(exchange.done, steps, strict=True)
            ]
        else:
            flags = [fell] * len(steps)
        values, fault_free_values, injection = engines.values_bytes(), b"", self.injection
        if injection is not None:
            fault_free_values, values = values, injection.apply_to_sensors(values, exchange.step)
        self._latest = codec.pack(
            episode=exchange.episode,
            step=steps,
            time=times,
            elapsed_s=elapsed_s,
            flags=flags,
            values=values,
            effective=engines.effective,
            source_index=engines.source_index,
            sources=exchange.source_names,
            late=counts.late,
            rejected=counts.rejected,
            baseline=engines.baseline_bytes() if engines.baselines else b"",
            baseline_effective=engines.baseline_effective() if engines.baselines else b"",
            fault_free_values=fault_free_values,
        )
        if injection is None:
            self.outlets.sample(self._latest)
        else:
            self._publish_disturbed(injection)
        now_s = exchange.now_s = monotonic()
        if self._sampled_s:
            self._cycle.add(now_s - self._sampled_s)
        self._sampled_s = now_s
        exchange.open_intake()
        self.pacing.wait(now_s)
        self.outlets.points(values, exchange.episode[0], steps[0], now)
        if self._observer is not None:
            self._observer(self)

    def _clock(self, steps: list[int]) -> tuple[datetime, list[str], list[float]]:
        """Simulated time of slot 0; as text, and in seconds since its episode's begin, that of each slot."""
        first, slots = steps[0], len(steps)
        passed = first * self._step_time
        now = self._begin + passed
        if steps.count(first) == slots:
            return now, [now.isoformat()] * slots, [passed.total_seconds()] * slots
        each = [step * self._step_time for step in steps]
        return now, [(self._begin + one).isoformat() for one in each], [one.total_seconds() for one in each]

    def _publish_disturbed(self, injection: FaultInjection) -> None:
        payload, now_s = self._latest, monotonic()
        for text in injection.drain_transitions():
            self.event(self.exchange.event(EventKind.FAULT, text))
        for delay_s in injection.link.outgoing(now_s):
            self._later(now_s, delay_s, lambda: self.outlets.sample(payload))

    def event(self, event: Event) -> None:
        """Publishes an event."""
        self.outlets.event(event)
        if self._observer is not None:
            self._observer(self)

    def publish_events(self, events: list[Event]) -> None:
        """Publishes events."""
        for event in events:
            self.event(event)

    def begin_episodes(self, slots: Sequence[int], seeds: Sequence[int | None]) -> None:
        """Episodes begin in some slots, at the sample that is published next: the schedule begins there, too."""
        if self.injection is not None:
            self.injection.begin(slots, seeds)
        self.exchange.fallback_active = False
        self._told, self._sampled_s = b"", 0.0
        self.pacing.begin()

    def on_disconnect(self, who: str) -> None:
        """A controller has gone; the policy takes its place after the time of grace."""
        events = self.exchange.on_disconnect(who)
        self.publish_events(events)
        if events:
            grace_s = self.manifest.grace_s
            self.timer.at(monotonic() + grace_s, lambda: self.inlets.post(lambda: self._by_policy(who)))

    def _by_policy(self, who: str) -> None:
        try:
            self.publish_events(self.exchange.bypass(who, self.manifest.grace_s))
        except EpisodeAborted as error:
            self.fail(error)

    def fail(self, error: ZenostatError) -> None:
        """The episode is over for an engine's fault, or by policy; a reset begins another one."""
        self.pacing.cancel()
        self.exchange.transition(Trigger.FAIL)
        said = errors.to_wire(error)
        self.failure, self.failure_error = said["message"], said["error"]
        self.event(self.exchange.event(EventKind.FAILED, said["message"], error=said["error"]))
        self.engines.end(failed=True)

    # Requests

    def check_slot(self, slot: int) -> None:
        """Whether there is such a slot; `RequestRejected` says how many there are."""
        if slot >= self.manifest.slots:
            raise RequestRejected(f"no slot {slot} on node {self.manifest.node!r}; it has {self.manifest.slots}")

    def _claim(self, claim: Claim) -> Message:
        exchange = self.exchange
        # Who joins within a step has its whole time to answer; who replaces another has what is left of it.
        waited, known = exchange.awaiting(), len(exchange.claims.by_name)
        self.publish_events(exchange.claim(claim))
        if claim.required and (not waited or len(exchange.claims.by_name) > known):
            self.pacing.wait(exchange.now_s)
        return Ack(episode=self.exchange.episode)

    def inject(self, faults: FaultPlan) -> None:
        """Has these faults, in place of those that were there; none if the plan has none.

        Raises:
            InvalidConfig: see `FaultInjection`.
        """
        self.injection = FaultInjection(faults, self.plan, self.manifest.slots) if faults.faults else None
        if self.injection is not None and self._told:
            self.injection.heard(self._told)
        if self.manifest.faults_injected != (self.injection is not None):
            self.manifest = self.manifest.model_copy(update={"faults_injected": self.injection is not None})

    def _set_faults(self, faults: FaultPlan) -> Message:
        self.inject(faults)
        self.outlets.manifest(self.manifest)
        named = ", ".join(faults.names) or "none"
        self.event(self.exchange.event(EventKind.FAULT, f"faults are set: {named}"))
        return Ack(episode=self.exchange.episode)

    def _weather(self, query: WeatherQuery) -> Message:
        self.check_slot(query.slot)
        values, step_s = series(self.weather_file(query.slot), self.plan.period, query.columns)
        found = [find_column(name) for name in query.columns]
        return WeatherSeries(
            episode=self.exchange.episode[query.slot],
            columns=[column.name for column in found],
            units=[column.unit for column in found],
            step_s=step_s,
            values=np.ascontiguousarray(values, "<f8").tobytes(),
        )

    def cancel_step(self) -> None:
        """Does not wait for an engine that is computing; any thread may."""
        self.stopping = True
        if self.exchange.state in (State.RUNNING, State.STARTING):
            self.interrupt()

    def _stop(self, _: Stop) -> Message:
        self.inlets.post(self.stop_serving)
        return Ack(episode=self.exchange.episode)

    def _write(self, name: str, payload: bytes, said: str) -> None:
        try:
            write_ = codec.decode(Write, payload, said)
        except errors.BadMessage as error:
            source = codec.text_field(payload, "source", MAX_SOURCE_NAME) or ANONYMOUS
            self.event(self.exchange.rejected(f"{name}: {error}", source))
            return
        self.event(self.exchange.write(name, write_, self._passed_s))

    @property
    def _passed_s(self) -> float:
        """Simulated time since all slots began."""
        return self.exchange.commands.timesteps * self.plan.period.step_s

    def _manifest(self) -> Manifest:
        return self.manifest.model_copy(update={"statistics": self.statistics()})

    def statistics(self) -> Statistics:
        """How it keeps up; any thread may ask."""
        counts = self.exchange.counts
        return Statistics(
            step=self._step_took.summary(),
            cycle=self._cycle.summary(),
            overruns=self.pacing.pace.overruns,
            max_lag_s=self.pacing.pace.max_lag_s,
            missed=counts.missed,
            late=counts.late,
            rejected=counts.rejected,
            duplicate=counts.duplicate,
            rate_limited=counts.rate_limited + self.inlets.rate_limited,
            accepted_late=counts.accepted_late,
        )

    def status(self, *, memory: bool) -> Status:
        """Where it stands; any thread may ask. `memory` takes some milliseconds an engine."""
        exchange, counts = self.exchange, self.exchange.counts
        return Status(
            node=self.manifest.node,
            state=exchange.state,
            building=self.plan.building.name,
            weather=self.manifest.weather,
            mode=exchange.mode,
            episode=exchange.episode,
            step=exchange.step,
            speed=self.pacing.pace.speed,
            paused=self.pacing.paused,
            policy=exchange.policy,
            steps=self.plan.period.steps,
            time=[self.plan.period.time(step).isoformat() for step in exchange.step],
            controllers=exchange.controllers(),
            accepted=counts.accepted,
            rejected=counts.rejected,
            late=counts.late,
            duplicate=counts.duplicate,
            failure=self.failure,
            failure_error=self.failure_error,
            node_rss_bytes=psutil.Process().memory_info().rss,
            engine_rss_bytes=self.engines.rss_bytes,
            statistics=self.statistics(),
            faults=self.injection.on() if self.injection is not None else [],
            engine_private_bytes=self.engines.private_bytes if memory else 0,
        )
