"""Pages of trainings: their list and curves, a report of each, and a node that its policy controls."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from pydantic import Field
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from zenostat.agent_sdk.controllers.training_folder import SCENARIO, model_file
from zenostat.bridge.runtime.processes import ZENOSTAT, end_processes
from zenostat.topics.errors import NameInUse, RequestRejected, UnknownName
from zenostat.topics.messages import Mode
from zenostat.views.report.document import REPORT_SCRIPT
from zenostat.views.room.access import operator_of
from zenostat.views.room.audit import AuditLog
from zenostat.views.room.numbers import to_json
from zenostat.views.room.requests import NodeName, RoomRequest, Speed, read_body
from zenostat.views.room.started_nodes import StartedNodes
from zenostat.views.room.trainings import REPORT, Trainings

_DIGEST = base64.b64encode(hashlib.sha256(REPORT_SCRIPT.encode()).digest()).decode()
REPORT_POLICY = (
    "sandbox allow-scripts allow-popups; default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    f"script-src 'sha256-{_DIGEST}'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Policy of reports: their styles, and the script of this version; a sandbox keeps them apart from the page."""

_LONGEST_ERROR = 1000
_END_S = 10.0


class TrainingName(RoomRequest):
    """A training of the folder."""

    name: Annotated[str, Field(max_length=1000)]


class StartFromTraining(TrainingName):
    """Start a node: from a training with its best model as the controller, or from a recording in its folder."""

    node: NodeName
    speed: Speed = 3600.0


class TrainingPages:
    """The routes of trainings.

    Args:
        trainings: the folder; None: there are none.
        nodes: starts nodes.
        audit: receives what is started.
        is_online: whether a node of a name is on the bus.
    """

    def __init__(
        self, trainings: Trainings | None, nodes: StartedNodes, audit: AuditLog, is_online: Callable[[str], bool]
    ) -> None:
        self._folder, self._nodes, self._audit, self._is_online = trainings, nodes, audit, is_online
        self._reports = _Reports()
        self.routes = [
            Route("/api/trainings", self._list),
            Route("/api/trainings/curve", self._curve),
            Route("/api/trainings/report", self._make_report, methods=["POST"]),
            Route("/api/trainings/report", self._report),
            Route("/api/trainings/watch", self._watch, methods=["POST"]),
            Route("/api/trainings/replay", self._replay, methods=["POST"]),
        ]

    @property
    def _trainings(self) -> Trainings:
        if self._folder is None:
            raise RequestRejected("the control room has no folder of trainings; start it with --trainings FOLDER")
        return self._folder

    def close(self) -> None:
        """End a report that is being made."""
        self._reports.close()

    async def _list(self, _: Request) -> Response:
        content = await asyncio.to_thread(self._trainings.content)
        return Response(to_json({**content, "reports": self._reports.states()}), media_type="application/json")

    async def _curve(self, request: Request) -> Response:
        name, metric = (request.query_params.get(field, "") for field in ("name", "metric"))
        curve = await asyncio.to_thread(self._trainings.curve, name, metric)
        return Response(to_json(curve), media_type="application/json")

    async def _report(self, request: Request) -> Response:
        run = await asyncio.to_thread(self._trainings.run, request.query_params.get("name", ""))
        path = run.folder / REPORT
        if path.is_symlink() or not path.is_file():
            raise UnknownName(f"the training {run.name} has no report yet")
        headers = {"content-security-policy": REPORT_POLICY, "cache-control": "no-store"}
        return FileResponse(path, media_type="text/html; charset=utf-8", headers=headers)

    async def _make_report(self, request: Request) -> Response:
        name = read_body(TrainingName, await request.body()).name

        def make() -> str:
            run = self._trainings.run(name)
            model_file(run.folder)
            self._reports.make(name, run.folder)
            return f"the report of {name} is being made: its evaluation episodes are simulated"

        return await self._audited(request, "make report", name, make)

    async def _watch(self, request: Request) -> Response:
        asked = read_body(StartFromTraining, await request.body())
        operator = operator_of(request)

        def start() -> str:
            run = self._trainings.run(asked.name)
            model_file(run.folder)
            scenario = run.folder / SCENARIO
            if not scenario.is_file():
                raise UnknownName(f"the training {run.name} has no {SCENARIO}, from which a node could be started")
            self._check_free(asked.node)
            pace = {"mode": Mode.PACED.value, "speed": asked.speed}
            self._nodes.start(scenario, asked.node, operator, pace, controller=str(run.folder), title=run.name)
            return f"node {asked.node} is starting, controlled by {run.name}"

        return await self._audited(request, "watch training", asked.node, start)

    async def _replay(self, request: Request) -> Response:
        asked = read_body(StartFromTraining, await request.body())
        operator = operator_of(request)

        def start() -> str:
            file = self._trainings.recording(asked.name)
            self._check_free(asked.node)
            self._nodes.replay(file, asked.node, operator, asked.speed, title=asked.name)
            return f"the replay of {asked.name} is starting as node {asked.node}"

        return await self._audited(request, "replay recording", asked.node, start)

    def _check_free(self, node: str) -> None:
        if self._is_online(node):
            raise NameInUse(f"a node {node!r} is on the bus already; choose another name")

    async def _audited(self, request: Request, operation: str, target: str, function: Callable[[], str]) -> Response:
        text = await self._audit.attempt(operator_of(request), operation, target, lambda: asyncio.to_thread(function))
        return JSONResponse({"text": text})


class _Reports:
    """Reports that are being made, one at a time, each by a program."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._states: dict[str, dict[str, str]] = {}
        self._process: subprocess.Popen[str] | None = None
        self._is_closed = False

    def states(self) -> dict[str, dict[str, str]]:
        """Return the state of the latest report of each training: `making`, `made` or `failed`, and why."""
        with self._lock:
            return {name: dict(state) for name, state in self._states.items()}

    def make(self, name: str, folder: Path) -> None:
        """Begin to make a report.

        Raises:
            RequestRejected: another one is being made.
        """
        with self._lock:
            if self._is_closed or self._process is not None:
                raise RequestRejected("another report is being made; try again when it is there")
            command = [*ZENOSTAT, "report", str(folder), "--out", str(folder / REPORT)]
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                encoding="utf-8", errors="replace", process_group=0,
            )  # fmt: skip
            self._states[name] = {"state": "making", "text": ""}
            threading.Thread(target=self._follow, args=(name, self._process), name="report", daemon=True).start()

    def _follow(self, name: str, process: subprocess.Popen[str]) -> None:
        output, _ = process.communicate()
        failed = {"state": "failed", "text": output.strip()[-_LONGEST_ERROR:] or "it was ended"}
        with self._lock:
            self._states[name] = {"state": "made", "text": ""} if process.returncode == 0 else failed
            self._process = None

    def close(self) -> None:
        """End the program."""
        with self._lock:
            self._is_closed, process = True, self._process
        if process is not None:
            end_processes([process], _END_S)
