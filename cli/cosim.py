"""`zenostat cosim`: couple several plants as a district."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.bridge.transport.session import default_endpoint
from zenostat.cli import node_options as options
from zenostat.cli.console import err, out, progress
from zenostat.cli.options import CertificateName, Expose, Keys, Loops
from zenostat.cli.tables import show, show_json
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Mode, OnFull, Policy, State

if TYPE_CHECKING:
    from zenostat.bridge.node.server import NodeServer
    from zenostat.cosim.plant import DistrictPlant
    from zenostat.topics.messages import Manifest


def cosim(
    file: Annotated[Path | None, typer.Argument(metavar="[FILE.yaml]", help="File of the district.")] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Only check the file, with the points and units of its plants.")
    ] = False,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema of such files, for editors.")] = False,
    from_ssp: Annotated[
        Path | None,
        typer.Option("--from", metavar="SYSTEM.ssp", help="Write FILE.yaml from an SSP file, with its FMUs, and end."),
    ] = None,
    loops: Annotated[
        Loops, typer.Option("--loops", help="With --from: solve the connections that close a loop, or delay them.")
    ] = Loops.SOLVE,
    step_s: Annotated[
        float | None,
        typer.Option(
            "--step",
            metavar="SECONDS",
            help="With --from: timestep of the district. Default: the SSP file's step size.",
        ),
    ] = None,
    once: Annotated[
        bool, typer.Option("--once", help="Simulate one episode without a controller, print its balances, and end.")
    ] = False,
    seed: Annotated[
        int | None,
        typer.Option(min=0, metavar="N", help="Seed of the first episode. Default: with --once 0, else a random one."),
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the node. Default: that of the file.")] = None,
    mode: options.Mode = Mode.LOCKSTEP,
    speed: options.Speed = None,
    faults: options.Faults = None,
    alarms: options.Alarms = None,
    policy: options.Policy = Policy.WAIT,
    grace_s: options.Grace = 0.0,
    deadline_s: options.Deadline = None,
    listen: options.Listen = None,
    connect: options.Connect = None,
    expose: Expose = False,
    keys: Keys = None,
    certificate: CertificateName = None,
    record: options.Record = None,
    record_on_full: options.RecordOnFull = OnFull.WAIT,
    overwrite: options.Overwrite = False,
    history_mb: options.HistoryMB = 16.0,
) -> None:
    """Couple several plants as a district, and put it on the bus, until Ctrl-C or `zenostat stop`.

    Example: `zenostat cosim examples/district.yaml --once`

    Example: `zenostat cosim examples/district.yaml --check`

    Example: `zenostat cosim --schema > district.schema.json`

    Example: `zenostat cosim --from system.ssp district.yaml`
    """
    if schema:
        from zenostat.cosim.file import json_schema

        show_json(json_schema())
        return
    if file is None:
        raise InvalidConfig("name the file of a district: zenostat cosim FILE.yaml")
    if from_ssp is not None:
        from zenostat.cli.cosim_ssp import convert

        convert(from_ssp, file, loops, overwrite=overwrite, step_s=step_s)
        return
    if step_s is not None:
        raise InvalidConfig("--step is for --from; the file of a district has its own: timestep")
    if speed is not None and mode is not Mode.PACED:
        raise InvalidConfig(f"--speed {speed:g} needs --mode paced; {mode} mode has no speed")
    if once and mode is not Mode.LOCKSTEP:
        raise InvalidConfig(f"--once simulates at full speed; leave out --mode {mode}")
    settings = {
        "district": str(file),
        "seed": 0 if once and seed is None else seed,
        "name": name,
        "mode": Mode.FREE if once else mode,
        "speed": speed,
        "faults": faults,
        "alarms": alarms,
        "policy": policy,
        "grace_s": grace_s,
        "deadline_s": deadline_s,
        "listen": [listen or default_endpoint(keys)],
        "connect": connect or [],
        "expose": expose,
        "keys": keys,
        "certificate": certificate,
        "record": record,
        "record_on_full": record_on_full,
        "record_overwrite": overwrite,
        "history_mb": history_mb,
        "check": check,
    }
    _run(settings, is_endpoint_explicit=listen is not None, once=once)


def _run(settings: dict[str, Any], *, is_endpoint_explicit: bool, once: bool) -> None:
    from zenostat.cli.node import ProgressBar, log_events, start
    from zenostat.cosim.node import district_node, read_settings

    config = read_settings(settings)
    if config.check:
        checked = district_node(config, check_reward=check_reward)
        with err.status(f"checking {config.district}"):
            checked.check()
        for warning in checked.warnings:
            out.warning(warning)
        out.print(f"{config.district}: plants, connections, units and timesteps fit")
        return
    with progress() as bars, ExitStack() as stack:
        watch = _Watch(ProgressBar(bars, config.name or config.district.stem), once=once)
        create = partial(district_node, observer=watch, program=True, check_reward=check_reward)
        node = start(stack, config, create, is_endpoint_explicit=is_endpoint_explicit)
        log_events(node)
        node.serve()
        plant: DistrictPlant = node.plant  # type: ignore[assignment]
        failure, elapsed_s = node.server.failure, node.exchange.step[0] * node.manifest.step_s
    show_balances(plant, elapsed_s)
    if failure:
        err.print(failure)
        raise typer.Exit(1)


def check_reward(manifest: Manifest) -> None:
    """Bind the reward of a district to its points, as an environment does; `InvalidConfig` if it does not fit."""
    from zenostat.agent_sdk.rewards import read_reward

    assert manifest.task.reward is not None
    read_reward(manifest.task.reward).bind(manifest)


class _Watch:
    """Show the progress; with `once`, end the node after its first episode."""

    def __init__(self, bar: Any, *, once: bool) -> None:
        self._bar, self._once = bar, once

    def __call__(self, server: NodeServer) -> None:
        self._bar(server)
        if self._once and server.exchange.state in (State.ENDED, State.FAILED):
            self._once = False
            server.subscriptions.post_first(server.stop_serving)


def show_balances(plant: DistrictPlant, elapsed_s: float) -> None:
    """Print the balance of each connection, and the trials of each loop, of the latest episode.

    Args:
        plant: the district.
        elapsed_s: simulated time of the episode so far; terms are printed as means over it.
    """
    if not elapsed_s:
        return
    rows = []
    for balance in plant.balances():
        terms = (balance.sent, balance.received, balance.clipped, balance.resampled, balance.residual, balance.stored)
        time_s = elapsed_s - balance.missing_steps * plant.description.run_period.step_s
        cells = (f"{term / time_s:.6g}" if time_s else "" for term in terms)
        rows.append((balance.label, balance.unit, *cells, f"{balance.closure:.1e}"))
    if rows:
        columns = ("connection", "unit", "sent", "received", "clipped", "resampled", "residual", "stored", "closure")
        show("mean over the episode: sent = received + …", columns, rows, right=columns[2:], wrap=columns[:1])
    loops = [
        (name, str(state.steps), f"{state.total / max(state.steps, 1):.2f}", str(state.unsolved))
        for name, state in plant.loops().items()
    ]
    if loops:
        show("loops", ("loop", "steps", "trials per step", "unsolved"), loops, right=("steps", "trials per step"))
