"""The MCP server: tools over standard input and output, or over HTTP for programs of this machine."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from threading import BoundedSemaphore
from typing import Any

from zenostat.topics import VERSION
from zenostat.topics.errors import RequestRejected
from zenostat.topics.extras import requires_extra
from zenostat.views.mcp.call_log import CallLog
from zenostat.views.mcp.content import NOTICE, Content, render
from zenostat.views.mcp.desk import Desk
from zenostat.views.mcp.tools import call, failure, offered

with requires_extra("mcp", "the MCP server", "the MCP SDK"):
    from mcp import types
    from mcp.server.lowlevel import Server
    from mcp.server.stdio import stdio_server
    from mcp.server.transport_security import TransportSecuritySettings

    from zenostat.bridge.http.server import HttpServer, LoopbackServer, host_and_port, listen
    from zenostat.views.room.access import Access, Guard

DEFAULT_ADDRESS = "127.0.0.1:8700"
PATH = "/mcp"
"""Path of the endpoint over HTTP."""

MAX_RUNNING = 8
"""Largest number of calls that run at a time."""

_MAX_SESSIONS = 256
_IDLE_S = 300.0
"""Time after which a session without a request or an open stream ends: many clients leave theirs open."""

_MAX_BODY_BYTES = 256 * 1024
_INSTRUCTIONS = (
    "Tools for buildings that are simulated on a Zenostat bus. Begin with list_nodes, then explain_building. Times are "
    "simulated local standard time. what_if and compare_with_baseline simulate copies; the building does not change. "
    f"{NOTICE}"
)
_READ_ONLY = "This server only reads and asks what-if."
_WRITING = (
    "Values are written at a low priority and expire. Write only what the user has asked for, after what_if has shown "
    "its effect."
)


class ToolServer:
    """The tools of a desk for MCP clients.

    Args:
        desk: what the tools use.
        log: log of all calls.
        threads: threads in which calls run, as many as can run at a time.

    Attributes:
        desk: what the tools use.
        sdk: the server of the SDK.
    """

    def __init__(self, desk: Desk, log: CallLog, threads: ThreadPoolExecutor) -> None:
        self.desk, self._log = desk, log
        self._threads, self._free = threads, BoundedSemaphore(MAX_RUNNING)
        mode = _READ_ONLY if desk.writer is None else _WRITING
        self.sdk: Any = Server(
            "zenostat",
            version=VERSION,
            instructions=f"{_INSTRUCTIONS} {mode}",
            on_list_tools=self._list_tools,
            on_call_tool=self._call_tool,
        )

    async def serve_stdio(self) -> None:
        """Serve one client over standard input and output until it closes the input."""
        async with stdio_server() as (receiving, sending):
            await self.sdk.run(receiving, sending, self.sdk.create_initialization_options())

    async def _list_tools(self, _: Any, __: Any) -> types.ListToolsResult:
        return types.ListToolsResult(
            tools=[
                types.Tool(
                    name=tool.name,
                    description=tool.description(),
                    input_schema=tool.input_schema(),
                    annotations=types.ToolAnnotations(
                        read_only_hint=not tool.writes, destructive_hint=tool.writes, open_world_hint=False
                    ),
                )
                for tool in offered(self.desk)
            ]
        )

    async def _call_tool(self, context: Any, request: types.CallToolRequestParams) -> types.CallToolResult:
        if not self._free.acquire(blocking=False):
            return _result(failure(RequestRejected(f"{MAX_RUNNING} calls are running; try again later")), is_error=True)
        arguments = request.arguments or {}
        running = self._threads.submit(self._call, _client(context), request.name, arguments)
        running.add_done_callback(lambda _: self._free.release())
        return await asyncio.wrap_future(running)

    def _call(self, client: str, name: str, arguments: Mapping[str, Any]) -> types.CallToolResult:
        try:
            number = self._log.begin(client, name, arguments)
            content, is_error = call(self.desk, name, arguments)
            self._log.end(number, f"{content.data['error']}: {content.data['message']}" if is_error else "ok")
        except RequestRejected as error:  # of the audit log
            content, is_error = failure(error), True
        return _result(content, is_error=is_error)


class HttpToolServer(HttpServer):
    """The tools over streamable HTTP, for programs of this machine that have the token.

    Args:
        tools: what is served.
        address: `HOST:PORT` of the loopback interface; port 0 chooses a free one.
        token: bearer token of all requests.

    Attributes:
        url: of the endpoint.

    Raises:
        InvalidConfig: a malformed address, or one that other machines can reach.
        AddressInUse: another program listens there.
    """

    def __init__(self, tools: ToolServer, address: str, token: str) -> None:
        listening = listen(address, DEFAULT_ADDRESS, "this server")
        host, port = host_and_port(listening)
        hosts = frozenset({f"{host}:{port}", f"localhost:{port}"})
        security = TransportSecuritySettings(allowed_hosts=sorted(hosts), allowed_origins=[])
        app = tools.sdk.streamable_http_app(
            streamable_http_path=PATH,
            max_request_body_size=_MAX_BODY_BYTES,
            session_idle_timeout=_IDLE_S,
            max_sessions=_MAX_SESSIONS,
            transport_security=security,
        )
        access = Access(hosts, "", api_token=token, program_paths=("/",), hint="see --token-file")
        super().__init__(listening, f"http://{host}:{port}{PATH}", LoopbackServer(Guard(app, access)))


def _client(context: Any) -> str:
    """Return the name and version that a client states of itself."""
    params = context.session.client_params
    return "" if params is None else f"{params.client_info.name} {params.client_info.version}"


def _result(content: Content, *, is_error: bool) -> types.CallToolResult:
    blocks: list[Any] = [types.TextContent(text=render(content.data))]
    if content.picture:
        data = base64.b64encode(content.picture).decode("ascii")
        blocks.append(types.ImageContent(data=data, mime_type="image/png"))
    return types.CallToolResult(content=blocks, is_error=is_error)
