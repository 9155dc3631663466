"""The scenario builder: its form, the check of a scenario, and starting a node from it.

A scenario of a page is data. It is checked, saved and simulated without choosing any code, and it names files in the
folder of scenarios only. Without that folder, it is checked and shown as YAML, and nothing is saved or started.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig, NameInUse, RequestRejected
from zenostat.topics.keys import check_name
from zenostat.topics.messages import Mode
from zenostat.topics.plurals import counted
from zenostat.views.room.access import check_name_of, operator_of
from zenostat.views.room.audit import AuditLog
from zenostat.views.room.requests import NodeName, RoomRequest, Speed, read_body
from zenostat.views.room.scenario_program import ScenarioProgram
from zenostat.views.room.started_nodes import StartedNodes

ScenarioName = Annotated[str, AfterValidator(check_name_of)]

_Answer = dict[str, str]
"""Answer to a change: its `text`, and the `digest` of a file that was saved."""


class CheckScenario(RoomRequest):
    """Check a scenario: its fields, and the name that its file would have."""

    fields: dict[str, Any]
    name: ScenarioName = "scenario"


class SaveScenario(CheckScenario):
    """Save a scenario in the folder of scenarios.

    An earlier one is replaced if `overwrite` says so, or if its file has the digest `replaces`: that of the file which
    was opened or saved before.
    """

    overwrite: bool = False
    replaces: Annotated[str, Field(max_length=64)] | None = None


class StartNode(SaveScenario):
    """Save a scenario, and start a node from it."""

    node: NodeName
    mode: Literal["lockstep", "paced", "free"] = Mode.PACED.value
    speed: Speed = 60.0


class StopNode(RoomRequest):
    """End a node that was started from the page."""

    node: NodeName


class Builder:
    """The routes of the scenario builder.

    Args:
        folder: of scenarios; None: they are neither saved nor started.
        nodes: starts nodes.
        audit: receives what is saved, started and ended.
        is_online: whether a node of a name is on the bus.
    """

    def __init__(
        self, folder: Path | None, nodes: StartedNodes, audit: AuditLog, is_online: Callable[[str], bool]
    ) -> None:
        self._folder, self._nodes, self._audit, self._is_online = folder, nodes, audit, is_online
        self._program, self._writing = ScenarioProgram(folder), threading.Lock()
        self.routes = [
            Route("/api/builder", self._form),
            Route("/api/builder/points", self._points),
            Route("/api/builder/scenario", self._read),
            Route("/api/builder/check", self._check, methods=["POST"]),
            Route("/api/builder/save", self._save, methods=["POST"]),
            Route("/api/builder/start", self._start, methods=["POST"]),
            Route("/api/builder/stop", self._stop, methods=["POST"]),
        ]

    def close(self) -> None:
        """End the program that answers."""
        self._program.close()

    async def _form(self, _: Request) -> Response:
        content = await asyncio.to_thread(self._program.ask, "form")
        return JSONResponse(content | {"can_start": self._folder is not None, "started": self._nodes.content()})

    async def _points(self, request: Request) -> Response:
        query = request.query_params
        arguments = {name: query.get(name, "")[:500] for name in ("building", "search", "kind")}
        default = query.get("default") == "1"
        return JSONResponse(await asyncio.to_thread(self._program.ask, "points", **arguments, default=default))

    async def _read(self, request: Request) -> Response:
        name = request.query_params.get("name", "")
        return JSONResponse(await asyncio.to_thread(self._program.ask, "read", name=name))

    async def _check(self, request: Request) -> Response:
        asked = read_body(CheckScenario, await request.body())
        return JSONResponse(await asyncio.to_thread(self._checked, asked))

    def _checked(self, asked: CheckScenario) -> dict[str, Any]:
        answer: dict[str, Any] = self._program.ask("check", fields=asked.fields, name=asked.name)
        return answer

    async def _save(self, request: Request) -> Response:
        asked = read_body(SaveScenario, await request.body())
        return await self._audited(request, "save scenario", asked.name, lambda: self._write(asked))

    async def _start(self, request: Request) -> Response:
        asked = read_body(StartNode, await request.body())
        operator = operator_of(request)
        return await self._audited(request, "start node", asked.node, lambda: self._run(asked, operator))

    async def _stop(self, request: Request) -> Response:
        node = read_body(StopNode, await request.body()).node
        return await self._audited(request, "end node", node, lambda: self._end(node))

    async def _audited(
        self, request: Request, operation: str, target: str, function: Callable[[], _Answer]
    ) -> Response:
        """Call a function in a thread, add its outcome to the audit log, and return its answer."""
        answer: _Answer = {}

        def change() -> str:
            answer.update(function())
            return answer["text"]

        await self._audit.attempt(operator_of(request), operation, target, lambda: asyncio.to_thread(change))
        return JSONResponse(answer)

    # In threads

    def _write(self, asked: SaveScenario, *, may_have_errors: bool = True) -> _Answer:
        """Save a scenario, and return the answer."""
        path = self._path(asked.name)
        answer = self._checked(asked)
        if answer["is_refused"] or (answer["errors"] and not may_have_errors):
            raise InvalidConfig("\n".join(answer["errors"]))
        content = answer["yaml"].encode()
        try:
            with self._writing:
                if path.exists() and not asked.overwrite:
                    _check_replaced(asked, path.read_bytes())
                with atomic_file(path) as temporary:
                    temporary.write_bytes(content)
        except OSError as error:
            raise InvalidConfig(f"{path}: {error.strerror}") from None
        errors = f", with {counted(len(answer['errors']), 'error')}" if answer["errors"] else ""
        return {"text": f"saved as {path.name}{errors}", "digest": sha256(content).hexdigest()}

    def _run(self, asked: StartNode, operator: str) -> _Answer:
        path = self._path(asked.name)
        check_name(asked.node, "the node's name")
        if self._is_online(asked.node):
            raise NameInUse(f"a node {asked.node!r} is on the bus already; choose another name")
        saved = self._write(asked, may_have_errors=False)
        pace = {"mode": asked.mode} | ({"speed": asked.speed} if asked.mode == Mode.PACED.value else {})
        self._nodes.start(path, asked.node, operator, pace)
        return saved | {"text": f"{saved['text']}; node {asked.node} is starting"}

    def _end(self, node: str) -> _Answer:
        self._nodes.stop(node)
        return {"text": f"node {node} is ending"}

    def _path(self, name: str) -> Path:
        if self._folder is None:
            raise RequestRejected(
                "the control room has no folder of scenarios; start it with --scenarios FOLDER to save them and to "
                "start nodes"
            )
        return self._folder / f"{name}.yaml"


def _check_replaced(asked: SaveScenario, present: bytes) -> None:
    """Raise `NameInUse` unless the file's present content is the one that a scenario replaces."""
    if asked.replaces is None:
        raise NameInUse(f"there is a scenario {asked.name!r} already; choose another name, or replace it")
    if asked.replaces != sha256(present).hexdigest():
        raise NameInUse(f"scenario {asked.name!r} has changed since it was opened; open it again, or replace it")
