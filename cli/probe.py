"""`zenostat probe`: what each actuator of a scenario does to the building."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.console import out, progress
from cli.run import read_parameters
from cli.tables import show, show_json
from topics.errors import ErrorCollector, InvalidConfig

if TYPE_CHECKING:
    from agent_sdk.evaluation.probe import ProbeReport, Progress
    from agent_sdk.evaluation.probe_effects import Effect

_MOST = 5
"""Points of an actuator that the table shows; `--json` has all."""


def probe(
    scenario: Annotated[str, typer.Argument(help="An id, as `zenostat scenarios` lists them, or a scenario file.")],
    hours: Annotated[float, typer.Option(help="Simulated hours of each branch.")] = 3.0,
    days: Annotated[int, typer.Option(min=1, help="Days that branches begin on, spread over the run period.")] = 4,
    at: Annotated[list[float] | None, typer.Option(help="Hour of the day; repeated. Without: 7 and 15.")] = None,
    points: Annotated[
        list[str] | None, typer.Option(help="A sensor or meter to compare, or a pattern ('*temperature'); repeated.")
    ] = None,
    low: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="What an actuator is held at, in place of its bound.")
    ] = None,
    high: Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help="The same at the other end.")] = None,
    begin: Annotated[str | None, typer.Option(help="First day, MM-DD or YYYY-MM-DD.")] = None,
    end: Annotated[str | None, typer.Option(help="Last day.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the episode.")] = 0,
    given: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="A setting of the scenario (weather, control, ...); repeated."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Holds each actuator low and high for some hours in branches of the running building, and says what feels it.

    Example: `zenostat probe ref-small-office-USA_CO_Denver-continuous-v1 --begin 07-03 --end 07-07 --hours 2`
    """
    faults = ErrorCollector()
    sides = [faults.collect(lambda o=o, t=t: _numbers(o, t)) for o, t in (("--low", low), ("--high", high))]  # type: ignore[misc]
    settings = faults.collect(lambda: read_parameters(given or [])) or {}
    faults.raise_if_any()
    settings |= {name: day for name, day in (("begin", begin), ("end", end)) if day is not None}
    from agent_sdk.evaluation.probe import probe as run

    with ExitStack() as stack:
        watch = None if as_json else _watcher(stack, scenario)
        found = run(
            scenario, hours=hours, days=days, at=at or (7, 15), points=points or (), low=sides[0], high=sides[1],
            seed=seed, progress=watch, **settings,
        )  # fmt: skip
    if as_json:
        show_json(_plain(found))
    else:
        _show(found, scenario)


def _numbers(option: str, given: Sequence[str] | None) -> dict[str, float]:
    found: dict[str, float] = {}
    for text in given or ():
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise InvalidConfig(
                f"{option} {text}: an actuator and a number expected, as {option} heating_setpoint=18"
            ) from None
    return found


def _watcher(stack: ExitStack, scenario: str) -> Progress:
    bars = stack.enter_context(progress())
    bar = bars.add_task(scenario, total=None, rate="")

    def watch(done: int, total: int) -> None:
        speed = bars.tasks[bar].speed
        bars.update(bar, completed=done, total=total, rate=f"{speed:,.0f} steps/s" if speed else "")

    return watch


def _plain(found: ProbeReport) -> dict[str, Any]:
    """All of it, times as texts."""
    manifest = found.manifest
    effects = [asdict(effect) for effect in found.effects]
    for effect in effects:
        for felt in effect["felt"]:
            felt["time"] = felt["time"].isoformat()
    return {
        "building": manifest.building,
        "weather": manifest.weather,
        "times": [time.isoformat() for time in found.times],
        "hours": found.hours,
        "timestep_min": 60 / manifest.steps_per_hour,
        "actuators": effects,
    }


def _show(found: ProbeReport, scenario: str) -> None:
    columns = ("actuator", "held at", "first felt", "by", "difference", "of its range", "held", "after")
    title = f"{scenario}: {len(found.times)} steps, held for {found.hours:g} h"
    rows = [row for effect in found.effects for row in _rows(effect)]
    show(title, columns, rows, right=("first felt", "difference", "of its range", "after"), wrap=("actuator", "by"))
    for effect in found.effects:
        for text in _texts(effect):
            out.print(text, soft_wrap=True, markup=False)


def _rows(effect: Effect) -> Iterator[tuple[str, ...]]:
    unit = _unit(effect.unit)
    first = "never" if effect.first_min is None else f"{effect.first_min:g} min"
    head = (effect.actuator, f"{effect.low:.4g}, {effect.high:.4g}{unit}", first)
    if not effect.felt:
        yield (*head, "nothing", "", "", "", "")
    for felt in effect.felt[:_MOST]:
        difference = f"{felt.difference:,.4g}{_unit(felt.unit)}"
        when = f"{felt.side}, {felt.time:%d %b %H:%M}"
        yield (*head, felt.point, difference, f"{felt.share:.0%}", when, f"{felt.after_min:g} min")
        head = ("", "", "")


def _unit(unit: str) -> str:
    return "" if unit in ("", "1") else f" {unit}"


def _texts(effect: Effect) -> Iterator[str]:
    if not effect.felt:
        exact = "to the last bit" if effect.identical else "beyond rounding"
        yield f"{effect.actuator} has no effect on any point: nothing differs {exact} in any branch"
    if effect.pass_through:
        yield f"{effect.actuator}: only repeated by {', '.join(effect.pass_through)}"
    yield from (f"{effect.actuator}: {note}" for note in effect.notes)
