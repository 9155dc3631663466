"""`zenostat run`: a controller in a process of its own."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from bridge.session import DEFAULT_ENDPOINT
from cli.console import out, progress
from topics.errors import UnknownName, near


def run(
    node: Annotated[str, typer.Option(help="The node's name.")],
    controller: Annotated[
        str, typer.Option(help="building (its own control) or rbc (rules on comfort bands).")
    ] = "rbc",
    connect: Annotated[str, typer.Option(help="Endpoint of the bus.")] = DEFAULT_ENDPOINT,
    level: Annotated[int, typer.Option(min=1, max=16, help="Priority level; 1 is the highest.")] = 10,
    episodes: Annotated[int, typer.Option(min=1, help="How many episodes to control.")] = 1,
    reset: Annotated[bool, typer.Option("--reset", help="Begin a new episode instead of joining.")] = False,
) -> None:
    """Controls a node, from the sample that it stands at to the episode's end.

    Example: `zenostat run --node office --controller rbc`
    """
    from agent_sdk import connect as connect_bus
    from agent_sdk.controllers import CONTROLLERS

    if controller not in CONTROLLERS:
        raise UnknownName(f"no controller {controller!r}; {near(controller, CONTROLLERS)}")
    with connect_bus(connect) as bus, bus.controller(node, name=controller, level=level) as link, progress() as bars:
        for number in range(episodes):
            if reset or number:
                link.reset()
            brain = CONTROLLERS[controller](link.manifest)
            bar = bars.add_task(f"{node}: {link.name}", total=link.manifest.steps, rate="")
            start, first, shown = time.monotonic(), None, 0.0
            for sample in link:
                first = sample.step if first is None else first
                if not sample.truncated:
                    sample.send(brain.act(sample))
                now = time.monotonic()
                if now - shown > 0.1 or sample.truncated:
                    shown = now
                    rate = (sample.step - first) / max(now - start, 1e-9)
                    bars.update(bar, completed=sample.step, rate=f"{rate:,.0f} steps/s")
    out.print(f"{node}: {episodes} episode{'s' if episodes > 1 else ''} controlled by {controller}")
