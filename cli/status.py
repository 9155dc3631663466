"""`zenostat status`: the nodes and controllers on a bus, with their state."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated

import typer

from zenostat.cli.console import out
from zenostat.cli.options import DEFAULTS, BusOptions, on_bus
from zenostat.cli.record import describe_recording
from zenostat.cli.statistics import milliseconds
from zenostat.cli.tables import show
from zenostat.topics.errors import NodeNotFound
from zenostat.topics.keys import Role
from zenostat.topics.messages import Mode, Status
from zenostat.topics.plurals import counted


@on_bus
def status(
    node: Annotated[str | None, typer.Argument(help="Show only this node; the exit code is 1 without it.")] = None,
    options: BusOptions = DEFAULTS,
) -> None:
    """List the nodes and controllers on a bus. With keys, it uses the monitor role.

    Example: `zenostat status`

    With a node it is a health check: the exit code is 1 unless the node answers and its episode has not failed.
    """
    with options.open_bus(Role.MONITOR) as bus:
        nodes = [] if node is None else [bus.status(node, memory=True)]
        for name in bus.nodes() if node is None else ():
            with suppress(NodeNotFound):  # a branch may end meanwhile
                nodes.append(bus.status(name, memory=True))
    if not nodes:
        out.print(f"no nodes on {options.endpoint}")
    for each in nodes:
        _print_node(each)
    _print_controllers(nodes)
    _print_forks(nodes)
    failed = [each for each in nodes if each.failure]
    for each in failed:
        out.print(f"{each.node}: {each.failure}", style="red")
    if failed and node is not None:
        raise typer.Exit(1)


def _print_node(node: Status) -> None:
    """Print a node's state as a table of two columns."""
    memory = f"node {_mb(node.node_rss_bytes)}, engines {_mb(node.engine_rss_bytes)}"
    messages = f"{node.accepted} accepted, {node.rejected} rejected, {node.late} late, {node.duplicate} duplicate"
    messages += f", {node.statistics.rate_limited} rate limited" if node.statistics.rate_limited else ""
    rows = {
        "state": f"{node.state} ({_pace(node)})",
        "fallback policy": _policy(node),
        "building": ", ".join(filter(None, (node.building, node.weather))),
        "episode": f"{node.episode[0]}, step {node.step[0]} of {node.steps}",
        "simulated time": node.time[0],
        "commands": messages,
        "memory": f"{memory}, of which {_mb(node.engine_private_bytes)} private",
    }
    if node.waiting:
        rows["waits"] = node.waiting
    if node.recording is not None:
        rows["recording"] = describe_recording(node.recording)
    show("", ("node", node.node), list(rows.items()), wrap=(node.node,))


def _pace(node: Status) -> str:
    pace = f"{node.mode}, {node.speed:g} times the wall clock" if node.mode is Mode.PACED else str(node.mode)
    return f"{pace}, paused" if node.paused else pace


def _policy(node: Status) -> str:
    missed = node.statistics.missed
    return f"{node.policy}; applied in {counted(missed, 'timestep')}" if missed else str(node.policy)


def _mb(size: int) -> str:
    return f"{size / 1e6:.0f} MB"


def _print_forks(nodes: list[Status]) -> None:
    """Print snapshots and branches with the memory that they do not share."""
    rows = []
    for node in nodes:
        for kind, forks in (("snapshot", node.snapshots), ("branch", node.branches)):
            for fork in forks:
                cells = (str(fork.step), str(fork.engines), fork.owner, _mb(fork.private_bytes))
                rows.append((f"{kind} {fork.name}", node.node, *cells))
    if rows:
        columns = ("name", "node", "step", "engines", "owner", "private memory")
        show("", columns, rows, right=("step", "engines", "private memory"), wrap=("name", "node", "owner"))


def _print_controllers(nodes: list[Status]) -> None:
    """Print two tables of controllers: their claims and states, and their message counts and response times."""
    claims, statistics = [], []
    for node in nodes:
        for c in node.controllers:
            required = "yes" if c.required else "no"
            claims.append((c.controller, node.node, str(c.priority), str(c.actuators), required, c.state))
            counts = (c.accepted, c.late, c.rejected, c.duplicate, c.missed)
            statistics.append((c.controller, *map(str, counts), *milliseconds(c.response)))
    if not claims:
        if nodes:
            out.print("no controllers")
        return
    columns = ("controller", "node", "priority", "actuators", "required", "state")
    show("", columns, claims, right=("priority", "actuators"), wrap=("controller", "node", "state"))
    headings = ("accepted", "late", "rejected", "duplicate", "missed", "median\n(ms)", "p99\n(ms)", "max\n(ms)")
    show("", ("controller", *headings), statistics, right=headings, wrap=("controller",))
