"""Options of gateways: who their clients are, and what each may write."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import err

if TYPE_CHECKING:
    from zenostat.gateways.clients import Clients

ClientsFile = Annotated[
    Path | None, typer.Option("--clients", metavar="FILE.yaml", help="File with the names of the clients.")
]
Allow = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=PATTERN",
        help="Actuators that a client may write, with * and ?; the name * is all clients; repeatable. Default: all, "
        "but none where other machines reach the gateway or --clients is given.",
    ),
]

Priority = Annotated[
    int, typer.Option(min=1, max=16, metavar="1-16", help="Priority of all commands; 1 is the highest.")
]


def clients_of(
    file: Path | None, allow: Sequence[str] | None, *, is_exposed: bool, name_themselves: bool = False
) -> Clients:
    """Return the clients of a gateway, as `read_clients`; print a line if none of them may write."""
    from zenostat.gateways.clients import read_clients

    clients = read_clients(file, allow or (), is_exposed=is_exposed, name_themselves=name_themselves)
    if clients.is_read_only:
        err.print(
            "read-only: no client may write; name clients in a file (--clients) and what each may write, or permit "
            "everything to all of them with --allow '*=*'"
        )
    return clients


def notify(text: str) -> None:
    """Print a line for the operator."""
    err.print(text)
