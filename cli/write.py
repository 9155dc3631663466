"""`zenostat write` and `zenostat relinquish`: set or relinquish one actuator of a running node by hand."""

from __future__ import annotations

import getpass
import socket
from typing import Annotated

import typer

from zenostat.cli.console import out
from zenostat.cli.options import DEFAULTS, BusOptions, Node, on_bus
from zenostat.topics.calendar import parse_duration
from zenostat.topics.keys import Role, safe_name

Point = Annotated[str, typer.Argument(help="Name of the actuator; `zenostat read NODE` lists them.")]
Priority = Annotated[
    int, typer.Option(min=1, max=16, help="Priority; 1 is the highest, 8 is for manual operation (BACnet).")
]
Source = Annotated[
    str | None,
    typer.Option(help="Name of the sender. Default: user.host; with keys, below the name of the certificate."),
]


@on_bus
def write(
    node: Node,
    point: Point,
    value: Annotated[float, typer.Argument(help="Value in the actuator's unit, within its bounds.")],
    priority: Priority = 8,
    duration: Annotated[
        str | None, typer.Option(metavar="TIME", help="Simulated time until it is relinquished: 90s, 15min, 2h, 1d.")
    ] = None,
    options: BusOptions = DEFAULTS,
    source: Source = None,
) -> None:
    """Set an actuator by hand, from the next timestep until it is relinquished or `--duration` has passed.

    Example: `zenostat write office core_zn_cooling_setpoint 26 --priority 8 --duration 2h`
    """
    duration_s = None if duration is None else seconds(duration)
    with options.open_bus(Role.OPERATOR) as bus:
        ack = bus.write(node, point, value, priority=priority, duration_s=duration_s, source=source or person())
    out.print(f"{node}: {ack.text}" + (f" for {duration}" if duration else ""))


@on_bus
def relinquish(
    node: Node, point: Point, priority: Priority = 8, options: BusOptions = DEFAULTS, source: Source = None
) -> None:
    """Relinquish an actuator that was set by hand: the next lower priority takes effect, or baseline control.

    Example: `zenostat relinquish office core_zn_cooling_setpoint --priority 8`
    """
    with options.open_bus(Role.OPERATOR) as bus:
        ack = bus.write(node, point, None, priority=priority, source=source or person())
    out.print(f"{node}: {ack.text}")


def seconds(text: str) -> float:
    """Convert a duration such as `90s`, `15min`, `2h` or `1d` to seconds.

    Raises:
        InvalidConfig: another form, or 0.
    """
    return parse_duration(text, "--duration")


def person() -> str:
    """Return `user.host`, as a sender's name."""
    return safe_name(f"{user_name('somebody')}.{socket.gethostname()}")


def user_name(default: str) -> str:
    """Return the name of the user; the default for one without a name, as in containers."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return default
