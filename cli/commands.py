"""The `zenostat` application: all commands, grouped by heading.

A command's module is imported when the command is called. `zenostat --help` imports none: it reads their first
sentences from the source.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, MutableMapping
from enum import StrEnum
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from zenostat.topics import VERSION

GROUPS: dict[str, tuple[str, ...]] = {
    "Simulate and control": (
        "demo.demo", "node.node", "run.run", "cosim.cosim", "evaluate.evaluate", "dataset.dataset", "probe.probe",
        "calibrate.calibrate",
    ),
    "Train agents": ("train.train", "tune.tune", "benchmark.benchmark", "bounds.bounds"),
    "Watch a bus": (
        "status.status", "room.room", "mcp.mcp", "monitor.monitor", "view.view", "watch.watch", "read.read",
        "plot.plot", "alarms.alarms", "priorities.priorities",
    ),
    "Operate a running node": (
        "write.write", "write.relinquish", "lifecycle.reset", "pace.pause", "pace.resume", "pace.step", "pace.pace",
        "pace.faults", "alarm_requests.acknowledge", "alarm_requests.shelve", "alarm_requests.unshelve",
        "alarm_requests.remove_from_service", "alarm_requests.return_to_service", "lifecycle.stop",
    ),
    "Record and verify": (
        "record.record", "verify.verify", "replay.replay", "report.report", "export.export", "log.log",
    ),
    "Choose what to simulate": (
        "scenarios.scenarios", "buildings.buildings", "weathers.weathers", "model.model", "models.app", "points.points",
        "data_packs.app", "engine.engine",
    ),
    "Connect other programs": ("keys.app", "router.router", "gateway.app", "asyncapi.asyncapi"),
}  # fmt: skip
"""Commands by the heading under which `--help` lists them, in this order: module and function, or command group."""

_MARKUP: Any = {"rich_markup_mode": "markdown", "add_completion": False, "pretty_exceptions_enable": False}
_NEGATIVE_VALUES = {"ignore_unknown_options": True}


def command_name(place: str) -> str:
    """Return the name of a command: of the function, or of the module that has a command group."""
    module, attribute = place.split(".")
    return (module if attribute == "app" else attribute).replace("_", "-")


_PLACES = {command_name(place): place for places in GROUPS.values() for place in places}
_HEADINGS = {command_name(place): heading for heading, places in GROUPS.items() for place in places}


_GATEWAYS = ("gateway_bacnet.bacnet", "gateway_fmi.fmi", "gateway_modbus.modbus", "gateway_mqtt.mqtt")
"""Commands of `zenostat gateway` that have modules of their own, beside those of `gateway.app`."""


def _import(place: str) -> Any:
    module, attribute = place.split(".")
    return getattr(import_module(f"zenostat.cli.{module}"), attribute)


@cache
def _load(name: str) -> Any:
    """Import a command and return it as typer has it."""
    command = _import(_PLACES[name])
    holder = typer.Typer(**_MARKUP)
    holder.callback()(_root)  # a group, even of a single command
    if isinstance(command, typer.Typer):
        for place in _GATEWAYS if name == "gateway" else ():
            command.command()(_import(place))
        holder.add_typer(command, name=name, rich_help_panel=_HEADINGS[name])
    else:
        settings = _NEGATIVE_VALUES if name == "write" else {}
        holder.command(name, rich_help_panel=_HEADINGS[name], context_settings=settings)(command)
    group: Any = typer.main.get_command(holder)
    return group.commands[name]


@cache
def _summary(name: str) -> str:
    """Return the first paragraph of a command's help without importing it."""
    module, attribute = _PLACES[name].split(".")
    for part in ast.parse(Path(__file__).with_name(f"{module}.py").read_bytes()).body:
        if isinstance(part, ast.FunctionDef):
            decorators = [ast.unparse(decorator) for decorator in part.decorator_list]
            if part.name == attribute or any(text.startswith(f"{attribute}.callback(") for text in decorators):
                return (ast.get_docstring(part) or "").split("\n\n")[0]
        elif isinstance(part, ast.Assign) and isinstance(part.value, ast.Call):
            helps = [word.value for word in part.value.keywords if word.arg == "help"]
            if helps and ast.unparse(part.targets[0]) == attribute:  # a group's own help
                return str(ast.literal_eval(helps[0]))
    raise AttributeError(f"zenostat.cli.{module} has no {attribute}")


class _Commands(MutableMapping[str, Any]):
    """The commands by name; each is imported when it is first looked up."""

    def __init__(self) -> None:
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._loaded:
            if name not in _PLACES:
                raise KeyError(name)
            self._loaded[name] = _load(name)
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return name in _PLACES

    def __setitem__(self, name: str, command: Any) -> None:
        self._loaded[name] = command

    def __delitem__(self, name: str) -> None:
        del self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(_PLACES)

    def __len__(self) -> int:
        return len(_PLACES)


class _Group(typer.core.TyperGroup):
    """All commands in the order of `GROUPS`."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = _Commands()
        self._is_listing = False

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        return [*_PLACES]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if self._is_listing:
            return typer.core.TyperCommand(
                cmd_name, help=_summary(cmd_name), rich_help_panel=_HEADINGS[cmd_name], rich_markup_mode="markdown"
            )
        return super().get_command(ctx, cmd_name)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        self._is_listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._is_listing = False


app = typer.Typer(
    name="zenostat",
    cls=_Group,
    no_args_is_help=True,
    help="Run an EnergyPlus building on a Zenoh bus, control it from other processes and watch it live.",
    **_MARKUP,
)


class LogFormat(StrEnum):
    """Form of what is printed."""

    TEXT = "text"
    JSON = "json"


def _version(is_set: bool) -> None:
    if is_set:
        typer.echo(f"zenostat {VERSION}")
        raise typer.Exit


@app.callback()
def _root(
    _: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    log: Annotated[
        LogFormat, typer.Option(help="Print text, or a JSON object in each line, for services.")
    ] = LogFormat.TEXT,
) -> None:
    """Zenostat."""
    if log is LogFormat.JSON:
        from zenostat.cli.console import log_as_json

        log_as_json()
