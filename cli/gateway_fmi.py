"""`zenostat gateway fmi`: a node for tools that import FMUs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from zenostat.cli.console import out, until_signal
from zenostat.cli.gateway import manifest_of
from zenostat.cli.gateway_clients import Allow, ClientsFile, Priority, clients_of, notify
from zenostat.cli.options import DEFAULTS, BusOptions, Expose, Node, Wait, on_bus
from zenostat.topics.atomic_file import check_writable
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import Role
from zenostat.topics.plurals import counted

DEFAULT_PORT = 4880


@on_bus
def fmi(
    node: Node,
    address: Annotated[
        str, typer.Option(help="ADDRESS:PORT to listen on; port 0 is any free one.")
    ] = f"127.0.0.1:{DEFAULT_PORT}",
    priority: Priority = 10,
    fmu: Annotated[
        Path | None,
        typer.Option(
            "--fmu",
            metavar="FILE.fmu",
            help="Write the FMU of the node, which connects to `--address` unless its parameter says otherwise, "
            "and end.",
        ),
    ] = None,
    clients: ClientsFile = None,
    allow: Allow = None,
    options: BusOptions = DEFAULTS,
    wait: Wait = False,
    expose: Expose = False,
) -> None:
    """Write the FMU of a node, or run the gateway to which such FMUs connect, until Ctrl-C.

    With keys, it uses the gateway role.

    Example: `zenostat gateway fmi office --fmu office.fmu`

    Example: `zenostat gateway fmi office`
    """
    from zenostat.gateways.addresses import parse_address
    from zenostat.gateways.fmi.gateway import FmiGateway
    from zenostat.topics.addresses import is_loopback

    if fmu is not None:
        _write(node, fmu, address, options, wait=wait)
        return
    host, port = parse_address(address, "an FMU's connection", expose=expose, default_port=DEFAULT_PORT)
    known = clients_of(clients, allow, is_exposed=not is_loopback(host))
    manifest_of(node, options, wait=wait)  # an error of the name now, not when an FMU connects
    with (
        options.open_bus(Role.GATEWAY) as bus,
        FmiGateway(bus, node, host, port, priority=priority, clients=known, notify=notify) as gateway,
        until_signal() as stopped,
    ):
        bus.via = "fmi"
        out.print(f"ready: {gateway.description}; press Ctrl-C to stop")
        stopped.wait()
    counts = gateway.counts
    out.print(
        f"{counted(counts.connections, 'run')} of FMUs, {counted(counts.timesteps, 'timestep', ',')}, "
        f"{counted(counts.failures, 'failed request')}"
    )


def _write(node: str, file: Path, address: str, options: BusOptions, *, wait: bool) -> None:
    from zenostat.gateways.fmi.archive import write_fmu
    from zenostat.gateways.fmi.description import Interface
    from zenostat.topics.addresses import join_address, split_address

    if file.suffix != ".fmu":
        raise InvalidConfig(f"--fmu {file}: expected a .fmu file")
    check_writable(file, f"--fmu {file}")
    target = split_address(address, DEFAULT_PORT)
    if target is None:
        raise InvalidConfig(f"--address {address}: expected HOST:PORT, for example 127.0.0.1:{DEFAULT_PORT}")
    interface = Interface(manifest_of(node, options, wait=wait))
    platforms = write_fmu(interface, file, join_address(*target))
    sizes = f"{counted(len(interface.outputs), 'output')}, {counted(len(interface.actuators), 'actuator')}"
    out.print(f"{file}: {sizes}; binaries for {', '.join(platforms)}")
