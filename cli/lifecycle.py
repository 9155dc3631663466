"""`zenostat reset` and `zenostat stop`: start an episode or stop a node by hand."""

from __future__ import annotations

from typing import Annotated

import typer

from zenostat.cli.console import out
from zenostat.cli.options import DEFAULTS, BusOptions, Node, on_bus
from zenostat.cli.write import person
from zenostat.topics.errors import NodeLost
from zenostat.topics.keys import Role
from zenostat.topics.plurals import counted


@on_bus
def reset(
    node: Node,
    seed: Annotated[int | None, typer.Option(min=0, metavar="N", help="Seed of the episode.")] = None,
    options: BusOptions = DEFAULTS,
) -> None:
    """Start a new episode on a node; connected controllers are notified.

    Example: `zenostat reset office --seed 1`
    """
    from zenostat.topics.messages import Reset

    with options.open_bus(Role.OPERATOR) as bus:
        steps = bus.manifest(node).steps
        ack = bus.reset(node, Reset(controller=person(), seed=seed))
    weathers = dict.fromkeys(start.weather for start in ack.episode_starts if start.weather)
    text = ", ".join((f"{node}: episode {ack.episode[0]}", counted(steps, "timestep"), *weathers))
    out.print(text)


@on_bus
def stop(node: Node, options: BusOptions = DEFAULTS) -> None:
    """Stop a node, and wait until it has left the bus.

    Example: `zenostat stop office`
    """
    with options.open_bus(Role.OPERATOR) as bus, bus.listen(node) as samples:
        bus.stop(node, source=person())
        try:
            for _ in samples:
                pass
        except NodeLost:
            out.print(f"{node}: ended")
