"""The `zenostat` application: all commands, grouped by heading."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer
import typer.core

from cli import (
    alarm_requests,
    alarms,
    asyncapi,
    benchmark,
    buildings,
    data_packs,
    dataset,
    demo,
    evaluate,
    export,
    gateway,
    gateway_bacnet,
    gateway_modbus,
    gateway_mqtt,
    keys,
    lifecycle,
    log,
    monitor,
    node,
    pace,
    plot,
    points,
    priorities,
    probe,
    read,
    record,
    replay,
    report,
    router,
    run,
    status,
    train,
    tune,
    verify,
    view,
    watch,
    weathers,
    write,
)
from cli.scenarios import scenarios
from topics import VERSION

for _command in (gateway_bacnet.bacnet, gateway_modbus.modbus, gateway_mqtt.mqtt):
    gateway.app.command()(_command)

_GROUPS: dict[str, tuple[Callable[..., None] | typer.Typer, ...]] = {
    "Simulate and control": (demo.demo, node.node, run.run, evaluate.evaluate, dataset.dataset, probe.probe),
    "Train agents": (train.train, tune.tune, benchmark.benchmark),
    "Watch a bus": (
        status.status, monitor.monitor, view.view, watch.watch, read.read, plot.plot, alarms.alarms,
        priorities.priorities,
    ),
    "Operate a running node": (
        write.write, write.relinquish, lifecycle.reset, pace.pause, pace.resume, pace.step, pace.pace, pace.faults,
        alarm_requests.acknowledge, alarm_requests.shelve, alarm_requests.unshelve,
        alarm_requests.remove_from_service, alarm_requests.return_to_service, lifecycle.stop,
    ),
    "Record and verify": (record.record, verify.verify, replay.replay, report.report, export.export, log.log),
    "Choose what to simulate": (scenarios, buildings.buildings, weathers.weathers, points.points, data_packs.app),
    "Connect other programs": (keys.app, router.router, gateway.app, asyncapi.asyncapi),
}  # fmt: skip
"""Commands by the heading under which `--help` lists them, in this order."""

_SUBCOMMANDS = {
    id(scenarios): "scenarios",
    id(data_packs.app): "data-packs",
    id(keys.app): "keys",
    id(gateway.app): "gateway",
}


class _Ordered(typer.core.TyperGroup):
    """List commands in the order of `_GROUPS`; typer would list command groups last."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        return [_name(command) for commands in _GROUPS.values() for command in commands]


def _name(command: Callable[..., None] | typer.Typer) -> str:
    return _SUBCOMMANDS[id(command)] if isinstance(command, typer.Typer) else command.__name__.replace("_", "-")


app = typer.Typer(
    name="zenostat",
    cls=_Ordered,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Run an EnergyPlus building on a Zenoh bus, control it from other processes and watch it live.",
)
for heading, commands in _GROUPS.items():
    for command in commands:
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=_name(command), rich_help_panel=heading)
        else:
            negative = {"ignore_unknown_options": command is write.write}  # a value may be negative
            app.command(rich_help_panel=heading, context_settings=negative)(command)


def _version(is_set: bool) -> None:
    if is_set:
        typer.echo(f"zenostat {VERSION}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    """Zenostat."""
