"""Requests and queries that a node server answers, except those on pace, episodes and branches."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np
import psutil

from zenostat.bridge.exchange.intake import RATE_LIMITED
from zenostat.bridge.node.manifest import located_geometry
from zenostat.bridge.node.planning import PlanSimulation
from zenostat.bridge.node.served_node import ServedNode
from zenostat.bridge.node.subscriptions import Request
from zenostat.topics import codec, keys
from zenostat.topics.errors import AccessDenied, BadMessage, BusError, RequestRejected, UnknownName
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import (
    REJECTIONS,
    Ack,
    Acknowledge,
    AlarmList,
    AlarmQuery,
    Claim,
    Command,
    Event,
    EventKind,
    Geometry,
    HistoryQuery,
    Manifest,
    Message,
    PriorityArrays,
    Query,
    RemoveFromService,
    ReturnToService,
    ScenarioText,
    SemanticModel,
    Shelve,
    SimulatePlan,
    Status,
    Stop,
    Systems,
    Unshelve,
    WeatherQuery,
    WeatherSeries,
    Write,
)

if TYPE_CHECKING:
    from zenostat.topics.messages.alarms import AlarmRequest


def _lost() -> Message:
    raise BusError("an injected fault of the link lost the command")


class RequestHandlers:
    """All other requests to one node server: claims, commands, geometry, etc.; for its thread, unless noted."""

    def __init__(self, server: ServedNode) -> None:
        self._server, self._semantic_model = server, b""

    def declare(self, status: Callable[[Query], bytes] | None = None) -> None:
        """Answer requests; `status` replaces the server's own."""
        server, subscriptions = self._server, self._server.subscriptions
        subscriptions.listen(keys.ACTUATOR, self._write)
        subscriptions.answer_latest(keys.MANIFEST, lambda: codec.encode(self._manifest()))
        subscriptions.answer_latest(keys.SAMPLE, lambda: server.latest_sample)
        subscriptions.answer(
            keys.SCENARIO, lambda _: codec.encode(ScenarioText(text=server.plant.description.scenario))
        )
        subscriptions.answer(keys.GEOMETRY, lambda _: codec.encode(self._geometry()))
        subscriptions.answer_in_background(keys.SEMANTIC, self._semantic)
        subscriptions.answer(keys.SYSTEMS, lambda _: codec.encode(self._systems()))
        subscriptions.answer(keys.FAULT_PLAN, lambda _: codec.encode(self._fault_plan()))
        subscriptions.answer(keys.STATUS, status or (lambda query: codec.encode(self.status(memory=query.memory))))
        subscriptions.request(keys.CLAIM, Claim, self._claim)
        subscriptions.request_undecoded(keys.COMMAND_REQUEST, self._request_command)
        subscriptions.request_undecoded(keys.WRITE_REQUEST, self._request_write)
        subscriptions.request(keys.WEATHER, WeatherQuery, self._weather)
        subscriptions.request(keys.PRIORITIES, Query, self._priorities)
        subscriptions.request(keys.HISTORY, HistoryQuery, self._history)
        subscriptions.request(keys.ALARMS, AlarmQuery, self._alarms)
        subscriptions.request(keys.ACKNOWLEDGE, Acknowledge, self._operate_alarms)
        subscriptions.request(keys.SHELVE, Shelve, self._operate_alarms)
        subscriptions.request(keys.UNSHELVE, Unshelve, self._operate_alarms)
        subscriptions.request(keys.REMOVE_FROM_SERVICE, RemoveFromService, self._operate_alarms)
        subscriptions.request(keys.RETURN_TO_SERVICE, ReturnToService, self._operate_alarms)
        subscriptions.request(keys.PLAN, SimulatePlan, PlanSimulation(server).simulate)
        subscriptions.request(keys.STOP, Stop, self._stop, on_receipt=self._on_stop_receipt)
        subscriptions.request(keys.FAULTS, FaultPlan, self._set_faults)

    def _claim(self, claim: Claim) -> Message:
        server, exchange, now_s = self._server, self._server.exchange, monotonic()
        # A controller that joins within a step has the whole deadline; one that replaces another has the rest of it.
        awaited, controllers = exchange.awaiting(), len(exchange.claims.by_name)
        server.publish_events(exchange.claim(claim, now_s))
        server.subscriptions.expect_presence(claim.controller, server.timer)
        if claim.required and (not awaited or len(exchange.claims.by_name) > controllers):
            server.pacing.wait(now_s)
        return Ack(episode=exchange.episode)

    # Commands and writes

    def _request_command(self, request: Request) -> None:
        if not self._server.deliver(request.sender, lambda: request.answer(lambda: self._command(request))):
            request.answer(_lost)

    def _command(self, request: Request) -> Ack:
        server, exchange, controller, now_s = self._server, self._server.exchange, request.sender, monotonic()
        event, access = None, server.subscriptions.access
        if access is not None and (reason := access.denial(keys.COMMAND_REQUEST, controller)):
            server.subscriptions.deny(keys.COMMAND_REQUEST, controller, reason)
        if not exchange.intake.accept_fast(controller, request.payload, now_s, request.encoding):
            event = self._command_off_the_fast_path(request, now_s)
        reply = self._ack(event)
        server.subscriptions.end_turn()  # what came after the command may refer to the step that it completes
        return reply

    def _command_off_the_fast_path(self, request: Request, now_s: float) -> Event | None:
        intake, controller = self._server.exchange.intake, request.sender
        if intake.is_rate_limited(controller):
            is_accepted, event = intake.accept_awaited(controller, request.payload, now_s, request.encoding)
            if not is_accepted:
                raise RequestRejected(RATE_LIMITED)
            return event
        try:
            command = codec.decode(Command, request.payload, request.encoding)
        except BadMessage as error:
            self._server.event(self._server.exchange.rejected(str(error), controller))
            raise
        return intake.command(controller, command, now_s)

    def _ack(self, event: Event | None = None) -> Ack:
        """Publish the event of a command or a write; return the reply, or raise `RequestRejected` with its text."""
        exchange = self._server.exchange
        if event is not None:
            self._server.event(event)
            if event.kind in REJECTIONS:
                raise RequestRejected(event.text)
        text = event.text if event is not None and event.kind is EventKind.WRITTEN else ""
        return Ack(episode=exchange.episode, step=exchange.step, text=text)

    def _write(self, sender: str, name: str, payload: bytes, encoding: str) -> None:
        with suppress(BadMessage, AccessDenied):  # it is reported by an event
            self._server.event(self._decode_and_write(keys.ACTUATOR, sender, name, payload, encoding))

    def _request_write(self, request: Request) -> None:
        names, payload, encoding = (request.sender, request.name), request.payload, request.encoding
        request.answer(lambda: self._ack(self._decode_and_write(keys.WRITE_REQUEST, *names, payload, encoding)))

    def _decode_and_write(self, topic: keys.Topic, sender: str, name: str, payload: bytes, encoding: str) -> Event:
        """Write an actuator; return the event, which is not published yet.

        Raises:
            BadMessage: the payload is not a write; its event is published.
            AccessDenied: its sender may not send it; its event is published.
        """
        server = self._server
        try:
            write = codec.decode(Write, payload, encoding)
        except BadMessage as error:
            rejected = server.exchange.rejected(f"{name}: {error}", sender)
            server.event(rejected)
            raise BadMessage(rejected.text) from None
        write = server.subscriptions.checked(topic, sender, write)
        return server.exchange.intake.write(name, write, server.elapsed_s)

    # Other requests

    def _set_faults(self, faults: FaultPlan) -> Message:
        server = self._server
        server.inject(faults, server.injection)
        server.publications.manifest(server.manifest)
        names = ", ".join(faults.names) or "none"
        server.event(server.exchange.event(EventKind.FAULT, f"faults are set: {names}", faults.source))
        return Ack(episode=server.exchange.episode)

    def _weather(self, query: WeatherQuery) -> Message:
        server = self._server
        server.check_slot(query.slot)
        columns, units, step_s, values = server.plant.weather(query.slot, query.columns)
        return WeatherSeries(
            episode=server.exchange.episode[query.slot],
            columns=columns,
            units=units,
            step_s=step_s,
            values=np.ascontiguousarray(values, "<f8").tobytes(),
        )

    def _priorities(self, _: Query) -> Message:
        exchange = self._server.exchange
        values, source_index = exchange.commands.array.table()
        return PriorityArrays(
            episode=exchange.episode,
            step=exchange.step,
            values=values.astype("<f8").tobytes(),
            source_index=source_index.astype("<u2").tobytes(),
            sources=exchange.source_names,
            remaining_s=exchange.commands.remaining_s(self._server.elapsed_s),
        )

    def _history(self, query: HistoryQuery) -> Message:
        server = self._server
        server.check_slot(query.slot)
        if server.history is None:
            raise RequestRejected(
                f"branches keep no history; ask {server.manifest.branch_of!r}"
                if server.manifest.branch_of
                else "the node keeps no history (history_mb=0, or less than a sample takes)"
            )
        return server.history.answer(query)

    def _alarms(self, query: AlarmQuery) -> Message:
        server, exchange = self._server, self._server.exchange
        server.check_slot(query.slot)
        if server.alarms is not None:
            return server.alarms.status(query.slot)
        episode, step = exchange.episode[query.slot], exchange.step[query.slot]
        time = server.plant.description.run_period.time(step).isoformat()
        return AlarmList(slot=query.slot, episode=episode, step=step, time=time, alarms=[])

    def _operate_alarms(self, request: AlarmRequest) -> Message:
        server = self._server
        if request.slot is not None:
            server.check_slot(request.slot)
        if server.alarms is None:
            raise UnknownName(f"no alarm {request.alarm!r}; node {server.manifest.node!r} has none")
        events = server.alarms.request(request)
        server.publish_events(events)
        return Ack(episode=server.exchange.episode, text="\n".join(event.text for event in events))

    def _is_for_another(self, stop: Stop) -> bool:
        return stop.instance not in ("", self._server.manifest.instance)

    def _on_stop_receipt(self, stop: Stop) -> None:
        """Interrupt the timestep; in the thread that receives the request."""
        if not self._is_for_another(stop):
            self._server.on_stop()

    def _stop(self, stop: Stop) -> Message:
        manifest = self._server.manifest
        if self._is_for_another(stop):
            raise RequestRejected(
                f"this node {manifest.node!r} has the instance {manifest.instance}, not {stop.instance}"
            )
        self._server.stopped_by = stop.source
        self._server.subscriptions.post(self._server.stop_serving)
        return Ack(episode=self._server.exchange.episode)

    def _geometry(self) -> Geometry:
        """Return the geometry at the place of the present episode of slot 0; thread-safe."""
        plant = self._server.plant
        geometry = located_geometry(plant)
        if geometry is None:
            raise RequestRejected(plant.description.without_geometry)
        return geometry

    def _semantic(self, _: Query) -> bytes:
        """Return the semantic model, which does not change while the node exists."""
        description = self._server.plant.description
        if description.semantic is None:
            raise RequestRejected(description.without_semantic)
        if not self._semantic_model:
            text = description.semantic(self._server.manifest.node)
            self._semantic_model = codec.encode(SemanticModel(text=text))
        return self._semantic_model

    def _systems(self) -> Systems:
        """Return the systems of the plant; thread-safe."""
        description = self._server.plant.description
        if description.systems is None:
            raise RequestRejected(f"the plant {description.name!r} does not describe its systems")
        return description.systems

    def _fault_plan(self) -> FaultPlan:
        """Return the faults that are injected now or later; thread-safe."""
        injection = self._server.injection
        return FaultPlan() if injection is None else injection.plan

    def _manifest(self) -> Manifest:
        return self._server.manifest.model_copy(update={"statistics": self._server.statistics()})

    def status(self, *, memory: bool) -> Status:
        """Return the present state of the server; thread-safe. `memory` takes some milliseconds per engine."""
        server = self._server
        exchange, counts, pacing = server.exchange, server.exchange.counts, server.pacing
        run_period = server.plant.description.run_period
        steps_left = pacing.unfinished_steps  # before `step`: a timestep that ends meanwhile is counted
        return Status(
            node=server.manifest.node,
            state=exchange.state,
            building=server.plant.description.name,
            weather=server.manifest.weather,
            mode=exchange.mode,
            episode=exchange.episode,
            step=exchange.step,
            speed=pacing.speed,
            paused=pacing.paused,
            steps_left=steps_left,
            policy=exchange.policy,
            steps=run_period.steps,
            time=[run_period.time(step).isoformat() for step in exchange.step],
            controllers=exchange.controllers(),
            accepted=counts.accepted,
            rejected=counts.rejected,
            late=counts.late,
            duplicate=counts.duplicate,
            failure=server.failure,
            failure_error=server.failure_error,
            waiting=server.waiting,
            node_rss_bytes=psutil.Process().memory_info().rss,
            engine_rss_bytes=server.plant.memory_bytes(),
            statistics=server.statistics(),
            faults=server.injection.active() if server.injection is not None else [],
            engine_private_bytes=server.plant.memory_bytes(private=True) if memory else 0,
        )
