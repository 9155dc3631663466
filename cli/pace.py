"""`zenostat pace`, `pause`, `resume`, `step` and `faults`: what a running node does with time, and what goes wrong."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.transport.session import default_endpoint
from cli.console import out
from cli.options import CertificateName, Connect, Keys
from cli.write import Node, person
from topics.errors import InvalidConfig
from topics.messages import Mode, State, Status

if TYPE_CHECKING:
    from agent_sdk import Bus


_PAUSE_S = 0.05
_UNANSWERED_S = 2.0
"""A lockstep node that stands at a sample for so long waits for its controllers."""


def pace(
    node: Node,
    speed: Annotated[str, typer.Argument(help="Simulated seconds in a second; or lockstep, or free.")],
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
) -> None:
    """Has a node go by the wall clock at a multiple of its speed, or by its controllers, or as fast as it can.

    Example: `zenostat pace office 60`
    """
    mode, number = read_pace(speed)
    _ask(node, connect, keys, certificate, lambda bus: bus.pace(node, number, mode=mode, source=person()))


def pause(node: Node, connect: Connect = None, keys: Keys = None, certificate: CertificateName = None) -> None:
    """Has a node stand still, in whatever mode.

    Example: `zenostat pause office`
    """
    _ask(node, connect, keys, certificate, lambda bus: bus.pause(node, source=person()))


def resume(node: Node, connect: Connect = None, keys: Keys = None, certificate: CertificateName = None) -> None:
    """Has a node go on; a paced one from where it stands, without catching up.

    Example: `zenostat resume office`
    """
    _ask(node, connect, keys, certificate, lambda bus: bus.resume(node, source=person()))


def step(
    node: Node,
    steps: Annotated[int, typer.Argument(min=1, max=1_000_000, help="Timesteps.")] = 1,
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
) -> None:
    """Has a node that is paused go some timesteps: in lockstep once they are answered, else at once.

    It waits until they are over, or wait for a controller, and says where the node stands then.

    Example: `zenostat step office 4`
    """

    def go(bus: Bus) -> str:
        before = bus.status(node)
        bus.step(node, steps, source=person())
        return _after_steps(bus, before, steps)

    _ask(node, connect, keys, certificate, go)


def faults(
    node: Node,
    file: Annotated[Path | None, typer.Argument(help="A plan (YAML); see docs/faults.md.")] = None,
    clear: Annotated[bool, typer.Option("--clear", help="No more faults.")] = False,
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
) -> None:
    """Has a running node inject faults from now on, in place of those that were there.

    Example: `zenostat faults office --clear`
    """
    if (file is None) is not clear:
        raise InvalidConfig("name a file with a plan, or --clear for no more faults")
    _ask(node, connect, keys, certificate, lambda bus: bus.faults(node, file))


def read_pace(text: str) -> tuple[Mode, float | None]:
    """The mode and the speed of `60`, `lockstep` or `free`.

    Raises:
        InvalidConfig: anything else.
    """
    if text in (Mode.LOCKSTEP, Mode.FREE):
        return Mode(text), None
    try:
        return Mode.PACED, float(text)
    except ValueError:
        raise InvalidConfig(
            f"{text!r} is no pace: a number above 0 (simulated seconds in a second), lockstep or free expected"
        ) from None


def _ask(
    node: str, connect: str | None, keys: Path | None, certificate: str | None, request: Callable[[Bus], str | None]
) -> None:
    """Asks a node for something, and says where it stands then."""
    from agent_sdk import connect as connect_bus

    with connect_bus(connect or default_endpoint(keys), keys=keys, certificate=certificate) as bus:
        note = request(bus)
        now = bus.status(node)
    pace = f"paced, {now.speed:g} times the wall clock" if now.mode is Mode.PACED else str(now.mode)
    said = [f"{node}: {pace}", *(["paused"] if now.paused else []), f"step {now.step[0]} of {now.steps}, {now.time[0]}"]
    said += [f"faults that are on: {', '.join(now.faults)}"] if now.faults else []
    said += [note] if note else []
    out.print("; ".join(said), markup=False, soft_wrap=True)


def _after_steps(bus: Bus, before: Status, steps: int) -> str:
    """Wait until a node has gone some timesteps; what keeps it from that, if anything does."""
    last, goal, since = before, min(before.step[0] + steps, before.steps), time.monotonic()
    while last.episode == before.episode and last.state in (State.WAITING, State.RUNNING) and last.step[0] < goal:
        time.sleep(_PAUSE_S)
        now = bus.status(before.node)
        if now.step != last.step or now.state is State.RUNNING:
            since = time.monotonic()
        elif now.mode is Mode.LOCKSTEP and time.monotonic() - since > _UNANSWERED_S:
            who = ", ".join(c.controller for c in now.controllers if c.required) or "a controller"
            return f"{goal - now.step[0]} of {steps} timesteps are still to go: it waits for {who}"
        last = now
    return ""
