"""`zenostat node`: simulate a building, or a plant of your own, on the bus."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from zenostat.bridge.node.settings import NodeSettings
from zenostat.bridge.python_plant.shipped import PLANT_SETTINGS
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.transport.session import default_endpoint, exposure
from zenostat.cli import node_options as options
from zenostat.cli.console import out, progress
from zenostat.cli.options import CertificateName, Expose, Keys, is_explicit
from zenostat.cli.pairs import read_pairs
from zenostat.cli.record import describe_recording
from zenostat.cli.scenarios import check_scenario
from zenostat.cli.statistics import show_statistics
from zenostat.topics.calendar import format_duration
from zenostat.topics.errors import AddressInUse, InvalidConfig, NodeNotFound
from zenostat.topics.messages import REJECTIONS, Event, EventKind, Mode, OnFull, Policy, RecordingStatus, State
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    from rich.progress import Progress

    from zenostat.bridge.node.node import Node
    from zenostat.bridge.node.server import NodeServer

_RESUMED_OPTIONS = (
    "resume",
    "listen",
    "connect",
    "no_listen",
    "expose",
    "keys",
    "certificate",
    "branches",
    "unresponsive_s",
    "record_on_full",
    "history_mb",
    "affinity",
)
"""Options that a recording does not determine."""

_WARNINGS = (*REJECTIONS, EventKind.WARNING, EventKind.FALLBACK, EventKind.EXPIRED)
"""Kinds of events with the level `warning` in a log."""


def node(
    context: typer.Context,
    scenario: options.Scenario = None,
    building: options.Building = None,
    weather: options.Weather = None,
    name: options.Name = "building",
    begin: options.Begin = None,
    end: options.End = None,
    steps_per_hour: options.StepsPerHour = None,
    mode: options.Mode = Mode.LOCKSTEP,
    speed: options.Speed = None,
    faults: options.Faults = None,
    alarms: options.Alarms = None,
    policy: options.Policy = Policy.WAIT,
    grace_s: options.Grace = 0.0,
    deadline_s: options.Deadline = None,
    listen: options.Listen = None,
    connect: options.Connect = None,
    no_listen: options.NoListen = False,
    expose: Expose = False,
    keys: Keys = None,
    certificate: CertificateName = None,
    slots: options.Slots = 1,
    no_monitoring: options.NoMonitoring = False,
    systems: options.Systems = False,
    baseline: options.Baseline = False,
    branches: options.Branches = 256,
    unresponsive_s: options.Unresponsive = 10.0,
    no_shrink_caches: options.NoShrinkCaches = False,
    resume: options.ResumeFile = None,
    record: options.Record = None,
    record_on_full: options.RecordOnFull = OnFull.WAIT,
    overwrite: options.Overwrite = False,
    history_mb: options.HistoryMB = 16.0,
    output_dir: options.OutputDir = None,
    keep_last: options.KeepLast = None,
    affinity: options.Affinity = Affinity.SEPARATE_CORES,
    plant: options.Plant = None,
    fmu: options.Fmu = None,
    grid: options.Grid = None,
    set_value: options.SetValue = None,
    plant_argument: options.PlantArgument = None,
) -> None:
    """Simulate a building, or a plant of your own, and put it on the bus, until Ctrl-C or `zenostat stop`.

    Example: `zenostat node --building office-medium --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office`

    Example: `zenostat node --plant tank.py:Tank --name tank`

    Example: `zenostat node --fmu tank.fmu --set tank.T0=293.15 --name tank`

    Example: `zenostat node --resume run.mcap`
    """
    settings = dict(locals())
    _check_options(settings)
    settings["record_overwrite"] = settings.pop("overwrite")
    del settings["no_listen"], settings["no_monitoring"], settings["no_shrink_caches"], settings["plant_argument"]
    del settings["set_value"], settings["context"]
    if speed is None:
        del settings["speed"]
    settings |= {
        "weather": weather or None,
        "connect": connect or [],
        "listen": [] if no_listen else [listen or default_endpoint(keys)],
        "monitoring": not no_monitoring,
        "shrink_caches": not no_shrink_caches,
    }
    if resume is not None and not any((scenario, building, plant, fmu, grid)):
        _run_resumed(context, settings, is_endpoint_explicit=listen is not None)
        return
    if resume is not None:
        settings |= _resume_or_record(context, resume)
    _run(_with_plant(settings, set_value, plant_argument), is_endpoint_explicit=listen is not None)


def _check_options(parameters: dict[str, Any]) -> None:
    """Raise `InvalidConfig` for options that do not go together."""
    listen, speed, mode = parameters["listen"], parameters["speed"], parameters["mode"]
    if parameters["no_listen"] and listen:
        raise InvalidConfig(f"--listen {listen} conflicts with --no-listen; use one of them")
    if speed is not None and mode is not Mode.PACED:
        raise InvalidConfig(f"--speed {speed:g} needs --mode paced; {mode} mode has no speed")
    if parameters["resume"] is not None and parameters["record"] is not None:
        raise InvalidConfig("--resume FILE goes on recording to its file; leave --record out")
    if parameters["overwrite"] and parameters["record"] is None:
        raise InvalidConfig("--overwrite needs --record FILE.mcap")
    if parameters["set_value"] and parameters["fmu"] is None:
        raise InvalidConfig("--set needs --fmu FILE.fmu")


def _with_plant(
    settings: dict[str, Any], set_value: list[str] | None, plant_argument: list[str] | None
) -> dict[str, Any]:
    """Return the settings with those of a plant of one's own, or without any."""
    plant, fmu, grid = settings["plant"], settings["fmu"], settings["grid"]
    if plant is None and fmu is None and grid is None:
        if plant_argument:
            raise InvalidConfig("--plant-argument needs --plant FILE.py:CLASS, --fmu FILE.fmu or --grid FILE.yaml")
        return {name: value for name, value in settings.items() if name not in ("plant", "fmu", "grid")}
    arguments = read_pairs("--plant-argument", plant_argument, "a name and a value", "power_w=2000")
    if set_value:
        variable = "a variable and a value", "tank.T0=293.15"
        arguments["set"] = read_pairs("--set", set_value, *variable, split=str.rpartition)
    shrink_caches = None if settings["shrink_caches"] else False
    return {**settings, "plant_arguments": arguments, "shrink_caches": shrink_caches}


