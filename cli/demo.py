"""`zenostat demo`: a week under baseline control and under a rule-based controller, in separate processes."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from zenostat.cli.demo_programs import Demonstration, demonstrate, show_outputs
from zenostat.cli.node_options import argument
from zenostat.cli.results import show_results
from zenostat.topics.errors import InvalidConfig

NODE = "office"
_DEFAULTS = ("office-medium", "USA_CO_Denver", "07-01", "07-07")
PICTURE_TIME = "15:30"
"""Time of the last day at which the screenshot shows the building: in working hours, with the sun up."""


class Subject(StrEnum):
    """Subject of the demonstration."""

    BUILDING = "building"
    DISTRICT = "district"


def demo(
    subject: Annotated[
        Subject,
        typer.Argument(help="A building; or a district of three buildings with PV, a battery and two chargers."),
    ] = Subject.BUILDING,
    folder: Annotated[
        Path, typer.Option(help="Output folder for the recording, the report and the screenshot.")
    ] = Path("demo"),
    building: Annotated[str, argument("building")] = _DEFAULTS[0],
    weather: Annotated[
        str, typer.Option(help="Short name, EPW file, or any unique part of a listed name.")
    ] = _DEFAULTS[1],
    begin: Annotated[str, typer.Option(help="First day, MM-DD or YYYY-MM-DD.")] = _DEFAULTS[2],
    end: Annotated[str, typer.Option(help="Last day, MM-DD or YYYY-MM-DD.")] = _DEFAULTS[3],
) -> None:
    """Run a node, a controller and a monitor in separate processes, and compare two controllers.

    Example: `zenostat demo --begin 01-08 --end 01-14`

    Example: `zenostat demo district`
    """
    if subject is Subject.DISTRICT:
        if (building, weather, begin, end) != _DEFAULTS:
            raise InvalidConfig("the district's buildings and days are those of its file; leave out other options")
        from zenostat.cli.demo_district import demo_district

        demo_district(folder)
        return
    from zenostat.bridge.runtime.affinity import Affinity

    folder.mkdir(parents=True, exist_ok=True)
    settings = {"building": building, "weather": weather, "begin": begin, "end": end, "name": NODE}
    demonstration = Demonstration(
        settings={**settings, "monitoring": True},  # for the report
        affinity=Affinity.SEPARATE_CORES,
        status="starting the node",
        controllers=(("baseline", "baseline control"), ("rbc", "rule-based control")),
        recording=folder / "run.rrd",
        screenshot=folder / "run.png",
        picture_options=("--at", f"{end}T{PICTURE_TIME}"),
        report=folder / "report.html",
    )
    outcome = demonstrate(demonstration)
    results = {run.name: (run.results[0], rate) for run, rate in zip(outcome.runs, outcome.rates, strict=True)}
    show_results(results, f"{building}, {weather}, {begin} to {end}")
    files = {"recording": demonstration.recording, "report": demonstration.report}
    show_outputs(demonstration, outcome, files)
