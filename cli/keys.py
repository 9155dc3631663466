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
    help="Create and list certificates for a secured bus, each with a role. See docs/security.md.",
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
    """Create a certificate authority, and certificates for a node, a controller and a monitor.

    Example: `zenostat keys init --host lab.example.org --host 192.168.1.20`
    """
    from zenostat.bridge.transport.certificates import AUTHORITY, make

    out.print(_table(make(folder, hosts=host or (), days=days, force=force)))
    out.print(
        f"Written to {folder}. Each program needs {AUTHORITY}.pem and its own .pem and .key. "
        f"Keep {AUTHORITY}.key private: it can sign new certificates.",
        markup=False,
    )


@app.command()
def add(
    role: Annotated[str, typer.Argument(help="node, controller or monitor.")],
    name: Annotated[str, typer.Argument(help="Name of the program or person, also used for the files.")],
    folder: Annotated[Path, typer.Option(help="Folder of the certificate authority.")] = FOLDER,
    host: Hosts = None,
    days: Days = 365,
    force: Force = False,
) -> None:
    """Create another certificate of the same authority, for example for a second controller or a router.

    Example: `zenostat keys add controller annex`
    """
    from zenostat.bridge.transport.access_control import ROLES
    from zenostat.bridge.transport.certificates import add

    if role not in tuple(ROLES):
        raise UnknownName(f"no role {role!r}; {did_you_mean(role, ROLES)}")
    out.print(_table([add(folder, Role(role), name, hosts=host or (), days=days, force=force)]))


@app.command()
def show(folder: Annotated[Path, typer.Argument(help="Folder of the certificates.")] = FOLDER) -> None:
    """List certificates with role, name, expiry, hosts and state.

    Example: `zenostat keys show`
    """
    from zenostat.bridge.transport.certificates import show

    out.print(_table(show(folder)))


def _table(certificates: list[Certificate]) -> Table:
    table = Table("role", "name", "expires (UTC)", "hosts", "state")
    for certificate in certificates:
        expires = f"{certificate.expires:%Y-%m-%d %H:%M}"
        table.add_row(
            certificate.role or "authority",
            certificate.name,
            expires,
            ", ".join(certificate.hosts),
            certificate.fault or "good",
        )
    return table
