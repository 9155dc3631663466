"""`zenostat data-packs`: buildings, weather and scenarios that can be added."""

from __future__ import annotations

from typing import Annotated

import typer

from cli.console import err, out
from cli.tables import show
from models import data_packs as store

app = typer.Typer(add_completion=False, rich_markup_mode="markdown")

_EXAMPLE = "Example: `zenostat data-packs add sinergym`"


@app.callback(invoke_without_command=True, epilog=_EXAMPLE)
def packs(context: typer.Context) -> None:
    """Lists, adds and removes data packs: buildings, weather and scenarios of others. No code of theirs is run.

    Example: `zenostat data-packs add sinergym`
    """
    if context.invoked_subcommand is None:
        list_packs()


@app.command("list")
def list_packs() -> None:
    """Lists the data packs, where they are and what is in them.

    Example: `zenostat data-packs list`
    """
    rows = []
    for pack in store.PACKS.values():
        where = str(store.folder(pack.name)) if store.is_installed(pack.name) else "not added"
        rows.append((pack.name, pack.version, pack.licence, where, _what(pack)))
    show("", ("name", "version", "licence", "where", "what"), rows, wrap=("where", "what"))


@app.command()
def add(name: Annotated[str, typer.Argument(help="The pack's name.", metavar="NAME")]) -> None:
    """Fetches a data pack with pip, checks its hash and unzips it. Once is enough.

    Example: `zenostat data-packs add sinergym`
    """
    pack = store.find_pack(name)
    if store.is_installed(name):
        out.print(f"{name} {pack.version} is there already: {store.folder(name)}", markup=False, soft_wrap=True)
        return
    with err.status(f"adding {name}") as status:
        folder = store.add(name, report=status.update)
    out.print(f"{name} {pack.version} added: {_what(pack)}; in {folder}", markup=False, soft_wrap=True)


@app.command()
def remove(name: Annotated[str, typer.Argument(help="The pack's name.", metavar="NAME")]) -> None:
    """Removes a data pack.

    Example: `zenostat data-packs remove sinergym`
    """
    out.print(f"{name} removed" if store.remove(name) else f"{name} was not added")


def _what(pack: store.Pack) -> str:
    return f"{len(pack.buildings)} buildings, {len(pack.weathers)} weathers, {pack.scenarios} scenarios"
