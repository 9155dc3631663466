"""`zenostat status`: who is on the bus, in which state."""

from __future__ import annotations

from contextlib import suppress

from rich.table import Table

from bridge.session import default_endpoint
from cli.console import out
from cli.options import CertificateName, Connect, Keys
from cli.statistics import milliseconds
from topics.errors import NothingThere
from topics.keys import Role
from topics.messages import ControllerStatus, Mode, Status


def status(
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
) -> None:
    """Lists the nodes and controllers of a bus; with keys, as a monitor.

    Example: `zenostat status`
    """
    from agent_sdk import connect as connect_bus

    connect = connect or default_endpoint(keys)
    with connect_bus(connect, keys=keys, role=Role.MONITOR, certificate=certificate) as bus:
        nodes = []
        for name in bus.nodes():
            with suppress(NothingThere):  # branches come and go
                nodes.append(bus.status(name, memory=True))
    if not nodes:
        out.print(f"no nodes on {connect}")
    for node in nodes:
        out.print(_node_table(node))
    _print_controllers(nodes)
    _print_forks(nodes)
    for node in nodes:
        if node.failure:
            out.print(f"{node.node}: {node.failure}", style="red", markup=False)


def _node_table(node: Status) -> Table:
    """A node's state, a line each."""
    table = Table("node", node.node, title_justify="left")
    shared = f"node {_mb(node.node_rss_bytes)}, engines {_mb(node.engine_rss_bytes)}"
    messages = f"{node.accepted} accepted, {node.rejected} rejected, {node.late} late, {node.duplicate} duplicate"
    messages += f", {node.statistics.flooded} passed over" if node.statistics.flooded else ""
    for name, value in {
        "state": f"{node.state} ({_pace(node)})",
        "without a controller": _policy(node),
        "building": f"{node.building}, {node.weather}",
        "episode": f"{node.episode[0]}, step {node.step[0]} of {node.steps}",
        "simulated time": node.time[0],
        "commands": messages,
        "memory": f"{shared}, of which {_mb(node.engine_private_bytes)} shared with no other",
    }.items():
        table.add_row(name, value)
    return table


def _pace(node: Status) -> str:
    said = f"{node.mode}, {node.speed:g} times the wall clock" if node.mode is Mode.PACED else str(node.mode)
    return f"{said}, paused" if node.paused else said


def _policy(node: Status) -> str:
    missed = node.statistics.missed
    return f"{node.policy}; timesteps that went on without one: {missed}" if missed else str(node.policy)


def _mb(size: int) -> str:
    return f"{size / 1e6:.0f} MB"


def _print_forks(nodes: list[Status]) -> None:
    """Snapshots and branches, with the memory by which they differ."""
    table = Table("fork", "of", "step", "engines", "owner", "memory of its own")
    for node in nodes:
        for kind, forks in (("snapshot", node.snapshots), ("branch", node.branches)):
            for fork in forks:
                cells = (str(fork.step), str(fork.engines), fork.owner, _mb(fork.private_bytes))
                table.add_row(f"{kind} {fork.name}", node.node, *cells)
    if table.row_count:
        out.print(table)


def _print_controllers(nodes: list[Status]) -> None:
    """Who controls what; what came of their messages; how fast they answer (ms)."""
    who = Table("controller", "node", "level", "actuators", "required", "is")
    did = Table("controller", "accepted", "late", "rejected", "duplicate", "missed", "median", "p99", "max (ms)")
    for column in did.columns[1:]:
        column.justify = "right"
    for node in nodes:
        for c in node.controllers:
            who.add_row(c.controller, node.node, str(c.level), str(c.actuators), _yes(c.required), _presence(c))
            counts = (c.accepted, c.late, c.rejected, c.duplicate, c.missed)
            did.add_row(c.controller, *map(str, counts), *milliseconds(c.response))
    if not who.row_count:
        if nodes:
            out.print("no controllers")
        return
    out.print(who)
    out.print(did)


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def _presence(controller: ControllerStatus) -> str:
    if controller.waived:
        return "gone, waived"
    if not controller.present:
        return "gone"
    return "silent" if controller.silent else "present"
