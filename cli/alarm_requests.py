"""Commands for the alarms of a running node: acknowledge, shelve, remove from service."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import out
from zenostat.cli.options import DEFAULTS, BusOptions, Node, on_bus
from zenostat.cli.write import Source, person, seconds
from zenostat.topics.keys import Role

if TYPE_CHECKING:
    from zenostat import Bus
    from zenostat.topics.messages import Ack

Alarm = Annotated[
    str, typer.Argument(help="Name of an alarm, or of a rule for all its points; `*` stands for any characters.")
]
Comment = Annotated[str, typer.Option(help="For the record.")]
Slot = Annotated[int | None, typer.Option(min=0, help="Slot of a node with several engines. Default: all.")]


@on_bus
def acknowledge(
    node: Node,
    alarm: Alarm,
    comment: Comment = "",
    slot: Slot = None,
    options: BusOptions = DEFAULTS,
    source: Source = None,
) -> None:
    """Acknowledge alarms that are active, or that returned to normal before anybody acknowledged them.

    Example: `zenostat acknowledge office zone_too_warm --comment "fan is being repaired" --source ann`
    """
    _send(
        node, options, lambda bus: bus.acknowledge(node, alarm, slot=slot, source=source or person(), comment=comment)
    )


@on_bus
def shelve(
    node: Node,
    alarm: Alarm,
    duration: Annotated[str, typer.Option(metavar="TIME", help="Simulated time: 90s, 15min, 2h, 1d.")],
    comment: Comment = "",
    slot: Slot = None,
    options: BusOptions = DEFAULTS,
    source: Source = None,
) -> None:
    """Shelve alarms: for a time they alert nobody. A new time replaces the present one.

    Example: `zenostat shelve office zone_too_warm --duration 2h --comment "doors are open" --source ann`
    """
    duration_s = seconds(duration)
    _send(
        node,
        options,
        lambda bus: bus.shelve(node, alarm, duration_s, slot=slot, source=source or person(), comment=comment),
    )


@on_bus
def unshelve(
    node: Node,
    alarm: Alarm,
    comment: Comment = "",
    slot: Slot = None,
    options: BusOptions = DEFAULTS,
    source: Source = None,
) -> None:
    """End the shelving of alarms; those whose value is beyond a limit become active.

    Example: `zenostat unshelve office zone_too_warm --source ann`
    """
    _send(node, options, lambda bus: bus.unshelve(node, alarm, slot=slot, source=source or person(), comment=comment))


@on_bus
def remove_from_service(
    node: Node,
    alarm: Alarm,
    duration: Annotated[
        str | None, typer.Option(metavar="TIME", help="Simulated time until it is returned: 90s, 15min, 2h, 1d.")
    ] = None,
    comment: Comment = "",
    slot: Slot = None,
    options: BusOptions = DEFAULTS,
    source: Source = None,
) -> None:
    """Remove alarms from service: they alert nobody until they are returned, or `--duration` has passed.

    Example: `zenostat remove-from-service office zone_temperature_sensor --comment "sensor is replaced" --source ann`
    """
    duration_s = None if duration is None else seconds(duration)
    _send(
        node,
        options,
        lambda bus: bus.remove_from_service(
            node, alarm, duration_s, slot=slot, source=source or person(), comment=comment
        ),
    )


@on_bus
def return_to_service(
    node: Node,
    alarm: Alarm,
    comment: Comment = "",
    slot: Slot = None,
    options: BusOptions = DEFAULTS,
    source: Source = None,
) -> None:
    """Return alarms to service; those whose value is beyond a limit become active.

    Example: `zenostat return-to-service office zone_temperature_sensor --source ann`
    """
    _send(
        node,
        options,
        lambda bus: bus.return_to_service(node, alarm, slot=slot, source=source or person(), comment=comment),
    )


def _send(node: str, options: BusOptions, request: Callable[[Bus], Ack]) -> None:
    """Send a request and print what it changed, a line for each alarm."""
    with options.open_bus(Role.OPERATOR) as bus:
        ack = request(bus)
    for text in ack.text.splitlines():
        out.print(f"{node}: {text}")
