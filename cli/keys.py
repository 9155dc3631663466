"""`zenostat keys`: certificates for a bus that is closed to strangers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from cli.console import out
from topics.errors import UnknownName, did_you_mean
from topics.keys import Role

if TYPE_CHECKING:
    from bridge.transport.certificates import Certificate

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="Keys: who may speak on a bus, and as what. See docs/security.md.",
)

FOLDER = Path("zenostat-keys")

Hosts = Annotated[
    list[str] | None,
    typer.Option("--host", help="Name or address of a node's machine, besides those of the loopback; repeated."),
]
Days = Annotated[int, typer.Option(help="Days of validity, 1 to 3650.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite.")]


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(help="Where the files go.")] = FOLDER,
    host: Hosts = None,
    days: Days = 365,
    force: Force = False,
) -> None:
    """Makes an authority, and a certificate for a node, a controller and a monitor.

    Example: `zenostat keys init --host lab.example.org --host 192.168.1.20`
    """
    from bridge.transport.certificates import AUTHORITY, make

    made = make(folder, hosts=host or (), days=days, force=force)
    out.print(_table(made))
    out.print(
        f"In {folder}. A program needs {AUTHORITY}.pem, and its own .pem and .key; {AUTHORITY}.key stays here: "
        "whoever has it can make certificates.",
        markup=False,
    )


@app.command()
def add(
    role: Annotated[str, typer.Argument(help="node, controller or monitor.")],
    name: Annotated[str, typer.Argument(help="Of the program or person; the files are named so.")],
    folder: Annotated[Path, typer.Option(help="Where the authority is.")] = FOLDER,
    host: Hosts = None,
    days: Days = 365,
    force: Force = False,
) -> None:
    """Makes another certificate of the same authority: a second controller, a router.

    Example: `zenostat keys add controller annex`
    """
    from bridge.transport.access_control import ROLES
    from bridge.transport.certificates import add

    if role not in tuple(ROLES):
        raise UnknownName(f"no role {role!r}; {did_you_mean(role, ROLES)}")
    out.print(_table([add(folder, Role(role), name, hosts=host or (), days=days, force=force)]))


@app.command()
def show(folder: Annotated[Path, typer.Argument(help="Where the files are.")] = FOLDER) -> None:
    """Lists certificates: role, name, expiry.

    Example: `zenostat keys show`
    """
    from bridge.transport.certificates import show

    out.print(_table(show(folder)))


def _table(certificates: list[Certificate]) -> Table:
    table = Table("role", "name", "expires (UTC)", "hosts", "state")
    for one in certificates:
        expires = f"{one.expires:%Y-%m-%d %H:%M}"
        table.add_row(one.role or "authority", one.name, expires, ", ".join(one.hosts), one.fault or "good")
    return table
