"""Options of `zenostat node`, with their help texts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bridge.runtime import affinity
from bridge.transport.session import DEFAULT_ENDPOINT
from topics import messages

Scenario = Annotated[
    str | None, typer.Option(help="Scenario id, or scenario file (YAML); the other options override it.")
]
Building = Annotated[str | None, typer.Option(help="Short name, IDF or epJSON file, or part of a name.")]
Weather = Annotated[
    list[str] | None,
    typer.Option(help="Short name, EPW file, or part of a name; repeatable: one is drawn for each episode."),
]
Name = Annotated[str, typer.Option(help="Name of the node on the bus.")]
Begin = Annotated[str | None, typer.Option(help="First day, MM-DD or YYYY-MM-DD.")]
End = Annotated[str | None, typer.Option(help="Last day, MM-DD or YYYY-MM-DD.")]
StepsPerHour = Annotated[int | None, typer.Option(help="Timesteps per hour. Default: as in the model.")]
Mode = Annotated[
    messages.Mode,
    typer.Option(help="lockstep: wait for the required controllers; paced: by the wall clock; free: never wait."),
]
Speed = Annotated[float | None, typer.Option(help="Simulated seconds per second in paced mode. Default: 1.")]
Faults = Annotated[Path | None, typer.Option(help="Plan of faults to inject (YAML); see docs/faults.md.")]
Policy = Annotated[
    messages.Policy,
    typer.Option(help="If a required controller is missing: wait, hold or relinquish its commands, or abort."),
]
Grace = Annotated[
    float,
    typer.Option(metavar="SECONDS", help="Wall time that a controller may be disconnected before the policy applies."),
]
Deadline = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Wall time that a lockstep step waits for commands. Default: no limit."),
]
Listen = Annotated[str | None, typer.Option(help="Endpoint to listen on.", show_default=DEFAULT_ENDPOINT)]
Connect = Annotated[
    list[str] | None, typer.Option(help="Endpoint of a router, or of another node to share its bus; repeatable.")
]
NoListen = Annotated[bool, typer.Option("--no-listen", help="Only connect to a router or another node.")]
Expose = Annotated[bool, typer.Option("--expose", help="Allow connections from other machines.")]
Slots = Annotated[int, typer.Option(help="Number of engines that step together, each with its own episode.")]
Baseline = Annotated[
    bool, typer.Option("--baseline", help="Also run each episode under baseline control, for comparison.")
]
Branches = Annotated[int, typer.Option(help="Maximum number of snapshots and branches at a time.")]
Unresponsive = Annotated[
    float,
    typer.Option(metavar="SECONDS", help="Kill an engine that neither answers nor computes for this long."),
]
NoShrinkCaches = Annotated[
    bool,
    typer.Option(
        "--no-shrink-caches",
        help="Leave EnergyPlus's memory as it is. Experimental: by default one of its caches is shrunk, because a step "
        "then takes about 9 % less time and a branch 16 MB less memory, with equal results.",
    ),
]
OutputDir = Annotated[Path | None, typer.Option(help="Keep EnergyPlus's output files in this folder.")]
KeepLast = Annotated[
    int | None, typer.Option(min=1, help="Keep output files only for this many finished episodes. Default: all.")
]
Affinity = Annotated[affinity.Affinity, typer.Option(help="Assignment to CPU cores; see docs/architecture.md.")]
