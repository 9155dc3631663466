"""`zenostat priorities`: the priority arrays of a node's actuators."""

from __future__ import annotations

from typing import Annotated

import typer

from zenostat.cli.options import DEFAULTS, BusOptions, Node, Slot, on_bus
from zenostat.cli.tables import AsJson, show, show_json
from zenostat.topics.keys import Role
from zenostat.topics.points import actuator_index
from zenostat.topics.units import unit_label


@on_bus
def priorities(
    node: Node,
    actuators: Annotated[list[str] | None, typer.Argument(help="Names of actuators. Default: all in use.")] = None,
    slot: Slot = 0,
    options: BusOptions = DEFAULTS,
    as_json: AsJson = False,
) -> None:
    """Show who has commanded which actuator at which priority; the first line of an actuator is in effect.

    With keys, it uses the monitor role.

    Example: `zenostat priorities office core_zn_cooling_setpoint`
    """
    with options.open_bus(Role.MONITOR) as bus:
        manifest = bus.manifest(node)
        actuator_index(manifest).require(actuators or [])
        arrays = bus.priorities(node, slot=slot)
    rows = [
        (actuator, priority, entry)
        for actuator in manifest.actuators
        if not actuators or actuator.name in actuators
        for priority, entry in enumerate(arrays[actuator.name], 1)
        if entry.value is not None
    ]
    if as_json:
        show_json(
            [
                {"actuator": a.name, "priority": priority, "value": entry.value, "unit": a.unit, "source": entry.source}
                for a, priority, entry in rows
            ]
        )
        return
    columns = ("actuator", "priority", "value", "unit", "source")
    cells = [(a.name, str(p), f"{e.value:.6g}", unit_label(a.unit), e.source or "") for a, p, e in rows]
    title = f"{node}: commands by priority" if rows else f"{node}: baseline control has all of these actuators"
    show(title, columns, cells, right=("priority", "value"), wrap=("actuator", "source"))