def _resume_or_record(context: typer.Context, resume: Path) -> dict[str, Any]:
    """Return the settings to go on with a recording, or to start it if there is nothing in it yet.

    Options that are not on the command line are those of the recorded node.
    """
    from zenostat.topics.extras import requires_extra

    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from zenostat.bridge.recording.continuation import has_messages
        from zenostat.eplus_node.resume import recorded_settings
    if has_messages(resume):
        recorded = recorded_settings(resume)
        return {"resume": resume} | {name: recorded[name] for name in recorded if not is_explicit(context, name)}
    return {"resume": None, "record": resume, "record_overwrite": True}


def _run_resumed(context: typer.Context, settings: dict[str, Any], *, is_endpoint_explicit: bool) -> None:
    """Run a node that goes on with a recording, which says what it simulates."""
    from zenostat.topics.extras import requires_extra

    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from zenostat.eplus_node.resume import read_resumed, resumed_node
    conflicting = [
        f"--{name.removesuffix('_s').replace('_', '-')}"
        for name in context.params
        if name not in _RESUMED_OPTIONS and is_explicit(context, name)
    ]
    if conflicting:
        raise InvalidConfig(
            f"{', '.join(conflicting)}: the recording of --resume determines what is simulated and how; leave it out, "
            "or name the building or plant as well, so that a new node starts if there is no recording yet"
        )
    kept = {name: value for name, value in settings.items() if name in (*_RESUMED_OPTIONS, "listen", "connect")}
    config = read_resumed({name: value for name, value in kept.items() if name in NodeSettings.model_fields})
    _serve(config, resumed_node, is_endpoint_explicit=is_endpoint_explicit)


def _run(settings: dict[str, Any], *, is_endpoint_explicit: bool) -> None:
    """Run the node until it ends."""
    config, create = _read(settings)
    _serve(config, create, is_endpoint_explicit=is_endpoint_explicit)


def _serve(config: NodeSettings, create: Callable[..., Node], *, is_endpoint_explicit: bool) -> None:
    """Run the node until it ends, with a progress bar, and print its statistics."""
    with progress() as bars, ExitStack() as stack:
        observer = ProgressBar(bars, config.name)
        create = partial(create, observer=observer, program=True)
        running = start(stack, config, create, is_endpoint_explicit=is_endpoint_explicit)
        observer.recording = lambda: running.recording
        observer.warning = lambda: running.namesake_warning or running.link_warning or running.expiry_warning
        if running.recording is not None:
            out.print(f"{config.name}: {describe_recording(running.recording)}")
        log_events(running)
        running.serve()
        statistics, controllers = running.server.statistics(), running.exchange.controllers()
    if not out.is_json:
        show_statistics(statistics, controllers)
    if running.recording is not None:
        out.print(f"{config.name}: {describe_recording(running.recording)}")
    out.print(f"{config.name}: ended")


def log_events(node: Node) -> None:
    """Add the events of a node from now on to the log, if there is one."""
    if out.is_json:
        node.server.on_event = partial(_log_event, node.manifest.node)


def _log_event(node: str, event: Event) -> None:
    """Add an event of a node to the log."""
    fields = event.model_dump(mode="json", include={"kind", "source", "error", "episode", "step", "late_s"})
    level = "error" if event.kind is EventKind.FAILED else "warning" if event.kind in _WARNINGS else "info"
    out.entry(level, event.text, node=node, **fields)


