"""The node: one building on the bus. It joins the exchange (rules), the engine (EnergyPlus) and Zenoh.

One thread does all the work: it waits for a message, hands it to the exchange, and when the exchange is due
it lets the engine simulate a timestep and publishes the sample. Whatever else happens (requests, writes,
a signal, the engine's death) is put on a shelf by the thread that hears of it, which then wakes this one
with a message that never leaves the process.
"""

from __future__ import annotations

import gc
import shutil
import signal
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from types import FrameType

import numpy as np
import psutil

from bridge import affinity
from bridge.lockstep import Exchange, Input
from bridge.session import open_session
from eplus_node.config import NodeConfig, Plan, plan
from eplus_node.inlets import Inlets
from eplus_node.link import EngineLink
from eplus_node.outlets import Outlets
from eplus_node.supply import Supply
from models import energyplus
from models.episode import series
from models.scenario import dump
from models.weather import find_column
from topics import VERSION, codec, errors, keys
from topics.errors import NameTaken, SimulatorError
from topics.messages import (
    Accepted,
    Claim,
    Event,
    EventKind,
    Flag,
    Manifest,
    Message,
    Mode,
    Policy,
    Reset,
    ScenarioText,
    Start,
    State,
    Status,
    Stop,
    Versions,
    WeatherQuery,
    WeatherSeries,
    Write,
)

_NO_FLAG, _FIRST, _TRUNCATED = int(Flag.NONE), int(Flag.FIRST), int(Flag.TRUNCATED)

Observer = Callable[["Node"], None]


class _Stopped(BaseException):
    """Raised in the node's thread by a signal or a stop request."""


