"""The tools by name, and a call of one: checked, written to the audit log, answered with data or an error."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from typing import Any

from zenostat.topics import codec
from zenostat.topics.errors import UnknownName, ZenostatError, did_you_mean
from zenostat.views.mcp.content import Content
from zenostat.views.mcp.desk import Desk
from zenostat.views.mcp.explaining import ExplainBuilding
from zenostat.views.mcp.futures import CompareWithBaseline, MakeReport, WhatIf
from zenostat.views.mcp.reading import (
    FindPoints,
    ListNodes,
    Plot,
    ReadAlarms,
    ReadEvents,
    ReadHistory,
    ReadPoints,
    ReadPriorities,
    ReadZones,
)
from zenostat.views.mcp.tool import Tool
from zenostat.views.mcp.writing import Relinquish, Write

_ALL: tuple[type[Tool], ...] = (
    ListNodes, ExplainBuilding, FindPoints, ReadZones, ReadPoints, ReadPriorities, ReadHistory, Plot, ReadAlarms,
    ReadEvents, WhatIf, CompareWithBaseline, MakeReport, Write, Relinquish,
)  # fmt: skip
TOOLS: Mapping[str, type[Tool]] = {tool.name: tool for tool in _ALL}
"""All tools by name."""


def offered(desk: Desk) -> list[type[Tool]]:
    """Return the tools that a server offers: those that write only if it may."""
    return [tool for tool in _ALL if desk.writer is not None or not tool.writes]


def call(desk: Desk, name: str, arguments: Mapping[str, Any]) -> tuple[Content, bool]:
    """Call a tool; return its result, and whether that is an error."""
    try:
        return _read(name, arguments).run(desk), False
    except ZenostatError as error:
        return failure(error), True
    except Exception as error:  # a mistake of ours must not end the server, nor show a model more than its kind
        traceback.print_exc()
        message = "the tool failed; the server's log has the reason"
        return Content({"error": type(error).__name__, "message": message}), True


def failure(error: ZenostatError) -> Content:
    """Return the result of a call that failed; its text may have texts from the bus."""
    return Content({"error": type(error).__name__, "message": str(error)})


def _read(name: str, arguments: Mapping[str, Any]) -> Tool:
    """Return a tool with its checked arguments.

    Raises:
        UnknownName: there is no tool of that name.
        InvalidConfig: arguments of other names, or values out of range.
    """
    kind = TOOLS.get(name)
    if kind is None:
        raise UnknownName(f"no tool {name!r}; {did_you_mean(name, TOOLS)}")
    return codec.validated(kind, arguments)
