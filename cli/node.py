"""`zenostat node`: a building on the bus."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.runtime.affinity import Affinity
from bridge.transport.session import DEFAULT_ENDPOINT, default_endpoint, exposure
from cli import statistics
from cli.console import out, progress
from cli.options import CertificateName, Keys
from topics.errors import AddressInUse, InvalidConfig, NodeNotFound
from topics.messages import Mode, Policy, State

if TYPE_CHECKING:
    from rich.progress import Progress

    from eplus_node.config import NodeConfig
    from eplus_node.node import Node
    from eplus_node.server import NodeServer, Observer


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
        Mode,
        typer.Option(help="lockstep: wait for the required controllers; paced: by the wall clock; free: never wait."),
    ] = Mode.LOCKSTEP,
    speed: Annotated[
        float | None, typer.Option(help="Simulated seconds in a second, in paced mode; 1 if left out.")
    ] = None,
    faults: Annotated[Path | None, typer.Option(help="Faults to inject (YAML); see docs/faults.md.")] = None,
    policy: Annotated[
        Policy,
        typer.Option(help="Without a required controller: wait, hold or relinquish what it commanded, or abort."),
    ] = Policy.WAIT,
    grace: Annotated[
        float, typer.Option(metavar="SECONDS", help="How long a controller may be gone before that; wall time.")
    ] = 0.0,
    deadline: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="How long a lockstep step waits for commands; wall time. None: for ever."),
    ] = None,
    listen: Annotated[
        str | None,
        typer.Option(help="Endpoint to listen on.", show_default=DEFAULT_ENDPOINT),
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option(help="Endpoint of a router, or of another node to share its bus.")
    ] = None,
    no_listen: Annotated[bool, typer.Option("--no-listen", help="Only connect, to a router.")] = False,
    expose: Annotated[bool, typer.Option("--expose", help="Allow listening beyond this machine.")] = False,
    keys: Keys = None,
    certificate: CertificateName = None,
    slots: Annotated[int, typer.Option(help="Engines that step together, each with an episode of its own.")] = 1,
    baseline: Annotated[bool, typer.Option("--baseline", help="Run the building's own control beside it.")] = False,
    branches: Annotated[int, typer.Option(help="Snapshots and branches there may be at a time.")] = 64,
    unresponsive: Annotated[
        float,
        typer.Option(metavar="SECONDS", help="An engine that neither answers nor computes for so long is killed."),
    ] = 10.0,
    output_dir: Annotated[Path | None, typer.Option(help="Keep EnergyPlus's own output files in this folder.")] = None,
    keep_last: Annotated[
        int | None, typer.Option(help="Of how many finished episodes; all if left out.", min=1)
    ] = None,
    affinity: Annotated[Affinity, typer.Option(help="Cores: see docs/architecture.md.")] = Affinity.SEPARATE_CORES,
) -> None:
    """Simulates a building and puts it on the bus, until Ctrl-C or `zenostat stop`.

    Example: `zenostat node --building office-medium --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office`
    """
    from eplus_node.config import read_config

    if no_listen and listen:
        raise InvalidConfig(f"--listen {listen} and --no-listen; give one of them")
    if speed is not None and mode is not Mode.PACED:
        raise InvalidConfig(f"--speed {speed:g} goes with --mode paced; {mode} has no speed")
    endpoints = [] if no_listen else [listen or default_endpoint(keys)]
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
            **({"speed": speed} if speed is not None else {}),
            "faults": faults,
            "policy": policy,
            "grace_s": grace,
            "deadline_s": deadline,
            "listen": endpoints,
            "connect": connect or [],
            "expose": expose,
            "keys": keys,
            "certificate": certificate,
            "slots": slots,
            "baseline": baseline,
            "branches": branches,
            "unresponsive_s": unresponsive,
            "output_dir": output_dir,
            "keep_last": keep_last,
            "affinity": affinity,
        }
    )
    with progress() as bars, ExitStack() as stack:
        watch = _Watch(bars, name)
        say = partial(bars.console.print, markup=False, soft_wrap=True)
        running = _start(stack, config, watch, chosen=listen is not None, say=say)
        bars.console.print(_greeting(running, ", ".join(running.config.listen or running.config.connect)))
        for warning in filter(None, (*running.manifest.warnings, exposure(running.config.listen, keys))):
            bars.console.print(f"warning: {warning}", style="yellow", markup=False, soft_wrap=True)
        running.serve()
        kept = statistics.table(running.runner.statistics(), running.exchange.controllers())
    out.print(kept)
    out.print(f"{name}: ended")


def _start(stack: ExitStack, config: NodeConfig, watch: Observer, *, chosen: bool, say: Callable[[str], None]) -> Node:
    """Start the node; if the default endpoint is taken, without listening: connected to the node that is there.

    Args:
        stack: closes the node.
        config: of the node.
        watch: sees its progress.
        chosen: whether the user named the endpoint.
        say: prints a line.

    Raises:
        AddressInUse: another program listens there: the user named the endpoint, or that program is not on a bus.
    """
    from eplus_node.node import Node

    try:
        return stack.enter_context(Node(config, observer=watch, program=True))
    except AddressInUse as taken:
        if chosen:
            raise
        where = config.connect or config.listen
        joined = config.model_copy(update={"listen": [], "connect": where})
        try:
            running = stack.enter_context(Node(joined, observer=watch, program=True))
        except NodeNotFound:
            raise taken from None
    say(
        f"another program listens on {', '.join(config.listen)}, so {config.name} does not listen; it is connected to "
        f"{', '.join(where)} and on one bus with what is there. For a bus of its own, name another port: "
        "--listen tcp/127.0.0.1:7448"
    )
    return running


class _Watch:
    """Shows a node's progress, ten times a second at most while it runs."""

    def __init__(self, bars: Progress, name: str) -> None:
        self._bars = bars
        self._name = name
        self._bar = bars.add_task(f"{name}: starting", total=None, rate="")
        self._shown = 0.0

    def __call__(self, node: NodeServer) -> None:
        now, state = time.monotonic(), node.exchange.state
        if now - self._shown < 0.1 and state is State.WAITING and not node.exchange.awaiting():
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
