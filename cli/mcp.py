"""`zenostat mcp`: tools for language models, over the Model Context Protocol."""

from __future__ import annotations

import asyncio
import os
import secrets
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from zenostat.cli.console import out
from zenostat.cli.options import DEFAULTS, BusOptions, on_bus
from zenostat.cli.token_file import read_token
from zenostat.topics.calendar import parse_duration
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import import_extra
from zenostat.topics.keys import Role, check_name

VIA = "mcp"
"""Way in that recordings show."""


@on_bus
def mcp(
    options: BusOptions = DEFAULTS,
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="Serve HTTP on this address of this machine, such as 127.0.0.1:8700. Default: one client over "
            "standard input and output.",
        ),
    ] = None,
    token_file: Annotated[
        Path | None,
        typer.Option(
            help="File with the token of HTTP clients; created if it is missing. Default: a new one, printed."
        ),
    ] = None,
    allow_writes: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN[=LOW:HIGH]",
            help="Actuators that may be written, with * and ?, and the range of their values; repeatable. Default: "
            "none, the server reads and asks what-if.",
        ),
    ] = None,
    priority: Annotated[
        int, typer.Option(min=9, max=16, help="Priority of writes, below people (8) and controllers (10).")
    ] = 14,
    max_duration: Annotated[
        str, typer.Option(metavar="TIME", help="Longest simulated time until a write is relinquished.")
    ] = "4h",
    writes_per_minute: Annotated[int, typer.Option(min=1, max=600, help="Largest number of writes a minute.")] = 6,
    audit_log: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Append all calls as JSON lines. Default: standard error.")
    ] = None,
    reports: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for reports as HTML files. Default: none is written.")
    ] = None,
    name: Annotated[str, typer.Option(help="Name of this server on the bus, the source of its writes.")] = "mcp",
) -> None:
    """Serve tools for language models (MCP): read, plot, ask what-if, and write if that is allowed.

    Example: `zenostat mcp --allow-writes '*_cooling_setpoint=22:28' --audit-log calls.jsonl`

    With keys, it uses the gateway role.
    """
    import_extra("mcp", "mcp", "the MCP server")  # first: the extra has all that the modules below need as well
    from zenostat.views.mcp.call_log import CallLog
    from zenostat.views.mcp.desk import Desk
    from zenostat.views.mcp.server import MAX_RUNNING, HttpToolServer, ToolServer
    from zenostat.views.mcp.writer import WriteLimits, Writer, WriteRule

    check_name(name, "--name")
    if reports is not None and not reports.is_dir():
        raise InvalidConfig(f"--reports {reports}: expected a folder")
    if token_file is not None and address is None:
        raise InvalidConfig("--token-file: only with --address")
    rules = [WriteRule.parse(text) for text in allow_writes or ()]
    longest_s = parse_duration(max_duration, "--max-duration")
    limits = WriteLimits(rules, priority, longest_s, writes_per_minute) if rules else None
    token = secrets.token_urlsafe(32) if token_file is None else read_token(token_file, "--token-file")
    with ExitStack() as stack:
        log = stack.enter_context(CallLog(audit_log))
        threads = stack.enter_context(ThreadPoolExecutor(MAX_RUNNING))  # waited for once the bus is closed
        bus = stack.enter_context(options.open_bus(Role.GATEWAY))
        bus.via = VIA
        writer = None if limits is None else Writer(bus, name, limits)
        server = ToolServer(stack.enter_context(Desk(bus, name, writer=writer, reports=reports)), log, threads)
        if address is None:
            # A thread may wait for input, so the program cannot end by itself; all it has ends with its process.
            stack.enter_context(override_signals(lambda number, _: os._exit(128 + number), *TERMINATION_SIGNALS))
            asyncio.run(server.serve_stdio())
            return
        http = stack.enter_context(HttpToolServer(server, address, token))
        stack.enter_context(override_signals(lambda *_: http.stop(), *TERMINATION_SIGNALS))
        out.print(f"ready: {http.url}")
        where = f"in {token_file}" if token_file is not None else token
        out.print(f"Clients send the token as a bearer token: {where}")
        http.run()
