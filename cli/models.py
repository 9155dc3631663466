"""`zenostat models`: upgrade model files of earlier EnergyPlus versions."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import out
from zenostat.cli.tables import show, show_json
from zenostat.topics.errors import InvalidConfig

if TYPE_CHECKING:
    from zenostat.models.upgrade.upgrade import UpgradedModel

app = typer.Typer(
    add_completion=False, rich_markup_mode="markdown", help="Upgrade models of earlier EnergyPlus versions."
)


@app.callback()
def models() -> None:
    """Upgrade models of earlier EnergyPlus versions.

    Example: `zenostat models upgrade old.idf`
    """


@app.command()
def upgrade(
    file: Annotated[Path, typer.Argument(help="IDF or epJSON file.", metavar="FILE")],
    output: Annotated[
        Path | None, typer.Option(help="File to write: an epJSON or an IDF, by its suffix.", metavar="FILE")
    ] = None,
    transition_programs: Annotated[
        Path | None, typer.Option(help="Folder of EnergyPlus's own transition programs, to use in place of the rules.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print each change as JSON.")] = False,
) -> None:
    """Upgrade a model of EnergyPlus 9.0 to 25.1 to the engine's version and list what was changed.

    Example: `zenostat models upgrade old.idf --output new.epJSON`
    """
    from zenostat.models.upgrade.files import upgrade_file, write_model

    if output is not None and output.suffix.lower() not in (".idf", ".epjson"):
        raise InvalidConfig(f"--output {output} should end with .epJSON or .idf")
    if output is not None and output.exists():
        raise InvalidConfig(f"--output {output} exists already; choose another name, or remove it first")
    upgraded = upgrade_file(file, transition_programs)
    if output is not None:
        write_model(upgraded.objects, output)
    if as_json:
        changes = [asdict(change) for change in upgraded.changes]
        show_json({"before": upgraded.before, "after": upgraded.after, "changes": changes})
        return
    _show(upgraded, output)


def _show(upgraded: UpgradedModel, output: Path | None) -> None:
    groups = Counter((f"{c.before} → {c.after}", c.kind, c.text) for c in upgraded.changes)
    if groups:
        rows = [(step, kind, str(count), text) for (step, kind, text), count in groups.items()]
        show("", ("step", "type", "objects", "change"), rows, right=("objects",), wrap=("type", "change"))
    out.print(upgraded.summary.partition(" (`")[0] or f"the model is for EnergyPlus {upgraded.after} already")
    if output is not None:
        out.print(f"written to {output}")
