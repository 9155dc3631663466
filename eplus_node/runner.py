"""What a node, and each of its branches, is on the bus: an exchange (rules), engines (EnergyPlus) and Zenoh.

One thread does all the work of a runner: it waits for a message, hands it to the exchange, and when the exchange is
due it lets the engines simulate a timestep and publishes the sample. Whatever else happens (requests, writes, a
signal, an engine's death) is put on a shelf by the thread that hears of it, which then wakes this one with a message
that never leaves the process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from time import monotonic

import numpy as np
import psutil
import zenoh

from bridge.latencies import Latencies
from bridge.lockstep import Exchange, Input
from bridge.pace import Pace
from bridge.timer import Timer
from eplus_node.config import Plan
from eplus_node.engines import Engines
from eplus_node.injection import Injection
from eplus_node.inlets import INBOX, MOST_SHELVED, Inlets
from eplus_node.outlets import Outlets
from models.episode import series
from models.scenario import dump
from models.weather import find_column
from topics import codec, errors, keys
from topics.errors import EpisodeAborted, Refused, SimulatorError, ZenostatError
from topics.faults import FaultPlan
from topics.messages import (
    Accepted,
    Ask,
    Claim,
    Event,
    EventKind,
    Flag,
    GoSteps,
    Manifest,
    Message,
    Mode,
    Pause,
    Resume,
    ScenarioText,
    SetPace,
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

Observer = Callable[["Runner"], None]


def memory_asked(payload: bytes) -> bool:
    """Whether a question for the status wants what each process shares with no other."""
    try:
        return codec.decode(Ask, payload).memory
    except errors.BadMessage:
        return False  # a stranger may ask with nothing at all


class Stopped(BaseException):
    """Raised in a runner's thread by a signal or a stop request."""


