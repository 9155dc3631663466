"""`zenostat node`: a building on the bus."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from bridge.affinity import Affinity
from bridge.session import DEFAULT_ENDPOINT
from cli.console import out, progress
from topics.messages import Mode, State


def node(
    building: Annotated[str, typer.Option(help="Short name, path to an IDF or epJSON, or part of a name.")],
    weather: Annotated[str, typer.Option(help="Short name, path to an EPW, or part of a name.")],
    name: Annotated[str, typer.Option(help="The node's name on the bus.")] = "building",
    begin: Annotated[str | None, typer.Option(help="First day, MM-DD or YYYY-MM-DD.")] = None,
    end: Annotated[str | None, typer.Option(help="Last day, MM-DD or YYYY-MM-DD.")] = None,
    steps_per_hour: Annotated[int | None, typer.Option(help="Timesteps an hour; the model's own if left out.")] = None,
    mode: Annotated[
        Mode, typer.Option(help="lockstep: wait for the required controllers; free: never wait.")
    ] = Mode.LOCKSTEP,
    listen: Annotated[str, typer.Option(help="Endpoint to listen on.")] = DEFAULT_ENDPOINT,
    connect: Annotated[list[str] | None, typer.Option(help="Endpoint of another node, to share its bus.")] = None,
    expose: Annotated[bool, typer.Option("--expose", help="Allow listening beyond this machine.")] = False,
    keep: Annotated[Path | None, typer.Option(help="Keep EnergyPlus's own output files in this folder.")] = None,
    affinity: Annotated[Affinity, typer.Option(help="Cores: see docs/architecture.md.")] = Affinity.APART,
) -> None:
    """Simulates a building and puts it on the bus, until Ctrl-C or `rpc/stop`.

    Example: `zenostat node --building office-medium --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office`
    """
    from eplus_node.config import read_config
    from eplus_node.node import Node

    config = read_config(
        {
            "building": building,
            "weather": weather,
            "name": name,
            "begin": begin,
            "end": end,
            "steps_per_hour": steps_per_hour,
            "mode": mode,
            "listen": [listen],
            "connect": connect or [],
            "expose": expose,
            "keep": keep,
            "affinity": affinity,
        }
    )
    with progress() as bars:
        bar = bars.add_task(f"{name}: starting", total=None, rate="")
        shown = 0.0

        def watch(node: Node) -> None:
            nonlocal shown
            now = time.monotonic()
            state = node.exchange.state
            if now - shown < 0.1 and state is State.WAITING and not node.exchange.missing():
                return
            shown = now
            episode, step = node.exchange.episode[0], node.exchange.step[0]
            bars.update(
                bar,
                description=f"{name}: episode {episode}, {state}",
                completed=step,
                total=node.manifest.steps,
            )

        with Node(config, observer=watch) as running:
            manifest = running.manifest
            bars.console.print(
                f"[bold]{name}[/bold] on {listen}: {manifest.building} in {manifest.location}, "
                f"{running.plan.period.begin} to {running.plan.period.end}, {manifest.steps} timesteps of "
                f"{60 // manifest.steps_per_hour} min; {len(manifest.sensors)} sensors, {len(manifest.meters)} meters, "
                f"{len(manifest.actuators)} actuators. Ctrl-C ends it."
            )
            running.serve()
    out.print(f"{name}: ended")
