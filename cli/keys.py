"""`zenostat keys`: certificates for a secured bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from zenostat.cli.console import out
from zenostat.topics.errors import UnknownName, did_you_mean
from zenostat.topics.keys import Role

if TYPE_CHECKING:
    from zenostat.bridge.transport.certificates import Certificate

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
    from zenostat.bridge.transport.certificates import AUTHORITY, make

    out.print(_table(make(folder, hosts=host or (), days=days, force=force)))
    out.print(
        f"Written to {folder}. Each program needs {AUTHORITY}.pem and its own .pem and .key; nodes and routers also "
        "names.json, the list of names and roles. "
        f"Keep {AUTHORITY}.key private: it can sign new certificates.",
        markup=False,
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

    Example: `zenostat keys add trainer --role controller --role operator`
    """
    from zenostat.bridge.transport.certificates import add
    from zenostat.bridge.transport.name_list import CERTIFIED, NAMES

    for text in role:
        if text not in tuple(CERTIFIED):
            raise UnknownName(f"no role {text!r}; {did_you_mean(text, CERTIFIED)}")
    roles = [Role(text) for text in role]
    out.print(_table([add(folder, roles, name, hosts=host or (), days=days, force=force)]))
    out.print(f"Copy {folder / NAMES} to all nodes and routers, and start them again.", markup=False, soft_wrap=True)


@app.command()
def show(folder: Annotated[Path, typer.Argument(help="Folder of the certificates.")] = FOLDER) -> None:
    """List certificates with roles, name, expiry, hosts and state.

    Example: `zenostat keys show`
    """
    from zenostat.bridge.transport.certificates import show

    out.print(_table(show(folder)))


def _table(certificates: list[Certificate]) -> Table:
    table = Table("role", "name", "expires (UTC)", "hosts", "state")
    for certificate in certificates:
        expires = f"{certificate.expires:%Y-%m-%d %H:%M}"
        table.add_row(
            ", ".join(certificate.roles) or "authority",
            certificate.name,
            expires,
            ", ".join(certificate.hosts),
            certificate.fault or "good",
        )
    return table
