"""The page's server as an ASGI application: its files, its data, and the changes that it requests."""

from __future__ import annotations

import asyncio
import re
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, Field
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from zenostat.bridge.client.bus import Bus
from zenostat.topics import VERSION
from zenostat.topics.errors import (
    BusError,
    InvalidConfig,
    NameInUse,
    NodeLost,
    PeerError,
    RequestRejected,
    UsageError,
    ZenostatError,
)
from zenostat.topics.keys import Role
from zenostat.views.room.access import Access, Guard, Session, check_name_of, operator_of
from zenostat.views.room.audit import TOPIC as AUDIT
from zenostat.views.room.audit import AuditLog, Unanswered
from zenostat.views.room.builder import Builder
from zenostat.views.room.bus_watch import BusWatch
from zenostat.views.room.dashboards import (
    METRICS_TYPE,
    GrafanaQuery,
    GrafanaSeries,
    GrafanaVariableQuery,
    grafana_answer,
    grafana_series,
    grafana_targets,
    grafana_variable,
    prometheus,
)
from zenostat.views.room.description import NodeDescription
from zenostat.views.room.node_watch import NodeWatch
from zenostat.views.room.numbers import to_json
from zenostat.views.room.operations import read_operation
from zenostat.views.room.priorities import priority_arrays
from zenostat.views.room.requests import RoomRequest, read_body
from zenostat.views.room.series import MAX_SAMPLES, HistoryCache, band_content, band_points, band_zones, history_content
from zenostat.views.room.started_nodes import TOPIC as STARTED
from zenostat.views.room.started_nodes import StartedNodes
from zenostat.views.room.training_pages import TrainingPages
from zenostat.views.room.trainings import Trainings
from zenostat.views.room.trial_controllers import BUNDLED, Factory, controllers_content
from zenostat.views.room.updates import MAX_STREAMS, Updates
from zenostat.views.room.what_if import WhatIf, what_if

_STATIC = Path(__file__).with_name("static")
_MAX_PENDING = 8
"""Largest number of requests of pages that wait for one node: one that is frozen must not stop the others."""
_TURN_S = 2.0
"""Time that a query of a dashboard, which has many panels, waits until less than so many requests are pending."""
_GRACE_S = 1.0
"""Time that requests to nodes have when the control room ends; then they end without an answer."""
_THREADS = 64
"""Threads for requests that wait: for several frozen nodes at a time."""

T = TypeVar("T")

_PAGES: Mapping[str, frozenset[str]] = {
    "builder": frozenset({STARTED}),
    "trainings": frozenset({STARTED}),
    "audit": frozenset({AUDIT}),
}
"""Topics of pages besides the list of nodes."""


@dataclass(frozen=True)
class RoomSettings:
    """Permissions and files of a control room, as the person who starts it names them.

    Attributes:
        scenarios: folder of scenarios, which pages save and start nodes from; None permits neither.
        trainings: folder of trainings and studies; None shows none.
        node_settings: of nodes that are started: the bus that they join, and their keys.
        controllers: that pages may try, by name; see `offered_controllers`.
        audit_log: file to which each change is added; None keeps the latest changes in memory only.
    """

    scenarios: Path | None = None
    trainings: Path | None = None
    node_settings: Mapping[str, Any] = field(default_factory=dict)
    controllers: Mapping[str, Factory] = field(default_factory=lambda: BUNDLED)
    audit_log: Path | None = None


DEFAULTS = RoomSettings()


class _SignIn(RoomRequest):
    token: Annotated[str, Field(max_length=200)]


class _Invitation(RoomRequest):
    operator: Annotated[str, AfterValidator(check_name_of)]


