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
    table = Table("node", "state", "building", "weather", "episode", "step", "simulated time", "messages", "memory")
    for node in nodes:
        table.add_row(
            node.node,
            node.state,
            node.building,
            node.weather,
            str(node.episode[0]),
            f"{node.step[0]} of {node.steps}",
            node.time[0],
            f"{node.accepted} accepted, {node.rejected} rejected, {node.late} late, {node.duplicate} duplicate",
            f"{(node.node_rss_bytes + node.engine_rss_bytes) / 1e6:.0f} MB",
        )
    out.print(table)
    _print_controllers(nodes)
    for node in nodes:
        if node.failure:
            out.print(f"{node.node}: {node.failure}", style="red", markup=False)


def _print_controllers(nodes: list[Status]) -> None:
    table = Table("controller", "node", "level", "actuators", "required", "present", "commands")
    for node in nodes:
        for c in node.controllers:
            yes_no = ("yes" if c.required else "no", "yes" if c.present else "gone")
            table.add_row(c.controller, node.node, str(c.level), str(c.actuators), *yes_no, str(c.accepted))
    if table.row_count:
        out.print(table)
    else:
        out.print("no controllers")
