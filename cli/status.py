"""`zenostat status`: who is on the bus, in which state."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from bridge.session import DEFAULT_ENDPOINT
from cli.console import out
from topics.messages import Status


def status(connect: Annotated[str, typer.Option(help="Endpoint of the bus.")] = DEFAULT_ENDPOINT) -> None:
    """Lists the nodes and controllers of a bus.

    Example: `zenostat status`
    """
    from agent_sdk import connect as connect_bus

    with connect_bus(connect) as bus:
        nodes = [bus.status(name) for name in bus.nodes()]
    if not nodes:
        out.print(f"no nodes on {connect}")
    for node in nodes:
        out.print(_node_table(node))
    _print_controllers(nodes)
    for node in nodes:
        if node.failure:
            out.print(f"{node.node}: {node.failure}", style="red", markup=False)


def _node_table(node: Status) -> Table:
    """A node's state, a line each."""
    table = Table("node", node.node, title_justify="left")
    memory_mb = (node.node_rss_bytes + node.engine_rss_bytes) / 1e6
    messages = f"{node.accepted} accepted, {node.rejected} rejected, {node.late} late, {node.duplicate} duplicate"
    for name, value in {
        "state": f"{node.state} ({node.mode})",
        "building": f"{node.building}, {node.weather}",
        "episode": f"{node.episode[0]}, step {node.step[0]} of {node.steps}",
        "simulated time": node.time[0],
        "commands": messages,
        "memory": f"{memory_mb:.0f} MB",
    }.items():
        table.add_row(name, value)
    return table


def _print_controllers(nodes: list[Status]) -> None:
    table = Table("controller", "node", "level", "actuators", "required", "present", "commands")
    for node in nodes:
        for c in node.controllers:
            yes_no = ("yes" if c.required else "no", "yes" if c.present else "gone")
            table.add_row(c.controller, node.node, str(c.level), str(c.actuators), *yes_no, str(c.accepted))
    if table.row_count:
        out.print(table)
    elif nodes:
        out.print("no controllers")
