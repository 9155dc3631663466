"""The HTTP service: BOPTEST's routes, and those beyond it."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Coroutine, MutableMapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakValueDictionary

from fastapi import FastAPI, Request, Response
from pydantic_core import to_json
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect
from starlette.responses import HTMLResponse, PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from zenostat.gateways.boptest import parsing
from zenostat.gateways.boptest.access import TestAccess, UnknownToken, check_sender
from zenostat.gateways.boptest.manager import TestManager, TooManyTests, UnknownTest
from zenostat.gateways.boptest.operations import OPERATIONS, Operation
from zenostat.gateways.boptest.page import page
from zenostat.gateways.boptest.parsing import BadRequest, PeriodNotOver
from zenostat.gateways.clients import UNRESTRICTED, Clients
from zenostat.topics import VERSION
from zenostat.topics.errors import AccessDenied, UnknownName, UsageError, ZenostatError

Handler = Callable[..., Coroutine[Any, Any, Response]]

_SPARE_THREADS = 8
_MAX_QUEUED = 32
"""Maximum number of requests of a test that wait for one in progress."""

BOPTEST_VERSION = "0.9.0"
"""The version of BOPTEST whose interface this is, as `/version` returns it."""


@dataclass(slots=True, eq=False, weakref_slot=True)
class _Queue:
    """The requests of a test.

    Attributes:
        turn: held by the one in progress.
        count: number of them, that one included.
    """

    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    count: int = 0


class Service:
    """The application, and counts of what it answered.

    Args:
        manager: the tests.
        single: serve the paths without a test id.
        clients: names of clients, and what they may write.

    Attributes:
        testid: the test of the paths without a test id.
        app: the application, without the counts.
        is_local: whether only this machine reaches it, so that it answers to no other name.
        counts: numbers of answers by HTTP status.
    """

    def __init__(self, manager: TestManager, *, single: bool = False, clients: Clients = UNRESTRICTED) -> None:
        self.manager, self.counts = manager, Counter[int]()
        self._access = TestAccess(clients, manager.notify)
        self.testid, self._single, self.is_local = "", single, False
        self._handlers: dict[tuple[str, str], Handler] = {}
        # A test starts in a thread and has one request at a time in another; the spare ones manage tests.
        self._threads = ThreadPoolExecutor(2 * manager.max_tests + _SPARE_THREADS, "boptest")
        self._queues: WeakValueDictionary[str, _Queue] = WeakValueDictionary()
        self.app = FastAPI(
            title="BOPTEST on Zenostat",
            version=VERSION,
            description="BOPTEST's interface to EnergyPlus buildings.",
            docs_url=None,
            redoc_url=None,
            redirect_slashes=False,
        )
        self._declare()

    def _declare(self) -> None:
        add = self.app.add_api_route
        management: tuple[tuple[str, str, str, Handler], ...] = (
            ("GET", "/version", "Version of the interface", self._version),
            ("GET", "/testcases", "Names of the test cases", self._testcases),
            ("POST", "/testcases/{name}/select", "Start a test, and wait until it runs", self._select),
            ("POST", "/testcases/{namespace}/{name}/select", "Start a test, and wait until it runs", self._select),
            ("POST", "/testcases/{name}/select-async", "Start a test in the background", self._select_async),
            ("GET", "/status/{testid}", "Queued or Running", self._status),
            ("PUT", "/stop/{testid}", "End a test", self._stop),
            ("POST", "/branch/{testid}", "Start a test that continues from here independently", self._branch),
        )
        for method, path, summary, handler in management:
            tag = "Beyond BOPTEST" if path.startswith("/branch") else "Test management"
            add(path, handler, methods=[method], summary=summary, tags=[tag], response_model=None)
        for operation in OPERATIONS:
            handler = self._handlers[operation.method, operation.path[1:]] = self._handler(operation)
            paths = [f"{operation.path}/{{testid}}", *([operation.path] if self._single else [])]
            for path in paths:
                add(
                    path,
                    handler,
                    methods=[operation.method],
                    summary=operation.summary,
                    tags=[operation.tag],
                    response_model=None,
                    operation_id=f"{operation.method.lower()}{path.replace('/{testid}', '_of_test').replace('/', '_')}",
                    openapi_extra=operation.schema(),
                )
        add("/", self._page, methods=["GET"], include_in_schema=False)
        add("/docs", self._page, methods=["GET"], include_in_schema=False)
        self.app.add_exception_handler(404, self._not_found)
        self.app.add_exception_handler(405, self._not_allowed)
        self.app.add_exception_handler(ZenostatError, self._refused)

    def close(self) -> None:
        """End all tests; idempotent."""
        self.manager.close()
        self._threads.shutdown()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request, and count its answer by status."""

        async def counted(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                self.counts[message["status"]] += 1
            await send(message)

        answer: ASGIApp = self.app
        try:
            check_sender(Headers(scope=scope), is_local=self.is_local)
            if (request := self._operation_request(scope, receive)) is not None:
                answer = await self._handlers[request.method, request.path_params["operation"]](request)
        except ZenostatError as error:
            answer = self._error(error)
        await answer(scope, receive, counted)

    def _operation_request(self, scope: Scope, receive: Receive) -> Request | None:
        """Return a request of an operation of a test, without the routes and middleware; None for other requests."""
        operation, _, testid = scope["path"][1:].partition("/")
        if (scope["method"], operation) not in self._handlers or not testid or "/" in testid:
            return None
        scope["path_params"] = {"operation": operation, "testid": testid}
        return Request(scope, receive)

    # Answers

    def _answer(self, status: int, content: Any) -> Response:
        return Response(to_json(content, inf_nan_mode="null"), status, media_type="application/json")

    def _text(self, status: int, text: str) -> Response:
        return PlainTextResponse(text, status)

    def _envelope(self, status: int, message: str, payload: Any) -> Response:
        return self._answer(status, {"status": status, "message": message, "payload": payload})

    def _error(self, error: Exception) -> Response:
        if isinstance(error, UnknownTest):
            testid = str(error)[:200]
            message = {
                "type": "field", "value": testid, "msg": f"Invalid testid: {testid}", "path": "testid",
                "location": "params",
            }  # fmt: skip
            return self._answer(400, {"errors": [message]})
        if isinstance(error, UnknownToken):
            answer = self._envelope(401, "Unauthorized", str(error))
            answer.headers["WWW-Authenticate"] = "Bearer"
            return answer
        if isinstance(error, AccessDenied):
            return self._envelope(403, "Forbidden", str(error))
        if isinstance(error, BadRequest):
            return self._envelope(400, "Bad Request", str(error))
        if isinstance(error, PeriodNotOver):
            return self._envelope(500, str(error), None)
        return self._text(500, f"{type(error).__name__}: {error}")

    async def _not_found(self, _: Request, __: Exception) -> Response:
        return self._text(404, "Not Found")

    async def _not_allowed(self, _: Request, __: Exception) -> Response:
        return self._text(405, "Method Not Allowed")

    async def _refused(self, _: Request, error: Exception) -> Response:
        return self._error(error)

    async def _run_alone(self, testid: str, work: Callable[[], Response]) -> Response:
        """Run work when the earlier requests of its test have ended; those that wait occupy no thread."""
        queue = self._queues.setdefault(testid, _Queue())
        if queue.count > _MAX_QUEUED:
            return self._text(503, f"{_MAX_QUEUED} requests of this test are waiting already")
        queue.count += 1
        try:
            async with queue.turn:
                return await self._run(work)
        except asyncio.CancelledError:
            return self._text(503, "the service has ended")
        finally:
            queue.count -= 1

    async def _run(self, work: Callable[[], Response]) -> Response:
        try:
            return await asyncio.get_running_loop().run_in_executor(self._threads, work)
        except asyncio.CancelledError:  # the service ends, and does not wait for this request any longer
            return self._text(503, "the service has ended")
        except ZenostatError as error:
            return self._error(error)
        except Exception as error:  # an error of this program must not end the service, and is not the client's
            self.manager.notify(f"internal error: {type(error).__name__}: {error}")
            return self._text(500, f"internal error: {type(error).__name__}: {error}")

    # A test

    def _handler(self, operation: Operation) -> Handler:
        async def handle(request: Request) -> Response:
            testid = request.path_params.get("testid", self.testid)
            client = self._access.client(request.headers)
            fields = await _fields(request) if operation.takes_fields else {}

            def work() -> Response:
                with self.manager.use(testid) as test:
                    self._access.check_operation(client, operation, test, fields)
                    try:
                        message, payload = operation.call(test, fields)
                    except ZenostatError:
                        if not test.is_stopped:
                            raise
                    if test.is_stopped:
                        return self._text(500, f"the test was stopped during /{operation.path[1:]}")
                    return self._envelope(200, message, payload)

            return await self._run_alone(testid, work)

        return handle

    async def _branch(self, request: Request, testid: str) -> Response:
        client, fields = self._access.client(request.headers), await _fields(request)

        def work() -> Response:
            self._access.check_change(client, self.manager.client_of(testid))
            return self._answer(200, {"testid": self.manager.branch(testid, fields)})

        return await self._run_alone(testid, work)

    # Test management

    async def _version(self) -> Response:
        return self._envelope(200, "Queried the version number successfully.", {"version": BOPTEST_VERSION})

    async def _testcases(self) -> Response:
        return await self._run(lambda: self._answer(200, [{"testcaseid": name} for name in self.manager.cases.names()]))

    async def _select(self, request: Request) -> Response:
        return await self._start(request, self.manager.select)

    async def _select_async(self, request: Request) -> Response:
        return await self._start(request, self.manager.select_async)

    async def _start(self, request: Request, start: Callable[[str, str], str]) -> Response:
        client = self._access.client(request.headers)
        name = "/".join(request.path_params[part] for part in ("namespace", "name") if part in request.path_params)

        def work() -> Response:
            self._access.check_start(client)
            try:
                return self._answer(200, {"testid": start(name, client)})
            except UnknownName as error:
                return self._text(404, f"Not Found: {error}")
            except TooManyTests as error:
                return self._text(503, str(error))
            except UsageError as error:
                return self._text(400, str(error))

        await _body(request)
        return await self._run(work)

    async def _status(self, testid: str) -> Response:
        return await self._run(lambda: self._answer(200, self.manager.status(testid)))

    async def _stop(self, request: Request, testid: str) -> Response:
        client = self._access.client(request.headers)

        def work() -> Response:
            self._access.check_change(client, self.manager.client_of(testid))
            self.manager.stop(testid)
            return self._text(200, "OK")

        return await self._run(work)

    async def _page(self) -> Response:
        return HTMLResponse(page(self.app.openapi()))


async def _body(request: Request) -> bytes:
    """Read a request's body up to a limit."""
    chunks, size = [], 0
    try:
        async for chunk in request.stream():
            size += len(chunk)
            if size > parsing.MAX_BYTES:
                raise BadRequest(f"the body has more than {parsing.MAX_BYTES} bytes")
            chunks.append(chunk)
    except ClientDisconnect:
        raise BadRequest("the client disconnected") from None
    return b"".join(chunks)


async def _fields(request: Request) -> dict[str, Any]:
    return parsing.parse_body(await _body(request), request.headers.get("content-type", ""))
