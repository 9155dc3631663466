"""Options of `zenostat node`; the texts of those that a scenario has too are in `zenostat.topics.scenario_fields`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from zenostat.bridge.runtime import affinity
from zenostat.bridge.transport.session import DEFAULT_ENDPOINT
from zenostat.topics import messages
from zenostat.topics.scenario_fields import MEANING


def argument(name: str, *flags: str, note: str = "", **settings: Any) -> Any:
    """Return the option of a scenario's argument."""
    return typer.Option(*flags, help=f"{MEANING[name]}{note}", **settings)


Scenario = Annotated[str | None, argument("scenario")]
Building = Annotated[str | None, argument("building")]
Weather = Annotated[list[str] | None, argument("weather", note=" Repeatable.")]
Name = Annotated[str, typer.Option(help="Name of the node on the bus.")]
Begin = Annotated[str | None, argument("begin")]
End = Annotated[str | None, argument("end")]
StepsPerHour = Annotated[int | None, argument("steps_per_hour")]
Mode = Annotated[
    messages.Mode,
    typer.Option(help="lockstep: wait for the required controllers; paced: by the wall clock; free: never wait."),
]
Speed = Annotated[float | None, typer.Option(help="Simulated seconds per second in paced mode. Default: 1.")]
Faults = Annotated[Path | None, argument("faults")]
Alarms = Annotated[Path | None, argument("alarms")]
Policy = Annotated[
    messages.Policy,
    typer.Option(help="If a required controller is missing: wait, hold or relinquish its commands, or abort."),
]
Grace = Annotated[
    float,
    typer.Option(
        "--grace", metavar="SECONDS", help="Wall time that a controller may be disconnected before the policy applies."
    ),
]
Deadline = Annotated[
    float | None,
    typer.Option(
        "--deadline", metavar="SECONDS", help="Wall time that a lockstep step waits for commands. Default: no limit."
    ),
]
Listen = Annotated[str | None, typer.Option(help="Endpoint to listen on.", show_default=DEFAULT_ENDPOINT)]
Connect = Annotated[
    list[str] | None, typer.Option(help="Endpoint of a router, or of another node to share its bus; repeatable.")
]
NoListen = Annotated[bool, typer.Option("--no-listen", help="Only connect to a router or another node.")]
Slots = Annotated[int, typer.Option(help="Number of engines that step together, each with its own episode.")]
NoMonitoring = Annotated[
    bool, typer.Option("--no-monitoring", help="Do not measure what only pictures and reports need.")
]
Systems = Annotated[bool, argument("systems", "--systems")]
Baseline = Annotated[bool, argument("baseline", "--baseline")]
Branches = Annotated[int, argument("branches")]
Unresponsive = Annotated[float, argument("unresponsive_s", "--unresponsive", metavar="SECONDS")]
NoShrinkCaches = Annotated[
    bool, typer.Option("--no-shrink-caches", help="Leave the size of EnergyPlus's caches as it is.")
]
Record = Annotated[Path | None, argument("record")]
ResumeFile = Annotated[
    Path | None,
    typer.Option(
        "--resume",
        metavar="FILE.mcap",
        help="Go on where this recording of an ended node stops: simulate it again to its last complete timestep, and "
        "record on to it. If options say what to simulate and the file does not exist, a new node records to it.",
    ),
]
RecordOnFull = Annotated[messages.OnFull, argument("record_on_full")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the file of --record if it is a recording.")]
HistoryMB = Annotated[
    float, typer.Option("--history-mb", min=0, max=4096, help="Memory for the history of the episode, in MB; 0: none.")
]
OutputDir = Annotated[Path | None, argument("output_dir")]
KeepLast = Annotated[int | None, argument("keep_last", min=1, note=" Default: all.")]
Affinity = Annotated[affinity.Affinity, typer.Option(help="Assignment to CPU cores; see docs/architecture.md.")]
Plant = Annotated[str | None, argument("plant")]
Fmu = Annotated[str | None, argument("fmu")]
Grid = Annotated[str | None, argument("grid")]
SetValue = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Start value of a variable of the FMU; repeatable."),
]
PlantArgument = Annotated[
    list[str] | None,
    typer.Option("--plant-argument", metavar="NAME=VALUE", help="Argument of the plant's class; repeatable."),
]
