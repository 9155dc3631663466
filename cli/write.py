"""`zenostat write` and `zenostat relinquish`: one actuator of a running node, by hand."""

from __future__ import annotations

import getpass
import re
import socket
from typing import Annotated

import typer

from bridge.transport.session import default_endpoint
from cli.console import out
from cli.options import CertificateName, Connect, Keys
from topics.errors import InvalidConfig

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_FORM = re.compile(rf"(\d+(?:\.\d+)?)({'|'.join(_SECONDS)})")

Node = Annotated[str, typer.Argument(help="The node's name.")]
Point = Annotated[str, typer.Argument(help="An actuator's name; `zenostat read NODE` lists them.")]
Priority = Annotated[int, typer.Option(min=1, max=16, help="1 is the highest; 8 is a person's.")]
Source = Annotated[str | None, typer.Option(help="Who writes; you at this machine if left out. It is made unique.")]


def write(
    node: Node,
    point: Point,
    value: Annotated[float, typer.Argument(help="In the actuator's unit and within its bounds.")],
    priority: Priority = 8,
    for_: Annotated[
        str | None, typer.Option("--for", metavar="TIME", help="Simulated time that it holds: 90s, 15min, 2h, 1d.")
    ] = None,
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
    source: Source = None,
) -> None:
    """Sets an actuator by hand; it rules from the next timestep on, until it is released or `--for` is over.

    Example: `zenostat write office core_zn_cooling_setpoint 26 --priority 8 --for 2h`
    """
    from agent_sdk import connect as connect_bus

    duration_s = None if for_ is None else seconds(for_)
    with connect_bus(connect or default_endpoint(keys), keys=keys, certificate=certificate) as bus:
        event = bus.write(node, point, value, priority=priority, duration_s=duration_s, source=source or person())
    out.print(f"{node}: {event.text}" + (f" for {for_}" if for_ else ""), markup=False, soft_wrap=True)


def relinquish(
    node: Node,
    point: Point,
    priority: Priority = 8,
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
    source: Source = None,
) -> None:
    """Releases an actuator that was set by hand: the next lower level rules, or the building's own control.

    Example: `zenostat relinquish office core_zn_cooling_setpoint --priority 8`
    """
    from agent_sdk import connect as connect_bus

    with connect_bus(connect or default_endpoint(keys), keys=keys, certificate=certificate) as bus:
        event = bus.write(node, point, None, priority=priority, source=source or person())
    out.print(f"{node}: {event.text}", markup=False, soft_wrap=True)


def seconds(text: str) -> float:
    """Seconds of `90s`, `15min`, `2h` or `1d`.

    Raises:
        InvalidConfig: another form, or no time at all.
    """
    found = _FORM.fullmatch(text.strip())
    if not found or float(found[1]) == 0:
        raise InvalidConfig(f"--for {text}: a number above 0 and s, min, h or d expected, as 90s, 15min, 2h, 1d")
    return float(found[1]) * _SECONDS[found[2]]


def person() -> str:
    """`user@host`."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container may have no name for its user
        user = "somebody"
    return f"{user}@{socket.gethostname()}"
