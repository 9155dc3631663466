"""`zenostat pace`, `pause`, `resume`, `step` and `faults`: control time and faults of a running node."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import out
from zenostat.cli.options import DEFAULTS, BusOptions, Node, on_bus
from zenostat.cli.write import person
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import Role
from zenostat.topics.messages import Mode, State, Status
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    from zenostat import Bus

_POLL_S = 0.05
_STALLED_S = 2.0
"""A lockstep node that stays at one sample for this long is waiting for its controllers."""


@on_bus
def pace(
    node: Node,
    speed: Annotated[str, typer.Argument(help="Simulated seconds per second, lockstep, or free.")],
    options: BusOptions = DEFAULTS,
) -> None:
    """Pace a node by the wall clock at a given speed, by its controllers (lockstep), or not at all (free).

    Example: `zenostat pace office 60`
    """
    mode, number = read_pace(speed)
    _ask(node, options, lambda bus: bus.pace(node, number, mode=mode, source=person()))


@on_bus
def pause(node: Node, options: BusOptions = DEFAULTS) -> None:
    """Pause a node, in any mode.

    Example: `zenostat pause office`
    """
    _ask(node, options, lambda bus: bus.pause(node, source=person()))


@on_bus
def resume(node: Node, options: BusOptions = DEFAULTS) -> None:
    """Resume a paused node; a paced node continues without catching up.

    Example: `zenostat resume office`
    """
    _ask(node, options, lambda bus: bus.resume(node, source=person()))


@on_bus
def step(
    node: Node,
    steps: Annotated[int, typer.Argument(min=1, max=1_000_000, help="Number of timesteps.")] = 1,
    options: BusOptions = DEFAULTS,
) -> None:
    """Advance a paused node by some timesteps; in lockstep, each timestep still waits for its commands.

    Returns when the timesteps are simulated, or when the node waits for a controller.

    Example: `zenostat step office 4`
    """

    def advance(bus: Bus) -> str:
        before = bus.status(node)
        bus.step(node, steps, source=person())
        return _after_steps(bus, before, steps)

    _ask(node, options, advance)


@on_bus
def faults(
    node: Node,
    file: Annotated[Path | None, typer.Argument(help="Fault plan (YAML); see docs/faults.md.")] = None,
    clear: Annotated[bool, typer.Option("--clear", help="Remove all faults.")] = False,
    options: BusOptions = DEFAULTS,
) -> None:
    """Replace the fault plan of a running node.

    Example: `zenostat faults office --clear`
    """
    if (file is None) is not clear:
        raise InvalidConfig("expected either a file with a fault plan, or --clear to remove all faults")
    _ask(node, options, lambda bus: bus.faults(node, file))


def read_pace(text: str) -> tuple[Mode, float | None]:
    """Return mode and speed for `60`, `lockstep` or `free`.

    Raises:
        InvalidConfig: the text is none of these.
    """
    if text in (Mode.LOCKSTEP, Mode.FREE):
        return Mode(text), None
    try:
        return Mode.PACED, float(text)
    except ValueError:
        raise InvalidConfig(
            f"{text!r} is not a pace: expected a number above 0 (simulated seconds per second), lockstep or free"
        ) from None


def _ask(node: str, options: BusOptions, request: Callable[[Bus], str | None]) -> None:
    """Send a request to a node, and print the node's status afterwards."""
    with options.open_bus(Role.OPERATOR) as bus:
        note = request(bus)
        now = bus.status(node)
    pace = f"paced, {now.speed:g} times the wall clock" if now.mode is Mode.PACED else str(now.mode)
    parts = [f"{node}: {pace}", *(["paused"] if now.paused else [])]
    parts += [f"step {now.step[0]} of {now.steps}, {now.time[0]}"]
    parts += [f"active faults: {', '.join(now.faults)}"] if now.faults else []
    parts += [note] if note else []
    out.print("; ".join(parts))


def _after_steps(bus: Bus, before: Status, steps: int) -> str:
    """Wait until a node has simulated some timesteps; return a note if it waits for a controller instead."""
    last, goal, since = before, min(before.step[0] + steps, before.steps), time.monotonic()
    while last.episode == before.episode and last.state in (State.WAITING, State.RUNNING) and last.step[0] < goal:
        time.sleep(_POLL_S)
        now = bus.status(before.node)
        if now.step != last.step or now.state is State.RUNNING:
            since = time.monotonic()
        elif now.mode is Mode.LOCKSTEP and time.monotonic() - since > _STALLED_S:
            awaited = ", ".join(c.controller for c in now.controllers if c.required) or "a controller"
            return f"{goal - now.step[0]} of {counted(steps, 'timestep')} left: waiting for {awaited}"
        last = now
    return ""