class Runner:
    """Engines on the bus, under one name.

    Args:
        session: the node's.
        plan: what is simulated.
        manifest: what it is.
        exchange: at the sample at which the engines stand.
        engines: waiting there.
        weather: the file that the present episode of a slot reads.
        observer: told of each sample and event.
    """

    def __init__(
        self,
        session: zenoh.Session,
        plan: Plan,
        manifest: Manifest,
        exchange: Exchange,
        engines: Engines,
        weather: Callable[[int], Path],
        observer: Observer | None = None,
    ) -> None:
        self.session, self.plan, self.manifest = session, plan, manifest
        self.exchange, self.engines = exchange, engines
        self.weather_file = weather
        self._observer = observer
        self._close = ExitStack()
        self.timer = Timer()
        self.injection: Injection | None = None
        self.pace = Pace(plan.period.step_s, manifest.speed)
        self.paused = False
        self.steps_left = 0
        self._timesteps = 0  # of all episodes and slots: what the schedule counts
        self._into_s = 0.0  # of the timestep in which it was paused
        self._overdue_at_s = 0.0
        self._told = b""  # to the engines
        self._alarm: int | None = None
        self._step_took, self._cycle = Latencies(), Latencies()
        self._sampled_s = 0.0
        self.stopping = False
        self._leaving = False
        self.failure = self.failure_error = ""
        self._latest = b""
        self._begin = plan.period.time(0)
        self._step_time = timedelta(seconds=plan.period.step_s)

    # On the bus

    def declare(self, status: Callable[[bytes], bytes] | None = None) -> None:
        """What it answers and hears; `status` in place of its own."""
        inlets = self.inlets = self._close.enter_context(Inlets(self.session, self.manifest.node))
        inlets.listen(keys.ACTUATOR, self._write)
        inlets.answer(keys.MANIFEST, lambda _: codec.encode(self._manifest()))
        inlets.answer(keys.SAMPLE, lambda _: self._latest)
        inlets.answer(keys.SCENARIO, lambda _: codec.encode(ScenarioText(text=dump(self.plan.scenario))))
        inlets.answer(keys.STATUS, status or (lambda asked: codec.encode(self.status(memory=memory_asked(asked)))))
        inlets.request(keys.CLAIM, Claim, self._claim)
        inlets.request(keys.WEATHER, WeatherQuery, self._weather)
        inlets.request(keys.STOP, Stop, self._stop, at_once=self.hurry)
        inlets.request(keys.PACE, SetPace, self._set_pace)
        inlets.request(keys.PAUSE, Pause, self._pause)
        inlets.request(keys.RESUME, Resume, self._resume)
        inlets.request(keys.STEP, GoSteps, self._go_steps)
        inlets.request(keys.FAULTS, FaultPlan, self._set_faults)
        self._close.callback(self.timer.close)
        self.outlets = self._close.enter_context(Outlets(self.session, self.manifest))

    def show(self) -> None:
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
                if self._may_go():
                    self._advance()
                    if self.exchange.mode is not Mode.LOCKSTEP:
                        self._hear_all()
                else:
                    self._listen(wait=True)
        except Stopped:
            self.exchange.take(Input.STOP)
            self.event(self.exchange.event(EventKind.STOPPED, "the node was told to stop"))

    def _may_go(self) -> bool:
        """Whether the next timestep is due, by the exchange and by the clock; if not by the clock, it wakes then."""
        exchange = self.exchange
        if not exchange.due() or self._stands:
            return False
        if exchange.mode is not Mode.PACED or self.steps_left:
            return True
        due_s = self.pace.due_s(self._timesteps + 1)
        if monotonic() >= due_s:
            return True
        self._call_at(due_s, self.inlets.wake)
        return False

    @property
    def _stands(self) -> bool:
        """Whether it stands still because somebody said so."""
        return self.paused and not self.steps_left

    def _call_at(self, due_s: float, call: Callable[[], None]) -> None:
        """Has the timer's thread do something later, in place of what it was to do later."""
        self._forget_alarm()
        self._alarm = self.timer.at(due_s, call)

    def _forget_alarm(self) -> None:
        alarm, self._alarm = self._alarm, None
        if alarm is not None:
            self.timer.cancel(alarm)

    def leave(self) -> None:
        """Ends the loop, in its own thread; told twice (a request, then its owner's end), it goes on ending."""
        if not self._leaving:
            self._leaving = True
            raise Stopped

    def _hear_all(self) -> None:
        """Takes what came during a timestep: of one message at a time, those of several controllers would pile up."""
        for _ in range(INBOX):
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
        elif not self.exchange.take_usual(controller, payload, said):
            self._hear(controller, payload, said)
        return True

    def _hear(self, controller: str, payload: bytes, said: str) -> None:
        event = self.exchange.hear(controller, payload, said)
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
            self.timer.at(now_s + delay_s, lambda: self.inlets.shelve(work))

    def _clear_shelf(self) -> None:
        self.exchange.now_s = monotonic()
        self.inlets.clear_shelf()
        if self.exchange.state is State.WAITING and not self.engines.alive:
            try:
                self.engines.raise_dead()
            except SimulatorError as error:
                self.fail(error)

    def _advance(self) -> None:
        """One timestep: the commands that rule it to the engines, its sample to the bus."""
        exchange = self.exchange
        if self._alarm is not None:
            self._forget_alarm()
        if self.steps_left:
            self.steps_left, self._into_s = self.steps_left - 1, 0.0
        began_s = exchange.now_s = monotonic()
        if exchange.expiring:
            self.tell(exchange.expire(exchange.step[0] * self.plan.period.step_s))
        values, ruler = exchange.go()
        if self.injection is not None:
            values = self.injection.commanded(values, exchange.step)
        self._told = values
        try:
            last = self.engines.step(values, ruler, exchange.moving)
        except SimulatorError as error:
            if self.stopping:
                self.inlets.clear_shelf(most=MOST_SHELVED)
            self.fail(error)
            return
        exchange.sampled(last)
        self._timesteps += 1
        self.publish()
        self._step_took.add(exchange.now_s - began_s)
        if exchange.mode is Mode.PACED and not self.paused and self.pace.came(exchange.now_s, self._timesteps):
            self._overran()
        if exchange.state is State.ENDED:
            self.event(exchange.event(EventKind.ENDED, f"the run period is over after {exchange.step[0]} timesteps"))

    def publish(self) -> None:
        """The present sample."""
        exchange, counts, engines = self.exchange, self.exchange.counts, self.engines
        elapsed = [step * self._step_time for step in exchange.step]
        fell = _FALLBACK if exchange.fallback else _NO_FLAG
        values, undisturbed, injection = engines.values_bytes(), b"", self.injection
        if injection is not None:
            undisturbed, values = values, injection.sensed(values, exchange.step)
        self._latest = codec.pack(
            episode=exchange.episode,
            step=exchange.step,
            time=[(self._begin + passed).isoformat() for passed in elapsed],
            elapsed_s=[passed.total_seconds() for passed in elapsed],
            flags=[
                (_TRUNCATED if over else _NO_FLAG if step else _FIRST) | fell
                for over, step in zip(exchange.ended, exchange.step, strict=True)
            ],
            values=values,
            applied=engines.applied,
            ruler=engines.ruler,
            rulers=exchange.ruler_names,
            late=counts.late,
            rejected=counts.rejected,
            baseline=engines.baseline_bytes() if engines.baselines else b"",
            baseline_applied=engines.baseline_applied() if engines.baselines else b"",
            undisturbed=undisturbed,
        )
        if injection is None:
            self.outlets.sample(self._latest)
        else:
            self._publish_disturbed(injection)
        now_s = exchange.now_s = monotonic()
        if any(exchange.step):
            self._cycle.add(now_s - self._sampled_s)
        self._sampled_s = now_s
        exchange.listen()
        self._set_deadline(now_s)
        self.outlets.points(values, exchange.episode[0], exchange.step[0], self._begin + elapsed[0])
        if self._observer is not None:
            self._observer(self)

    def _publish_disturbed(self, injection: Injection) -> None:
        payload, now_s = self._latest, monotonic()
        for text in injection.told():
            self.event(self.exchange.event(EventKind.FAULT, text))
        for delay_s in injection.link.outgoing(now_s):
            self._later(now_s, delay_s, lambda: self.outlets.sample(payload))

    def event(self, event: Event) -> None:
        """Publishes an event."""
        self.outlets.event(event)
        if self._observer is not None:
            self._observer(self)

    def tell(self, events: list[Event]) -> None:
        """Publishes events."""
        for event in events:
            self.event(event)

    def begin(self, slots: Sequence[int], seeds: Sequence[int | None]) -> None:
        """Episodes begin in some slots, at the sample that is published next: the schedule begins there, too."""
        if self.injection is not None:
            self.injection.begin(slots, seeds)
        self.exchange.fallback = False
        self._told = b""
        self._into_s = 0.0
        self.pace.anchor(monotonic(), self._timesteps)

    def left(self, who: str) -> None:
        """A controller has gone; the policy takes its place after the time of grace."""
        events = self.exchange.left(who)
        self.tell(events)
        if events:
            grace_s = self.manifest.grace_s
            self.timer.at(monotonic() + grace_s, lambda: self.inlets.shelve(lambda: self._by_policy(who)))

    def _by_policy(self, who: str) -> None:
        try:
            self.tell(self.exchange.waive(who, self.manifest.grace_s))
        except EpisodeAborted as error:
            self.fail(error)

    def _set_deadline(self, now_s: float) -> None:
        """From now on the present step waits no longer than it may; not while the node stands still."""
        deadline_s = self.exchange.deadline_s
        if deadline_s is not None and self.exchange.mode is Mode.LOCKSTEP and not self._stands:
            self._overdue_at_s = now_s + deadline_s
            self._call_at(self._overdue_at_s, lambda: self.inlets.shelve(self._overdue))

    def _overdue(self) -> None:
        # It may come from the shelf after its step has gone on; the present one has a later deadline then.
        if self._stands or self.exchange.mode is not Mode.LOCKSTEP or monotonic() < self._overdue_at_s:
            return
        try:
            self.tell(self.exchange.overdue())
        except EpisodeAborted as error:
            self.fail(error)

    def _overran(self) -> None:
        pace = self.pace
        if pace.overruns & (pace.overruns - 1) == 0:  # the first, the second, the fourth…: the count is in the status
            at_worst = f"{pace.behind_s:.3g} s at worst"
            text = f"overrun {pace.overruns}: the sample of step {self.exchange.step[0]} came late, {at_worst}"
            self.event(self.exchange.event(EventKind.PACE, text))

    def fail(self, error: ZenostatError) -> None:
        """The episode is over for an engine's fault, or by policy; a reset begins another one."""
        self._forget_alarm()
        self.exchange.take(Input.FAIL)
        said = errors.to_wire(error)
        self.failure, self.failure_error = said["message"], said["error"]
        self.event(self.exchange.event(EventKind.FAILED, said["message"], error=said["error"]))
        self.engines.end(failed=True)

    # Requests

    def check_slot(self, slot: int) -> None:
        """Whether there is such a slot; `Refused` says how many there are."""
        if slot >= self.manifest.slots:
            raise Refused(f"no slot {slot} on node {self.manifest.node!r}; it has {self.manifest.slots}")

    def _claim(self, claim: Claim) -> Message:
        exchange = self.exchange
        # Who joins within a step has its whole time to answer; who replaces another has what is left of it.
        waited, known = exchange.missing(), len(exchange.claims.by_name)
        self.tell(exchange.claim(claim))
        if claim.required and (not waited or len(exchange.claims.by_name) > known):
            self._set_deadline(exchange.now_s)
        return Accepted(episode=self.exchange.episode)

    def inject(self, faults: FaultPlan) -> None:
        """Has these faults, in place of those that were there; none if the plan has none.

        Raises:
            InvalidConfig: see `Injection`.
        """
        self.injection = Injection(faults, self.plan, self.manifest.slots) if faults.faults else None
        if self.injection is not None and self._told:
            self.injection.heard(self._told)
        if self.manifest.disturbed != (self.injection is not None):
            self.manifest = self.manifest.model_copy(update={"disturbed": self.injection is not None})

    def _set_faults(self, faults: FaultPlan) -> Message:
        self.inject(faults)
        self.outlets.manifest(self.manifest)
        named = ", ".join(faults.names) or "none"
        self.event(self.exchange.event(EventKind.FAULT, f"faults are set: {named}"))
        return Accepted(episode=self.exchange.episode)

    def _set_pace(self, asked: SetPace) -> Message:
        if (asked.speed is not None) is not (asked.mode is Mode.PACED):
            raise Refused("a speed and the mode 'paced' go together; the other modes have none")
        mode, speed, now_s = asked.mode, asked.speed or self.manifest.speed, monotonic()
        self._forget_alarm()
        self._into_s = self._went_s(now_s)
        self.exchange.mode, self.pace.speed = mode, speed
        self.pace.anchor(now_s, self._timesteps, self._into_s)
        self._set_deadline(now_s)
        self.manifest = self.manifest.model_copy(update={"mode": mode, "speed": speed})
        self.outlets.manifest(self.manifest)
        text = f"{speed:g} times the wall clock" if mode is Mode.PACED else str(mode)
        return self._paced(text, asked.source)

    def _went_s(self, now_s: float) -> float:
        """How far the present timestep has gone by the clock, in simulated seconds."""
        if self.paused:
            return self._into_s
        return self.pace.into_s(now_s, self._timesteps) if self.exchange.mode is Mode.PACED else 0.0

    def _pause(self, asked: Pause) -> Message:
        self._into_s = self._went_s(monotonic())
        self.paused, self.steps_left = True, 0
        self._forget_alarm()
        return self._paced("paused", asked.source)

    def _resume(self, asked: Resume) -> Message:
        if self.paused:
            now_s = monotonic()
            self.paused, self.steps_left = False, 0
            self.pace.anchor(now_s, self._timesteps, self._into_s)
            self._set_deadline(now_s)
        return self._paced("goes on", asked.source)

    def _go_steps(self, asked: GoSteps) -> Message:
        if not self.paused:
            raise Refused("the node is not paused; pause it first")
        self.steps_left += asked.steps
        self._set_deadline(monotonic())
        return self._paced(f"timesteps to go: {self.steps_left}", asked.source)

    def _paced(self, text: str, source: str) -> Message:
        self.event(self.exchange.event(EventKind.PACE, text, source))
        return Accepted(episode=self.exchange.episode)

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

    def hurry(self) -> None:
        """Does not wait for an engine that is computing; any thread may."""
        self.stopping = True
        if self.exchange.state in (State.RUNNING, State.STARTING):
            self.engines.interrupt()

    def _stop(self, _: Stop) -> Message:
        self.inlets.shelve(self.leave)
        return Accepted(episode=self.exchange.episode)

    def _write(self, name: str, payload: bytes, said: str) -> None:
        try:
            write_ = codec.decode(Write, payload, said)
        except errors.BadMessage as error:
            self.event(self.exchange.rejected(f"{name}: {error}", "anonymous"))
            return
        self.event(self.exchange.write(name, write_, self.exchange.step[0] * self.plan.period.step_s))

    def _manifest(self) -> Manifest:
        return self.manifest.model_copy(update={"statistics": self.statistics()})

    def statistics(self) -> Statistics:
        """How it keeps up; any thread may ask."""
        counts = self.exchange.counts
        return Statistics(
            step=self._step_took.spread(),
            cycle=self._cycle.spread(),
            overruns=self.pace.overruns,
            behind_s=self.pace.behind_s,
            missed=counts.missed,
            late=counts.late,
            rejected=counts.rejected,
            duplicate=counts.duplicate,
            flooded=counts.flooded + self.inlets.flooded,
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
            speed=self.pace.speed,
            paused=self.paused,
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
