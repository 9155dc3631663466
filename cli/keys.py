"""`zenostat keys`: certificates for a secured bus."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import out
from zenostat.cli.options import DEFAULTS, BusOptions, on_bus
from zenostat.cli.tables import show as show_table
from zenostat.cli.write import person
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.keys import Role

if TYPE_CHECKING:
    from zenostat.bridge.transport.identity import Certificate

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="Create and list certificates for a secured bus, each with a name and roles. See docs/security.md.",
)

FOLDER = Path("zenostat-keys")

Hosts = Annotated[
    list[str] | None,
    typer.Option("--host", help="Host name or address of the node's machine, besides loopback; repeatable."),
]
Days = Annotated[int, typer.Option(help="Validity in days, 1 to 3650.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(help="Output folder.")] = FOLDER,
    host: Hosts = None,
    days: Days = 365,
    force: Force = False,
) -> None:
    """Create a certificate authority, and a certificate for each role, with the role as its name.

    Example: `zenostat keys init --host lab.example.org --host 192.168.1.20`
    """
    from zenostat.bridge.transport.certificates import make
    from zenostat.bridge.transport.identity import AUTHORITY

    _show(make(folder, hosts=host or (), days=days, force=force))
    out.print(
        f"Written to {folder}. Each program needs {AUTHORITY}.pem and its own .pem and .key; nodes and routers also "
        "names.json, the list of names and roles. "
        f"Keep {AUTHORITY}.key private: it can sign new certificates."
    )


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="Name of the program or person, also of its files.")],
    role: Annotated[
        list[str], typer.Option("--role", help="controller, operator, monitor, gateway or node; repeatable.")
    ],
    folder: Annotated[Path, typer.Option(help="Folder of the certificate authority.")] = FOLDER,
    host: Hosts = None,
    days: Days = 365,
    force: Force = False,
) -> None:
    """Create another certificate of the same authority, for example for a second controller or a router.

    The program sends under this name, or a name below it (`NAME.part`). Nodes and routers accept it once they have the
    new `names.json` and are started again.

    Example: `zenostat keys add ppo-7 --role controller --role operator`
    """
    from zenostat.bridge.transport.certificates import add
    from zenostat.bridge.transport.deny_list import REVOKED, read_revoked
    from zenostat.bridge.transport.name_list import CERTIFIED, NAMES

    for text in role:
        if text not in tuple(CERTIFIED):
            raise UnknownName(f"no role {text!r}; {did_you_mean(text, CERTIFIED)}")
    roles = [Role(text) for text in role]
    revoked = read_revoked(folder)
    _show([add(folder, roles, name, hosts=host or (), days=days, force=force)], revoked)
    out.print(f"Copy {folder / NAMES} to all nodes and routers, and start them again.")
    if name in revoked:
        out.warning(
            f"{name} is revoked: to accept it again, remove its line from {folder / REVOKED} and from those of all "
            "nodes and routers; that accepts its earlier certificates as well, so choose another name after a theft"
        )


@app.command()
@on_bus
def revoke(
    name: Annotated[str, typer.Argument(help="Name of the certificate.")],
    folder: Annotated[
        Path, typer.Option(help="Folder of keys of a node or router on this machine, which follows within a second.")
    ] = FOLDER,
    node: Annotated[str | None, typer.Option(help="Ask this running node instead, as an operator.")] = None,
    options: BusOptions = DEFAULTS,
) -> None:
    """Revoke a name: its claims end, nothing of it is accepted any more, and its links are ended.

    To accept the name again, remove it from `revoked.txt` and start the node or router again.

    Example: `zenostat keys revoke ppo-7`
    """
    if node is not None:
        with options.open_bus(Role.OPERATOR) as bus:
            out.print(f"{node}: {bus.revoke(node, name, source=person()).text}")
        return
    if options != DEFAULTS:
        raise InvalidConfig("--connect, --keys and --certificate are for --node; --folder names the folder of keys")
    from zenostat.bridge.transport.deny_list import REVOKED
    from zenostat.bridge.transport.deny_list import revoke as write_revoked
    from zenostat.bridge.transport.identity import names_of

    known = names_of(folder)
    if name not in known:
        raise UnknownName(f"no name {name!r} in {folder}; {did_you_mean(name, known)}")
    write_revoked(folder, name)
    if Role.NODE in known[name]:
        out.print(f"What connects through the node or router {name} has no bus any more.")
    text = f"{name} is revoked in {folder / REVOKED}; copy the file to the folders of all other nodes and routers."
    out.print(text)


@app.command()
def show(folder: Annotated[Path, typer.Argument(help="Folder of the certificates.")] = FOLDER) -> None:
    """List certificates with roles, name, expiry, hosts and state.

    Example: `zenostat keys show`
    """
    from zenostat.bridge.transport.deny_list import read_revoked
    from zenostat.bridge.transport.identity import show

    _show(show(folder), read_revoked(folder))


def _show(certificates: Iterable[Certificate], revoked: Collection[str] = ()) -> None:
    rows = [
        (
            ", ".join(certificate.roles) or "authority",
            certificate.name,
            f"{certificate.expires:%Y-%m-%d %H:%M}",
            ", ".join(certificate.hosts),
            "revoked" if certificate.name in revoked else certificate.fault or certificate.warning or "good",
        )
        for certificate in certificates
    ]
    show_table("", ("role", "name", "expires (UTC)", "hosts", "state"), rows, wrap=("role", "name", "hosts", "state"))