class Node:
    """A building on the bus. `with Node(config) as node: node.serve()`.

    Raises (on entering):
        UsageError, SimulatorError, BusError: see `topics.errors`; nothing is left behind.
    """

    def __init__(self, config: NodeConfig, observer: Observer | None = None) -> None:
        self.config = config
        self._observer = observer
        self._close = ExitStack()
        self._stopping = self._leaving = False
        self._failure = ""
        self._latest = b""

    # Life

    def __enter__(self) -> Node:
        with ExitStack() as undo:
            undo.callback(self.close)
            self.plan: Plan = plan(self.config)
            self._begin = self.plan.period.time(0)
            self._step_time = timedelta(seconds=self.plan.period.step_s)
            self._place()
            self._open_bus()
            self.exchange = Exchange(self.plan.points.actuators, mode=self.config.mode)
            self._make_folder()
            self._supply = Supply(self.plan, self._folder, cpu=self.engine_cpu, poll=self.engine_cpu != self.cpu)
            self._close.callback(self._supply.close)
            self._close.callback(self._close_engine)
            self._start_engine()
            self._announce()
            undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the engine, leaves the bus and clears up; twice is fine."""
        self._close.close()

    def _place(self) -> None:
        config = self.config
        self.engine_cpu, self.cpu = config.engine_cpu, config.cpu
        if config.cpu is None:
            self.engine_cpu, self.cpu = affinity.pick_cores(config.affinity)
        affinity.pin(self.cpu)

    def _open_bus(self) -> None:
        config = self.config
        self.session = self._close.enter_context(
            open_session(listen=config.listen, connect=config.connect, expose=config.expose)
        )
        self.instance = str(self.session.zid())
        self._refuse_second(config.name)

    def _tokens(self) -> list[str]:
        replies = self.session.liveliness().get(keys.NODE_TOKEN.at(self.config.name, name="*"))
        return [keys.last_of(str(reply.ok.key_expr)) for reply in replies if reply.ok]

    def _refuse_second(self, name: str) -> None:
        others = [token for token in self._tokens() if token != self.instance]
        if others:
            raise NameTaken(f"a node named {name!r} is on this bus already (instance {others[0]}); name this one else")

    def _make_folder(self) -> None:
        self._folder = self.config.folder or Path(tempfile.mkdtemp(prefix="zenostat-"))
        self._folder.mkdir(parents=True, exist_ok=True)
        self._close.callback(shutil.rmtree, self._folder, ignore_errors=True)

    def _announce(self) -> None:
        """Says that the node is there: what it answers first, its presence last."""
        name = self.config.name
        self.manifest = self._manifest()
        declare = self._close.enter_context
        inlets = self._inlets = declare(Inlets(self.session, name))
        inlets.listen(keys.ACTUATOR, self._write)
        inlets.watch(keys.CONTROLLER_TOKEN, lambda who: self._tell(self.exchange.left(who)))
        inlets.answer(keys.MANIFEST, lambda: codec.encode(self.manifest))
        inlets.answer(keys.SAMPLE, lambda: self._latest)
        scenario = codec.encode(ScenarioText(text=dump(self.plan.scenario)))
        inlets.answer(keys.SCENARIO, lambda: scenario)
        inlets.answer(keys.STATUS, lambda: codec.encode(self.status()))
        inlets.request(keys.CLAIM, Claim, self._claim)
        inlets.request(keys.RESET, Reset, self._reset)
        inlets.request(keys.WEATHER, WeatherQuery, self._weather)
        inlets.request(keys.STOP, Stop, self._stop, at_once=self._hurry)
        self._outlets = declare(Outlets(self.session, self.manifest))
        self._close.callback(signal.signal, signal.SIGCHLD, signal.getsignal(signal.SIGCHLD))
        signal.signal(signal.SIGCHLD, lambda *_: inlets.wake())  # the engine's end is seen while nothing else comes
        self.event(self.exchange.event(EventKind.STARTED, self._begins()))
        for warning in self.plan.warnings:
            self.event(self.exchange.event(EventKind.WARNING, warning))
        self._publish()
        declare(self.session.liveliness().declare_token(keys.NODE_TOKEN.at(name, name=self.instance)))
        if any(token < self.instance for token in self._tokens()):
            self._refuse_second(name)  # two that started at once: the one with the lower id stays

    def _manifest(self) -> Manifest:
        plan, config = self.plan, self.config
        return Manifest(
            node=config.name,
            instance=self.instance,
            building=plan.building.name,
            weather=self._supply.source.name,
            location=self._supply.source.header.place,
            latitude_deg=self._supply.source.header.latitude_deg,
            longitude_deg=self._supply.source.header.longitude_deg,
            begin=plan.period.time(0).isoformat(),
            end=plan.period.time(plan.period.steps).isoformat(),
            steps_per_hour=plan.period.steps_per_hour,
            steps=plan.period.steps,
            mode=config.mode,
            policy=Policy.WAIT,
            sensors=plan.points.sensors,
            meters=plan.points.meters,
            actuators=plan.points.actuators,
            task=plan.task,
            warnings=plan.warnings,
            versions=Versions(zenostat=VERSION, energyplus=energyplus.version()),
            host=affinity.host(),
            cpu=self.cpu,
        )

    # The loop

    def serve(self) -> None:
        """Serves until it is told to stop (by a request, a signal, or its owner's end)."""
        gc.freeze()  # what is loaded by now stays; collections need not look at it
        previous = {s: signal.signal(s, self._on_signal) for s in (signal.SIGINT, signal.SIGTERM)}
        try:
            while True:
                if self.exchange.due():
                    self._advance()
                    if self.exchange.mode is Mode.FREE:
                        self._listen(wait=False)
                else:
                    self._listen(wait=True)
        except _Stopped:
            self.exchange.take(Input.STOP)
            self.event(self.exchange.event(EventKind.STOPPED, "the node was told to stop"))
        finally:
            for number, handler in previous.items():
                signal.signal(number, handler)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._leave()

    def _leave(self) -> None:
        """Ends the loop; told twice (a request, then its owner's end), it goes on ending."""
        if not self._leaving:
            self._leaving = True
            raise _Stopped

    def _listen(self, *, wait: bool) -> None:
        came = self._inlets.receive(wait=wait)
        if came is None:
            self._clear_shelf()
            return
        controller, message = came
        payload = message.payload.to_bytes()
        if not self.exchange.take_usual(controller, payload):
            event = self.exchange.hear(controller, payload, str(message.encoding))
            if event is not None:
                self.event(event)

    def _clear_shelf(self) -> None:
        self._inlets.clear_shelf()
        if self.exchange.state is State.WAITING and not self._engine.alive:
            try:
                self._engine.receive()
            except SimulatorError as error:
                self._fail(error)

    def _advance(self) -> None:
        """One timestep: the commands that rule it to the engine, its sample to the bus."""
        exchange, engine = self.exchange, self._engine
        if exchange.expiring:
            self._tell(exchange.expire(self._elapsed_s()))
        values, self._ruler = exchange.go()
        try:
            engine.send(values)
            engine.receive()
        except SimulatorError as error:
            if self._stopping:
                self._clear_shelf()
            self._fail(error)
            return
        self._applied = engine.applied_bytes(values)
        exchange.sampled(last=engine.last)
        self._publish()
        if engine.last:
            self.event(exchange.event(EventKind.ENDED, f"the run period is over after {exchange.step[0]} timesteps"))

    def _elapsed_s(self) -> float:
        return self.exchange.step[0] * self.plan.period.step_s

    def _publish(self) -> None:
        exchange, counts = self.exchange, self.exchange.counts
        step = exchange.step[0]
        elapsed = step * self._step_time
        self._latest = codec.pack(
            episode=exchange.episode,
            step=exchange.step,
            time=[(self._begin + elapsed).isoformat()],
            elapsed_s=[elapsed.total_seconds()],
            flags=[_TRUNCATED if self._engine.last else _NO_FLAG if step else _FIRST],
            values=self._engine.values_bytes(),
            applied=self._applied,
            ruler=self._ruler,
            rulers=exchange.ruler_names,
            late=counts.late,
            rejected=counts.rejected,
        )
        self._outlets.sample(self._latest)
        exchange.listen()
        self._outlets.points(self._engine.values, exchange.episode[0], step, self._begin + elapsed)
        if self._observer is not None:
            self._observer(self)

    def event(self, event: Event) -> None:
        """Publishes an event."""
        self._outlets.event(event)
        if self._observer is not None:
            self._observer(self)

    def _tell(self, events: list[Event]) -> None:
        for event in events:
            self.event(event)

    # The engine

    def _start_engine(self) -> None:
        """An engine of the present episode, at sample 0."""
        try:
            self._engine = self._supply.engine(self.exchange.episode[0])
        except SimulatorError:
            if self._stopping:
                raise _Stopped from None
            raise
        self._ready()

    def _close_engine(self) -> None:
        if hasattr(self, "_engine"):
            self._end(self._engine)

    def _end(self, engine: EngineLink) -> None:
        """Ends an engine; where its files are kept, EnergyPlus may finish them."""
        if self.config.keep and self.exchange.state is not State.FAILED:
            engine.finish()
        else:
            engine.close()

    def _ready(self) -> None:
        self.exchange.ready()
        values, self._ruler = self.exchange.nobody()
        self._applied = self._engine.applied_bytes(values)
        self._failure = ""

    def _fail(self, error: SimulatorError) -> None:
        self.exchange.take(Input.FAIL)
        self._failure = str(error)
        said = errors.to_wire(error)
        self.event(self.exchange.event(EventKind.FAILED, said["message"], error=said["error"]))
        self._engine.close()

    # Requests

    def _claim(self, claim: Claim) -> Message:
        self._tell(self.exchange.claim(claim))
        return Accepted(episode=self.exchange.episode)

    def _reset(self, reset: Reset) -> Message:
        if reset.options:
            raise errors.Refused(f"unknown reset options {sorted(reset.options)}; there are none yet")
        untouched = self.exchange.state is State.WAITING and not self.exchange.touched
        self.exchange.reset()
        supply, episode = self._supply, self.exchange.episode[0]
        start = supply.turn(reset.seed, episode, untouched=untouched)
        # The answer goes out before the start, which takes seconds in large buildings.
        self._inlets.shelve(lambda: self._restart(start, reset.controller))
        return Accepted(
            episode=self.exchange.episode,
            start=start,
            weather=supply.source.name,
            drawn=supply.files.drawn,
            outputs=supply.outputs,
        )

    def _restart(self, start: Start, source: str) -> None:
        former = self._engine
        quick = start in (Start.FORKED, Start.AHEAD)  # the former engine's end, which takes as long, can wait
        if start is Start.READY and former.alive:
            self._ready()
        else:
            if not quick:
                self._end(former)
            try:
                self._start_engine()
            except SimulatorError as error:
                self._fail(error)
                return
        if self.manifest.weather != self._supply.source.name:
            self.manifest = self._manifest()
            self._outlets.manifest(self.manifest)
        self.event(self.exchange.event(EventKind.STARTED, self._begins(), source))
        self._publish()
        if quick:
            self._end(former)
        self._supply.look_ahead(self.exchange.episode[0])

    def _begins(self) -> str:
        """What the episode simulates, in a line."""
        source, drawn = self._supply.source, self._supply.files.drawn
        parts = [f"episode {self.exchange.episode[0]} of {self.manifest.building} begins", source.name]
        parts += [source.site.source] if source.site is not None else []
        parts += self.plan.building.notes
        parts += [f"{name} {value:.4g}" for name, value in drawn.items()]
        return "; ".join(parts)

    def _weather(self, query: WeatherQuery) -> Message:
        values, step_s = series(self._supply.files.weather, self.plan.period, query.columns)
        found = [find_column(name) for name in query.columns]
        return WeatherSeries(
            episode=self.exchange.episode[0],
            columns=[column.name for column in found],
            units=[column.unit for column in found],
            step_s=step_s,
            values=np.ascontiguousarray(values, "<f8").tobytes(),
        )

    def _hurry(self) -> None:
        """Does not wait for an engine that is computing."""
        self._stopping = True
        if self.exchange.state in (State.RUNNING, State.STARTING):
            self._engine.interrupt()

    def _stop(self, _: Stop) -> Message:
        self._inlets.shelve(self._leave)
        return Accepted(episode=self.exchange.episode)

    def _write(self, name: str, payload: bytes, said: str) -> None:
        try:
            write_ = codec.decode(Write, payload, said)
        except errors.BadMessage as error:
            self.event(self.exchange.rejected(f"{name}: {error}", "anonymous"))
            return
        self.event(self.exchange.write(name, write_, self._elapsed_s()))

    def status(self) -> Status:
        """Where the node stands; any thread may ask."""
        exchange, counts = self.exchange, self.exchange.counts
        return Status(
            node=self.config.name,
            state=exchange.state,
            building=self.plan.building.name,
            weather=self._supply.source.name,
            mode=exchange.mode,
            episode=exchange.episode,
            step=exchange.step,
            steps=self.plan.period.steps,
            time=[self.plan.period.time(exchange.step[0]).isoformat()],
            controllers=exchange.controllers(),
            accepted=counts.accepted,
            rejected=counts.rejected,
            late=counts.late,
            duplicate=counts.duplicate,
            failure=self._failure,
            node_rss_bytes=psutil.Process().memory_info().rss,
            engine_rss_bytes=self._engine.rss_bytes,
        )
