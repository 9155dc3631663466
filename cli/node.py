"""`zenostat node`: a building on the bus."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.affinity import Affinity
from bridge.session import DEFAULT_ENDPOINT
from cli.console import out, progress
from topics.messages import Mode, State

if TYPE_CHECKING:
    from rich.progress import Progress

    from eplus_node.node import Node


def node(
    scenario: Annotated[
        str | None, typer.Option(help="Id, or a file (YAML); what else is given goes before it.")
    ] = None,
    building: Annotated[
        str | None, typer.Option(help="Short name, path to an IDF or epJSON, or part of a name.")
    ] = None,
    weather: Annotated[
        list[str] | None, typer.Option(help="Short name, path to an EPW, or part of a name; or several.")
    ] = None,
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
            "scenario": scenario,
            "building": building,
            "weather": weather or None,
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
        watch = _Watch(bars, name)
        with Node(config, observer=watch) as running:
            bars.console.print(_greeting(running, listen))
            for warning in running.manifest.warnings:
                bars.console.print(f"warning: {warning}", style="yellow", markup=False)
            running.serve()
    out.print(f"{name}: ended")


class _Watch:
    """Shows a node's progress, ten times a second at most while it runs."""

    def __init__(self, bars: Progress, name: str) -> None:
        self._bars = bars
        self._name = name
        self._bar = bars.add_task(f"{name}: starting", total=None, rate="")
        self._shown = 0.0

    def __call__(self, node: Node) -> None:
        now, state = time.monotonic(), node.exchange.state
        if now - self._shown < 0.1 and state is State.WAITING and not node.exchange.missing():
            return
        self._shown = now
        said = f"{self._name}: episode {node.exchange.episode[0]}, {state}"
        self._bars.update(self._bar, description=said, completed=node.exchange.step[0], total=node.manifest.steps)


def _greeting(node: Node, listen: str) -> str:
    manifest, period = node.manifest, node.plan.period
    return (
        f"[bold]{manifest.node}[/bold] on {listen}: {manifest.building} in {manifest.location}, "
        f"{period.begin} to {period.end}, {manifest.steps} timesteps of {60 // manifest.steps_per_hour} min; "
        f"{len(manifest.sensors)} sensors, {len(manifest.meters)} meters, {len(manifest.actuators)} actuators. "
        "Ctrl-C ends it."
    )
