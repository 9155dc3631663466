"""`zenostat reset` and `zenostat stop`: start an episode or stop a node by hand."""

from __future__ import annotations

from typing import Annotated

import typer

from zenostat.bridge.transport.session import default_endpoint
from zenostat.cli.console import out
from zenostat.cli.options import CertificateName, Connect, Keys
from zenostat.cli.write import Node, person
from zenostat.topics.errors import NodeLost


def reset(
    node: Node,
    seed: Annotated[int | None, typer.Option(min=0, metavar="N", help="Seed of the episode.")] = None,
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
) -> None:
    """Start a new episode on a node; connected controllers are notified.

    Example: `zenostat reset office --seed 1`
    """
    from zenostat import connect as connect_bus
    from zenostat.topics.messages import Reset

    with connect_bus(connect or default_endpoint(keys), keys=keys, certificate=certificate) as bus:
        steps = bus.manifest(node).steps
        ack = bus.reset(node, Reset(controller=person(), seed=seed))
    weathers = dict.fromkeys(start.weather for start in ack.episode_starts if start.weather)
    text = ", ".join((f"{node}: episode {ack.episode[0]}", f"{steps} timesteps", *weathers))
    out.print(text, markup=False, soft_wrap=True)


def stop(node: Node, connect: Connect = None, keys: Keys = None, certificate: CertificateName = None) -> None:
    """Stop a node, and wait until it has left the bus.

    Example: `zenostat stop office`
    """
    from zenostat import connect as connect_bus

    with (
        connect_bus(connect or default_endpoint(keys), keys=keys, certificate=certificate) as bus,
        bus.listen(node) as samples,
    ):
        bus.stop(node)
        try:
            for _ in samples:
                pass
        except NodeLost:
            out.print(f"{node}: ended", markup=False)