class Room:
    """The application of a control room; `asgi` serves it.

    Args:
        bus: connection to the bus, which the caller closes after the application has ended; see `end`.
        access: who may use it.
        address: of the page, for links.
        settings: what pages may do besides operating nodes.
    """

    def __init__(self, bus: Bus, access: Access, address: str, settings: RoomSettings = DEFAULTS) -> None:
        self.updates = Updates()
        self.audit = AuditLog(self.updates, settings.audit_log)
        self.nodes = StartedNodes(settings.node_settings, self.updates)
        trainings = None if settings.trainings is None else Trainings(settings.trainings)
        self._builder = Builder(settings.scenarios, self.nodes, self.audit, self._is_online)
        self._trainings = trainings
        self._training_pages = TrainingPages(trainings, self.nodes, self.audit, self._is_online)
        self._settings = settings
        self._bus, self._access, self._address = bus, access, address
        self._watch: BusWatch | None = None
        self._is_ending, self._give_up = False, threading.Timer(_GRACE_S, bus.close)
        self._histories = HistoryCache(bus)
        self._pending: Counter[str] = Counter()
        routes = [
            Route("/", self._page),
            Route("/health", self._health),
            Route("/api/session", self._sign_in, methods=["POST"]),
            Route("/api/session", self._sign_out, methods=["DELETE"]),
            Route("/api/session", self._who_am_i),
            Route("/api/invitation", self._invite, methods=["POST"]),
            Route("/api/stream", self._stream),
            Route("/api/audit", self._audit_log),
            *self._builder.routes,
            *self._training_pages.routes,
            Route("/api/nodes/{node}", self._description),
            Route("/api/nodes/{node}/history", self._history),
            Route("/api/nodes/{node}/events", self._events),
            Route("/api/nodes/{node}/priorities", self._priorities),
            Route("/api/nodes/{node}/controllers", self._controllers),
            Route("/api/nodes/{node}/what_if", self._what_if, methods=["POST"]),
            Route("/api/nodes/{node}/{operation}", self._operate, methods=["POST"]),
            Route("/metrics", self._metrics),
            Route("/grafana", self._health),
            Route("/grafana/", self._health),
            Route("/grafana/metrics", self._grafana_metrics, methods=["POST"]),
            Route("/grafana/search", self._grafana_metrics, methods=["POST"]),
            Route("/grafana/variable", self._grafana_variable, methods=["POST"]),
            Route("/grafana/query", self._grafana_query, methods=["POST"]),
            Mount("/static", StaticFiles(directory=_STATIC)),
        ]
        handlers: dict[Any, Any] = {ZenostatError: _failure}
        app = Starlette(routes=routes, exception_handlers=handlers, lifespan=self._lifespan)
        self.asgi = Guard(app, access, self._add_denied)

    @property
    def watch(self) -> BusWatch:
        """The nodes of the bus."""
        assert self._watch is not None
        return self._watch

    def _is_online(self, node: str) -> bool:
        return self.watch.is_online(node)

    @asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(_THREADS, "room-request"))
        self.updates.start()
        self._watch = await asyncio.to_thread(BusWatch, self._bus, self.updates)
        try:
            yield
        finally:
            self._give_up.cancel()
            for part in (self._builder, self._training_pages, self.nodes):
                await asyncio.to_thread(part.close)
            await asyncio.to_thread(self._watch.close)
            self.audit.close()

    def end(self) -> None:
        """End the streams; close the bus a second later if requests still wait for nodes then."""
        self._is_ending = True
        self.updates.close()
        self._give_up.start()

    def link(self, operator: str) -> str:
        """Return an address that signs one browser in as this operator."""
        return f"{self._address}/#token={self._access.invite(operator)}"

    # Pages and sessions

    async def _page(self, _: Request) -> Response:
        return FileResponse(_STATIC / "index.html")

    async def _health(self, _: Request) -> Response:
        return JSONResponse({"status": "ok", "version": VERSION})

    async def _sign_in(self, request: Request) -> Response:
        token = read_body(_SignIn, await request.body()).token
        signed_in = self._access.sign_in(token)
        if signed_in is None:
            text = "this link was used already or is too old; get another one from `zenostat room` or a colleague"
            return JSONResponse({"error": "AccessDenied", "message": text}, 403)
        identity, session = signed_in
        self.audit.add(session.operator, "sign in", "", "signed in", accepted=True)
        response = JSONResponse({"operator": session.operator})
        response.set_cookie(self._access.cookie, identity, **self._access.cookie_settings)
        return response

    async def _sign_out(self, request: Request) -> Response:
        self._access.sign_out(request.cookies.get(self._access.cookie))
        response = JSONResponse({})
        response.delete_cookie(self._access.cookie, **self._access.cookie_settings)
        return response

    def _add_denied(self, name: str, method: str, path: str, reason: str) -> None:
        """Add a request that the role of its user does not permit to the audit log."""
        match path.split("/"):
            case ["", "api", "nodes", node, operation]:
                self.audit.add_denied(name, operation, node, reason)
            case _:
                self.audit.add_denied(name, f"{method} {path}", "", reason)

    async def _who_am_i(self, request: Request) -> Response:
        session: Session | None = request.state.session
        has_trainings = self._settings.trainings is not None
        operator, role = (None, None) if session is None else (session.operator, session.role.value)
        denial = "" if session else self._access.denial(request.scope)
        return JSONResponse({"operator": operator, "role": role, "trainings": has_trainings, "denial": denial})

    async def _invite(self, request: Request) -> Response:
        invited = read_body(_Invitation, await request.body()).operator
        link = self.link(invited)
        self.audit.add(operator_of(request), "invite", invited, "a link was created", accepted=True)
        return JSONResponse({"link": link})

    # Data

    async def _stream(self, request: Request) -> Response:
        node = request.query_params.get("node", "")
        topics = {"overview"} | ({f"node:{node}", f"events:{node}"} if node else set())
        topics |= _PAGES.get(request.query_params.get("page", ""), frozenset())
        if self.updates.followers >= MAX_STREAMS:
            return JSONResponse({"error": "RequestRejected", "message": f"{MAX_STREAMS} pages are open"}, 503)
        session: Session = request.state.session
        if session.role is not Role.OPERATOR:
            topics -= {AUDIT, STARTED}

        def may_follow() -> bool:
            return self._access.user(request.scope) == session

        return StreamingResponse(self._follow(topics, may_follow), media_type="text/event-stream")

    async def _follow(self, topics: set[str], may_follow: Callable[[], bool]) -> AsyncIterator[bytes]:
        """Yield the changes of some topics while who has requested them proves the same name, of the same role."""
        stream = self.updates.follow(topics)
        try:
            async for message in stream:
                if not may_follow():
                    return
                yield message
        finally:
            await stream.aclose()

    async def _audit_log(self, _: Request) -> Response:
        return _json({"entries": self.audit.entries()})

    async def _description(self, request: Request) -> Response:
        return _json(_described(self._node(request)).content)

    async def _history(self, request: Request) -> Response:
        watch, query = self._node(request), request.query_params
        text = query.get("max", "1000")
        if not text.isdecimal() or len(text) >= 9:
            raise InvalidConfig(f"max: 2 to {MAX_SAMPLES} samples expected, not {text[:40]!r}")
        max_samples = int(text)
        points, start, end = query.getlist("point"), query.get("from"), query.get("to")
        description = _described(watch)
        zones = band_zones(description, query.get("band"))

        def content() -> dict[str, Any]:
            followed = [name for name in band_points(description, zones) if name not in points]
            history = self._histories.history(watch, [*points, *followed], start, end, max_samples)
            return history_content(history, len(points)) | {"band": band_content(description, history, zones)}

        return _json(await self._call(watch, content))

    async def _events(self, request: Request) -> Response:
        watch = self._node(request)
        return _json({"node": watch.node, "events": watch.events()})

    async def _priorities(self, request: Request) -> Response:
        watch, point = self._node(request), request.query_params.get("point", "")
        manifest = _described(watch).manifest
        return _json(await self._call(watch, lambda: priority_arrays(self._bus, manifest, point)))

    async def _controllers(self, request: Request) -> Response:
        manifest = _described(self._node(request)).manifest

        def content() -> dict[str, Any]:
            tuned = {} if self._trainings is None else self._trainings.tuned()
            return controllers_content(manifest, self._settings.controllers, tuned)

        return _json(await asyncio.to_thread(content))

    # Changes

    async def _operate(self, request: Request) -> Response:
        watch, operator, name = self._node(request), operator_of(request), request.path_params["operation"]
        body = await request.body()

        async def change() -> str:
            operation = read_operation(name, body)
            try:
                return await self._call(watch, lambda: operation.run(self._bus, watch.node, operator))
            except PeerError as error:
                if type(error) is not PeerError:  # the node's answer
                    raise
                problem = f"node {watch.node!r} has not answered within {self._bus.timeout_s:g} s"
            except BusError as error:
                if not (self._is_ending or isinstance(error, NodeLost)):
                    raise
                end = "the control room ended" if self._is_ending else "it left the bus"
                problem = f"{end} before node {watch.node!r} answered"
            raise Unanswered(f"{problem}; it may be carried out all the same")

        try:
            text = await self.audit.attempt(operator, name, watch.node, change, body)
        finally:
            watch.refresh()
        return JSONResponse({"text": text})

    async def _what_if(self, request: Request) -> Response:
        watch, operator = self._node(request), operator_of(request)
        description = _described(watch)
        question = read_body(WhatIf, await request.body())

        def simulate() -> Response:
            with self.watch.without_branches(watch.node) as on_branch:
                answer = what_if(self._bus, description, question, operator, self._settings.controllers, on_branch)
            if question.controller is not None:
                has_keys = bool(self._settings.node_settings.get("keys"))
                answer["command"] = question.controller.command(
                    watch.node, question.priority, self._bus.endpoint, has_keys=has_keys
                )
            return _json(answer)

        return await self._call(watch, simulate)

    # Dashboards of others

    async def _metrics(self, _: Request) -> Response:
        return PlainTextResponse(prometheus(self.watch), media_type=METRICS_TYPE)

    async def _grafana_metrics(self, _: Request) -> Response:
        return JSONResponse(grafana_targets(self.watch))

    async def _grafana_variable(self, request: Request) -> Response:
        return _json(grafana_variable(self.watch, read_body(GrafanaVariableQuery, await request.body())))

    async def _grafana_query(self, request: Request) -> Response:
        query = read_body(GrafanaQuery, await request.body())

        async def series(node: str, points: list[str]) -> GrafanaSeries:
            watch, end_s = self.watch.find(node), time.monotonic() + _TURN_S
            while self._pending[node] >= _MAX_PENDING and time.monotonic() < end_s:
                await asyncio.sleep(0.02)
            return await self._call(watch, lambda: grafana_series(watch, self._histories, points, query))

        return _json(await grafana_answer(query, series))

    def _node(self, request: Request) -> NodeWatch:
        return self.watch.find(request.path_params["node"])

    async def _call(self, watch: NodeWatch, function: Callable[[], T]) -> T:
        """Call a function that waits for a node, in a thread.

        Raises:
            RequestRejected: too many requests wait for this node.
        """
        if self._pending[watch.node] >= _MAX_PENDING:
            raise RequestRejected(f"{_MAX_PENDING} requests to node {watch.node!r} wait for replies; try again later")
        self._pending[watch.node] += 1
        try:
            return await asyncio.to_thread(function)
        finally:
            self._pending[watch.node] -= 1


def _described(watch: NodeWatch) -> NodeDescription:
    """Return the description of a node; `RequestRejected` before its first poll."""
    if watch.description is None:
        raise RequestRejected("the node has not answered yet")
    return watch.description


def _json(content: Any) -> Response:
    return Response(to_json(content), media_type="application/json")


_LONG = re.compile(r"([^\s']{300})[^\s']+")
"""A long word of an error, such as a name that somebody has made up: it is cut."""

_STATUS = (
    (Unanswered, 504),
    (NameInUse, 409),
    (RequestRejected, 409),
    (UsageError, 400),
    (BusError, 404),
    (PeerError, 502),
)


async def _failure(_: Request, error: Exception) -> Response:
    status = next((code for kind, code in _STATUS if isinstance(error, kind)), 500)
    return JSONResponse({"error": type(error).__name__, "message": _LONG.sub(r"\1…", str(error))}, status)
