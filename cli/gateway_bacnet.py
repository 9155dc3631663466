"""`zenostat gateway bacnet`: a node as a BACnet/IP device."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import typer

from zenostat.cli.console import err, out
from zenostat.cli.gateway import manifest_of, serve
from zenostat.cli.gateway_clients import Allow, ClientsFile, clients_of, notify
from zenostat.cli.options import DEFAULTS, BusOptions, Expose, Node, Wait, on_bus
from zenostat.gateways.addresses import parse_address
from zenostat.topics.device_addresses import MAX_INSTANCE
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra
from zenostat.topics.plurals import counted

_MAX_SOURCE = 100  # a source has at most 128 characters, with the client's address


@on_bus
def bacnet(
    node: Node,
    options: BusOptions = DEFAULTS,
    wait: Wait = False,
    address: Annotated[
        str, typer.Option(help="IPv4 address of the network interface, with UDP port.")
    ] = "127.0.0.1:47808",
    instance: Annotated[
        int | None,
        typer.Option(min=0, max=MAX_INSTANCE, help="Device instance number. Default: one of the node's name."),
    ] = None,
    source: Annotated[str, typer.Option(help="Source of writes on the bus, before the client's address.")] = "bacnet",
    objects: Annotated[
        Path | None, typer.Option(help="Write the objects, with their instance numbers, to FILE.csv, and end.")
    ] = None,
    clients: ClientsFile = None,
    allow: Allow = None,
    expose: Expose = False,
) -> None:
    """Run a BACnet/IP device for a node until Ctrl-C. With keys, it uses the gateway role.

    Example: `zenostat gateway bacnet office --address 127.0.0.1:47808`
    """
    with requires_extra("bacnet", "the BACnet gateway", "bacpypes3"):
        from zenostat.gateways.bacnet import BacnetGateway
        from zenostat.gateways.bacnet.network import DEFAULT_PORT, find_interface
        from zenostat.topics.device_addresses import instance_number

    if len(source) > _MAX_SOURCE:
        raise InvalidConfig(f"--source has {len(source)} characters; the most are {_MAX_SOURCE}")
    number = instance_number(node) if instance is None else instance
    if objects is not None:
        _write_objects(node, number, objects, options, wait=wait)
        return
    interface = find_interface(*parse_address(address, "BACnet/IP", expose=expose, default_port=DEFAULT_PORT))
    known = clients_of(clients, allow, is_exposed=not interface.address.ip.is_loopback)
    if not known.is_read_only:
        err.print(f"BACnet/IP has no authentication: whoever reaches {interface.address.ip} can command {node}")
    serve(
        node,
        lambda client: BacnetGateway(client, interface, instance=number, clients=known, notify=notify),
        source=source,
        via="bacnet",
        options=options,
        wait=wait,
        exclusive={f"BACnet device {number}": "choose another number with --instance"},
    )


def _write_objects(node: str, number: int, file: Path, options: BusOptions, *, wait: bool) -> None:
    """Write all objects of a node's device, whose number is `number`: type, instance, name, units, bounds, description.

    Raises:
        InvalidConfig: the file cannot be written.
    """
    from zenostat.gateways.bacnet.fixed_objects import fixed_objects
    from zenostat.gateways.bacnet.points import point_specs
    from zenostat.gateways.bacnet.units import bacnet_unit

    manifest = manifest_of(node, options, wait=wait)
    fixed, points = fixed_objects(manifest, number), point_specs(manifest)
    try:
        with file.open("w", encoding="utf-8", newline="") as opened:
            table = csv.writer(opened)
            table.writerow(("type", "instance", "name", "unit", "bacnet_unit", "low", "high", "description"))
            for each in fixed:
                table.writerow((*each[:3], "", "", each.low, each.high, each.description))
            for spec in points:
                unit = bacnet_unit(spec.unit).name
                names = (spec.kind.value, spec.instance, spec.object_name, spec.unit, unit)
                table.writerow((*names, spec.low, spec.high, spec.description))
    except OSError as error:
        raise InvalidConfig(f"--objects {file}: {error.strerror}") from None
    out.print(f"objects of {node}: {file} ({counted(len(fixed) + len(points), 'object')})")
