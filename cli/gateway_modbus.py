"""`zenostat gateway modbus`: a node as a Modbus TCP server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from zenostat.cli.console import out
from zenostat.cli.gateway import manifest_of, serve
from zenostat.cli.gateway_clients import Allow, ClientsFile, Priority, clients_of, notify
from zenostat.cli.options import DEFAULTS, BusOptions, Expose, Node, Wait, on_bus
from zenostat.topics.atomic_file import atomic_file, check_writable
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.plurals import counted

DEFAULT_PORT = 1502


@on_bus
def modbus(
    node: Node,
    address: Annotated[
        str, typer.Option(help="ADDRESS:PORT to listen on; port 0 is any free one.")
    ] = f"127.0.0.1:{DEFAULT_PORT}",
    priority: Priority = 8,
    word_order: Annotated[
        str, typer.Option(metavar="big|little", help="First word of a 32-bit value: the high one (big) or the low one.")
    ] = "big",
    source: Annotated[str, typer.Option(help="Name of the gateway among the sources of values.")] = "modbus",
    map_file: Annotated[
        Path | None, typer.Option("--map", help="Write the map of registers to FILE.csv or FILE.md, and end.")
    ] = None,
    clients: ClientsFile = None,
    allow: Allow = None,
    options: BusOptions = DEFAULTS,
    wait: Wait = False,
    expose: Expose = False,
) -> None:
    """Run a Modbus TCP gateway of a node until Ctrl-C. With keys, it uses the gateway role.

    Example: `zenostat gateway modbus office --address 127.0.0.1:1502`
    """
    from zenostat.gateways.addresses import parse_address
    from zenostat.gateways.modbus.gateway import ModbusGateway
    from zenostat.topics.addresses import is_loopback

    if word_order not in ("big", "little"):
        raise InvalidConfig(f"--word-order {word_order}: expected big or little")
    if map_file is not None:
        _write_map(node, map_file, options, wait=wait)
        return
    host, port = parse_address(address, "Modbus TCP", expose=expose, default_port=DEFAULT_PORT)
    known = clients_of(clients, allow, is_exposed=not is_loopback(host))
    serve(
        node,
        lambda client: ModbusGateway(
            client, host, port, priority=priority, is_little_endian=word_order == "little", clients=known, notify=notify
        ),
        source=source,
        via="modbus",
        options=options,
        wait=wait,
    )


def _write_map(node: str, file: Path, options: BusOptions, *, wait: bool) -> None:
    """Write the register map of a node as CSV or Markdown.

    Raises:
        InvalidConfig: another suffix, or the file cannot be written.
    """
    from zenostat.gateways.modbus.register_map import RegisterMap

    if file.suffix not in (".csv", ".md"):
        raise InvalidConfig(f"--map {file}: expected a file with the suffix .csv or .md")
    check_writable(file, f"--map {file}")
    registers = RegisterMap(manifest_of(node, options, wait=wait))
    with atomic_file(file) as temporary:
        temporary.write_text(registers.csv() if file.suffix == ".csv" else registers.markdown(), encoding="utf-8")
    out.print(f"map of {node}: {file} ({counted(len(registers.entries), 'entry')})")
