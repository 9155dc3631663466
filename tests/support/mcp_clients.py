"""An MCP server in this process, and clients of the SDK."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import zenostat
from support.http_servers import running
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.views.mcp.call_log import CallLog
from zenostat.views.mcp.content import read_data
from zenostat.views.mcp.desk import Desk
from zenostat.views.mcp.server import MAX_RUNNING, HttpToolServer, ToolServer
from zenostat.views.mcp.writer import WriteLimits, Writer, WriteRule

TOKEN = "t" * 40


@contextmanager
def tool_server(endpoint: str, audit: Path, *rules: str, reports: Path | None = None) -> Iterator[ToolServer]:
    """The tools of a bus; with rules, those that write as well."""
    with (
        CallLog(audit) as log,
        ThreadPoolExecutor(MAX_RUNNING) as threads,
        zenostat.connect(endpoint, affinity=Affinity.OFF, wait=True) as bus,
    ):
        bus.via = "mcp"
        writer = Writer(bus, "mcp", WriteLimits([WriteRule.parse(rule) for rule in rules])) if rules else None
        with Desk(bus, "mcp", writer=writer, reports=reports) as desk:
            yield ToolServer(desk, log, threads)


@contextmanager
def http_server(tools: ToolServer) -> Iterator[HttpToolServer]:
    """The tools over HTTP on a free port, in a thread."""
    with HttpToolServer(tools, "127.0.0.1:0", TOKEN) as server, running(server):
        yield server


@asynccontextmanager
async def http_client(url: str, token: str = TOKEN) -> AsyncIterator[Any]:
    """A client of the SDK over streamable HTTP."""
    from mcp import Client
    from mcp.client.streamable_http import streamable_http_client
    from mcp.shared._httpx_utils import create_mcp_http_client

    async with (
        create_mcp_http_client({"authorization": f"Bearer {token}"}) as http,
        Client(streamable_http_client(url, http_client=http)) as client,
    ):
        yield client


async def ask(client: Any, tool: str, **arguments: Any) -> Any:
    """The data of a result that is no error."""
    result = await client.call_tool(tool, arguments)
    assert not result.is_error, result.content[0].text
    return read_data(result.content[0].text)


async def refused(client: Any, tool: str, **arguments: Any) -> str:
    """The class and the text of an error."""
    result = await client.call_tool(tool, arguments)
    assert result.is_error, result.content[0].text
    error = read_data(result.content[0].text)
    return f"{error['error']}: {error['message']}"
