"""`zenostat report`: the report of `zenostat evaluate`, from recordings."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import typer

from cli.console import err
from cli.options import Emissions, Price, read_rates
from cli.reports import FIGURES_HELP, REPORT_HELP, ReportOutputs, command_line
from topics.errors import InvalidConfig


def report(
    files: Annotated[list[Path], typer.Argument(help="Recordings (`.mcap`): a run for each.")],
    target: Annotated[Path | None, typer.Option("--out", help=REPORT_HELP)] = None,
    figures: Annotated[Path | None, typer.Option(help=FIGURES_HELP)] = None,
    prices: Price = None,
    emissions: Emissions = None,
) -> None:
    """Compare recordings: energy, comfort, reward and figures, as `zenostat evaluate --report` does.

    Each recording is a run with the name of its node, baseline control first. All have the same run period.

    Example: `zenostat report runs/*.mcap --out report.html`
    """
    outputs = ReportOutputs(target, figures)
    if not outputs.wanted:
        raise InvalidConfig("expected --out FILE.html, --figures FOLDER, or both")
    from agent_sdk.report import compare_recordings

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        comparison = compare_recordings(
            files,
            prices=read_rates("--price", prices),
            emissions=read_rates("--emissions", emissions),
            command=command_line(),
        )
    for warning in caught:
        err.print(str(warning.message), markup=False, soft_wrap=True)
    outputs.write(comparison)
    outputs.show()
