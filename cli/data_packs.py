"""`zenostat data-packs`: installable sets of buildings, weather files and scenarios."""

from __future__ import annotations

from typing import Annotated

import typer

from zenostat.cli.console import err, out
from zenostat.cli.tables import show
from zenostat.models import data_packs
from zenostat.topics.plurals import counted

app = typer.Typer(add_completion=False, rich_markup_mode="markdown")


@app.callback(invoke_without_command=True)
def data_packs_command(context: typer.Context) -> None:
    """List, add and remove data packs: third-party buildings, weather files and scenarios. No code from a pack runs.

    Example: `zenostat data-packs add sinergym`
    """
    if context.invoked_subcommand is None:
        list_packs()


@app.command("list")
def list_packs() -> None:
    """List the data packs with their contents and, if installed, their folder.

    Example: `zenostat data-packs list`
    """
    rows = []
    for pack in data_packs.PACKS.values():
        folder = str(data_packs.folder(pack.name)) if data_packs.is_installed(pack.name) else "not installed"
        rows.append((pack.name, pack.version, pack.licence, folder, _contents(pack)))
    show("", ("name", "version", "license", "folder", "contents"), rows, wrap=("folder", "contents"))


@app.command()
def add(name: Annotated[str, typer.Argument(help="Name of the pack.", metavar="NAME")]) -> None:
    """Download a data pack with pip, verify its hash and unpack it.

    Example: `zenostat data-packs add sinergym`
    """
    pack = data_packs.find_pack(name)
    if data_packs.is_installed(name):
        out.print(f"{name} {pack.version} is already installed in {data_packs.folder(name)}")
        return
    with err.status(f"adding {name}") as status:
        folder = data_packs.add(name, report=status.update)
    out.print(f"{name} {pack.version} installed in {folder}: {_contents(pack)}")


@app.command()
def remove(name: Annotated[str, typer.Argument(help="Name of the pack.", metavar="NAME")]) -> None:
    """Remove a data pack.

    Example: `zenostat data-packs remove sinergym`
    """
    out.print(f"{name} removed" if data_packs.remove(name) else f"{name} was not installed")


def _contents(pack: data_packs.Pack) -> str:
    counts = {"building": len(pack.buildings), "weather file": len(pack.weathers), "scenario": pack.scenarios}
    return ", ".join(counted(count, noun) for noun, count in counts.items())