def _read(settings: dict[str, Any]) -> tuple[NodeSettings, Callable[..., Node]]:
    """Validate settings; return them and the function that creates the node."""
    if PLANT_SETTINGS & settings.keys():
        from zenostat.bridge.python_plant.node import plant_node, read_settings

        return read_settings(settings), plant_node
    from zenostat.eplus_node.config import read_config
    from zenostat.eplus_node.node import energyplus_node

    if Path(settings["scenario"] or "").suffix in (".yaml", ".yml"):  # an id's fields are valid
        check_scenario(settings)
    return read_config(settings), energyplus_node


def start(stack: ExitStack, config: NodeSettings, create: Callable[..., Node], *, is_endpoint_explicit: bool) -> Node:
    """Start the node, and print what it simulates, where it listens and its warnings.

    If the default endpoint is in use, it connects to the node that listens there instead.

    Args:
        stack: closes the node.
        config: settings of the node.
        create: creates the node from its settings.
        is_endpoint_explicit: whether the user named the endpoint to listen on.

    Raises:
        AddressInUse: the user named an endpoint that is in use, or the program at the default endpoint is no node.
    """
    node = _start(stack, config, create, is_endpoint_explicit=is_endpoint_explicit)
    out.print(greeting(node, ", ".join(node.settings.listen or node.settings.connect)))
    exposed = exposure(node.settings.listen, config.keys)
    for warning in filter(None, (*node.manifest.warnings, exposed, node.certificate_warning)):
        out.warning(warning)
    return node


def _start(stack: ExitStack, config: NodeSettings, create: Callable[..., Node], *, is_endpoint_explicit: bool) -> Node:
    try:
        return stack.enter_context(create(config))
    except AddressInUse as error:
        if is_endpoint_explicit:
            raise
        endpoints = config.connect or config.listen
        joined = config.model_copy(update={"listen": [], "connect": endpoints})
        try:
            running = stack.enter_context(create(joined))
        except NodeNotFound:
            raise error from None
    out.print(
        f"{', '.join(config.listen)} is in use by another program, so {config.name} does not listen; it shares the bus "
        f"at {', '.join(endpoints)}. For a separate bus, listen on another port: --listen tcp/127.0.0.1:7448"
    )
    return running


class ProgressBar:
    """Show a node's progress, at most ten times per second while it runs, and what its user has to know.

    That is why its recording stopped early, that another node has its name, and warnings of its plant.

    Attributes:
        recording: returns the state of the node's recording.
        warning: returns the warning about another node of the same name, the node's connection or its certificate;
            empty without one.
    """

    def __init__(self, bars: Progress, name: str) -> None:
        self.recording: Callable[[], RecordingStatus | None] = lambda: None
        self.warning: Callable[[], str] = str
        self._stopped = self._warned = ""
        self._warnings = 0
        self._bars = bars
        self._name = name
        self._bar = bars.add_task(f"{name}: starting", total=None, rate="")
        self._updated_s = 0.0

    def __call__(self, node: NodeServer) -> None:
        """Show the state of a node."""
        if (warning := self.warning()) != self._warned:  # also of a node that waits, and would not come here again
            self._warned = warning
            if warning:
                out.warning(warning)
        if len(node.plant_warnings) > self._warnings and not out.is_json:  # the log has all events
            for text in [*node.plant_warnings][self._warnings :]:
                out.warning(f"{self._name}: {text}")
            self._warnings = len(node.plant_warnings)
        now, state = time.monotonic(), node.exchange.state
        if now - self._updated_s < 0.1 and state is State.WAITING and not node.exchange.awaiting():
            return
        self._updated_s = now
        description = f"{self._name}: episode {node.exchange.episode[0]}, {state}"
        self._bars.update(
            self._bar, description=description, completed=node.exchange.step[0], total=node.manifest.steps
        )
        self._report_stopped_recording()

    def _report_stopped_recording(self) -> None:
        status = self.recording()
        if status is None or not status.reason or status.path == self._stopped:
            return
        self._stopped = status.path
        out.warning(f"{self._name}: the recording to {status.path} stopped: {status.reason}")


def greeting(node: Node, listen: str) -> str:
    """Describe a node that has started, and where it listens."""
    manifest, run_period = node.manifest, node.plant.description.run_period
    location = f" in {manifest.location}" if manifest.location else ""
    return (
        f"{manifest.node} on {listen}: {manifest.building}{location}, "
        f"{run_period.begin:%Y-%m-%d} to {run_period.end - timedelta(seconds=run_period.step_s):%Y-%m-%d}, "
        f"{counted(manifest.steps, 'timestep')} of {format_duration(manifest.step_s)}; "
        f"{counted(len(manifest.sensors), 'sensor')}, {counted(len(manifest.meters), 'meter')}, "
        f"{counted(len(manifest.actuators), 'actuator')}. "
        "Press Ctrl-C to stop."
    )
