"""`zenostat status`: who is on the bus, in which state."""

from __future__ import annotations

from contextlib import suppress

from bridge.transport.session import default_endpoint
from cli.console import out
from cli.options import CertificateName, Connect, Keys
from cli.statistics import milliseconds
from cli.tables import show
from topics.errors import NodeNotFound
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
            with suppress(NodeNotFound):  # branches come and go
                nodes.append(bus.status(name, memory=True))
    if not nodes:
        out.print(f"no nodes on {connect}")
    for node in nodes:
        _print_node(node)
    _print_controllers(nodes)
    _print_forks(nodes)
    for node in nodes:
        if node.failure:
            out.print(f"{node.node}: {node.failure}", style="red", markup=False)


def _print_node(node: Status) -> None:
    """A node's state, a line each."""
    shared = f"node {_mb(node.node_rss_bytes)}, engines {_mb(node.engine_rss_bytes)}"
    messages = f"{node.accepted} accepted, {node.rejected} rejected, {node.late} late, {node.duplicate} duplicate"
    messages += f", {node.statistics.rate_limited} passed over" if node.statistics.rate_limited else ""
    rows = {
        "state": f"{node.state} ({_pace(node)})",
        "without a controller": _policy(node),
        "building": f"{node.building}, {node.weather}",
        "episode": f"{node.episode[0]}, step {node.step[0]} of {node.steps}",
        "simulated time": node.time[0],
        "commands": messages,
        "memory": f"{shared}, of which {_mb(node.engine_private_bytes)} shared with no other",
    }
    show("", ("node", node.node), list(rows.items()), wrap=(node.node,))


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
    rows = []
    for node in nodes:
        for kind, forks in (("snapshot", node.snapshots), ("branch", node.branches)):
            for fork in forks:
                cells = (str(fork.step), str(fork.engines), fork.owner, _mb(fork.private_bytes))
                rows.append((f"{kind} {fork.name}", node.node, *cells))
    if rows:
        columns = ("fork", "of", "step", "engines", "owner", "memory of its own")
        show("", columns, rows, right=("step", "engines", "memory of its own"), wrap=("fork", "of", "owner"))


def _print_controllers(nodes: list[Status]) -> None:
    """Who controls what; what came of their messages; how fast they answer (ms)."""
    who, did = [], []
    for node in nodes:
        for c in node.controllers:
            who.append((c.controller, node.node, str(c.priority), str(c.actuators), _yes(c.required), _presence(c)))
            counts = (c.accepted, c.late, c.rejected, c.duplicate, c.missed)
            did.append((c.controller, *map(str, counts), *milliseconds(c.response)))
    if not who:
        if nodes:
            out.print("no controllers")
        return
    columns = ("controller", "node", "priority", "actuators", "required", "is")
    show("", columns, who, right=("priority", "actuators"), wrap=("controller", "node", "is"))
    counted = ("accepted", "late", "rejected", "duplicate", "missed", "median\n(ms)", "p99\n(ms)", "max\n(ms)")
    show("", ("controller", *counted), did, right=counted, wrap=("controller",))


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def _presence(controller: ControllerStatus) -> str:
    if controller.bypassed:
        return "gone, waived"
    if not controller.connected:
        return "gone"
    return "unresponsive" if controller.unresponsive else "connected"
