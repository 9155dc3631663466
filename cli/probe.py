"""`zenostat probe`: how the points of a building respond to each actuator of a scenario."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import out, progress
from zenostat.cli.node_options import Begin, End
from zenostat.cli.pairs import read_pairs, read_parameters
from zenostat.cli.tables import AsJson, show, show_json
from zenostat.topics.errors import ErrorCollector
from zenostat.topics.plurals import counted
from zenostat.topics.units import with_unit

if TYPE_CHECKING:
    from zenostat.lab.probe import ProbeReport, Progress
    from zenostat.lab.probe_effects import Effect

_MAX_POINTS = 5
"""Points for each actuator in the table; `--json` has all."""


def probe(
    scenario: Annotated[str, typer.Argument(help="Scenario id (see `zenostat scenarios`) or scenario file.")],
    hours: Annotated[float, typer.Option(help="Simulated hours of each branch.")] = 3.0,
    days: Annotated[
        int, typer.Option(min=1, help="Number of days, spread over the run period, on which branches start.")
    ] = 4,
    at: Annotated[
        list[float] | None, typer.Option(help="Hour of the day at which branches start; repeatable. Default: 7 and 15.")
    ] = None,
    points: Annotated[
        list[str] | None,
        typer.Option(help="Sensor or meter to compare, or a pattern ('*temperature'); repeatable. Default: all."),
    ] = None,
    low: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Value to use instead of an actuator's lower bound; repeatable."),
    ] = None,
    high: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Value to use instead of an actuator's upper bound; repeatable."),
    ] = None,
    begin: Begin = None,
    end: End = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 0,
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Override an argument of the scenario (weather, control, ...); repeatable.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Hold each actuator low and high in branches of the running building, and list the points that respond.

    Example: `zenostat probe ref-small-office-USA_CO_Denver-continuous-v1 --begin 07-03 --end 07-07 --hours 2`
    """
    errors = ErrorCollector()
    lows = errors.collect(lambda: _read_bounds("--low", low))
    highs = errors.collect(lambda: _read_bounds("--high", high))
    arguments = errors.collect(lambda: read_parameters(overrides)) or {}
    errors.raise_if_any()
    arguments |= {name: day for name, day in (("begin", begin), ("end", end)) if day is not None}
    from zenostat.lab.probe import probe as run

    with ExitStack() as stack:
        watch = None if as_json else _watcher(stack, scenario)
        report = run(
            scenario, hours=hours, days=days, at=at or (7, 15), points=points or (), low=lows, high=highs, seed=seed,
            progress=watch, **arguments,
        )  # fmt: skip
    if as_json:
        show_json(probe_fields(report))
    else:
        show_table(report, scenario)


def _read_bounds(option: str, texts: Sequence[str] | None) -> dict[str, float]:
    return read_pairs(option, texts, "an actuator and a number", "heating_setpoint=18", read=float)


def _watcher(stack: ExitStack, scenario: str) -> Progress:
    bars = stack.enter_context(progress())
    bar = bars.add_task(scenario, total=None, rate="")

    def watch(done: int, total: int) -> None:
        speed = bars.tasks[bar].speed
        bars.update(bar, completed=done, total=total, rate=f"{speed:,.0f} steps/s" if speed else "")

    return watch


def probe_fields(report: ProbeReport) -> dict[str, Any]:
    """Return what responds to each actuator as JSON built-ins."""
    manifest = report.manifest
    effects = [asdict(effect) for effect in report.effects]
    for effect in effects:
        for response in effect["responses"]:
            response["time"] = response["time"].isoformat()
    return {
        "building": manifest.building,
        "weather": manifest.weather,
        "times": [time.isoformat() for time in report.times],
        "hours": report.hours,
        "timestep_min": manifest.step_s / 60.0,
        "actuators": effects,
    }


def show_table(report: ProbeReport, scenario: str) -> None:
    """Print what responds to each actuator, with the scenario in the title."""
    numbers = ("first response", "difference", "share of range", "after")
    columns = ("actuator", "held at", numbers[0], "point", *numbers[1:3], "branch", numbers[3])
    title = f"{scenario}: each actuator held for {report.hours:g} h from {counted(len(report.times), 'sample')}"
    rows = [row for effect in report.effects for row in _rows(effect)]
    show(title, columns, rows, right=numbers, wrap=("actuator", "point"))
    for effect in report.effects:
        for text in _notes(effect):
            out.print(text)


def _rows(effect: Effect) -> Iterator[tuple[str, ...]]:
    first = "never" if effect.first_min is None else f"{effect.first_min:g} min"
    head = (effect.actuator, with_unit(f"{effect.low:.4g}, {effect.high:.4g}", effect.unit), first)
    if not effect.responses:
        yield (*head, "none", "", "", "", "")
    for response in effect.responses[:_MAX_POINTS]:
        difference = with_unit(f"{response.difference:,.4g}", response.unit)
        branch = f"{response.side}, {response.time:%d %b %H:%M}"
        yield (*head, response.point, difference, f"{response.share:.0%}", branch, f"{response.after_min:g} min")
        head = ("", "", "")


def _notes(effect: Effect) -> Iterator[str]:
    if not effect.responses:
        exact = "exactly equal" if effect.identical else "equal up to rounding"
        yield f"{effect.actuator} has no effect: all points are {exact} in all branches"
    if effect.pass_through:
        yield f"{effect.actuator}: only passed through by {', '.join(effect.pass_through)}"
    yield from (f"{effect.actuator}: {note}" for note in effect.notes)
