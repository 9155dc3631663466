"""`zenostat report`: the report of `zenostat evaluate`, from recordings or from the folder of a training."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import err, warnings_printed
from zenostat.cli.options import Emissions, Price
from zenostat.cli.pairs import read_rates
from zenostat.cli.reports import FIGURES_HELP, REPORT_HELP, ReportOutputs, command_line
from zenostat.topics.errors import InvalidConfig

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zenostat.metrics.fuel_rates import Rate
    from zenostat.views.report import Comparison


def report(
    files: Annotated[
        list[Path], typer.Argument(help="Recordings (`.mcap`): a run for each; or one training's folder.")
    ],
    target: Annotated[Path | None, typer.Option("--out", help=REPORT_HELP)] = None,
    figures: Annotated[Path | None, typer.Option(help=FIGURES_HELP)] = None,
    prices: Price = None,
    emissions: Emissions = None,
) -> None:
    """Compare recordings: energy, comfort, reward and figures, as `zenostat evaluate --report` does.

    Each recording is a run with the name of its node, baseline control first. All have the same run period.

    From the folder of a training, simulate its evaluation episodes with baseline control and with the best model.

    Example: `zenostat report runs/*.mcap --out report.html`
    """
    outputs = ReportOutputs(target, figures, "--out")
    if not outputs.wanted:
        raise InvalidConfig("expected --out FILE.html, --figures FOLDER, or both")
    rates = read_rates("--price", prices), read_rates("--emissions", emissions)
    if any(path.is_dir() for path in files):
        if len(files) > 1:
            raise InvalidConfig(f"{', '.join(map(str, files))}: expected recordings, or one folder of a training")
        comparison = _evaluate_training(files[0], *rates)
    else:
        comparison = _compare_recordings(files, *rates)
    outputs.write(comparison)
    outputs.show()


def _compare_recordings(files: list[Path], prices: Mapping[str, Rate], emissions: Mapping[str, Rate]) -> Comparison:
    from zenostat.views.report import compare_recordings

    with warnings_printed():
        return compare_recordings(files, prices=prices, emissions=emissions, command=command_line())


def _evaluate_training(folder: Path, prices: Mapping[str, Rate], emissions: Mapping[str, Rate]) -> Comparison:
    """Simulate the evaluation episodes of a training with baseline control and with its best model."""
    from zenostat.agent_sdk.controllers.training_folder import model_file
    from zenostat.lab.evaluate import evaluate
    from zenostat.lab.training.config import Evaluation
    from zenostat.lab.training.folder import read_folder

    config = read_folder(folder)
    model_file(folder)
    settings = config.evaluation or Evaluation()
    evaluation = evaluate(
        config.environment(for_evaluation=True), ["baseline", str(folder)], episodes=settings.episodes,
        seed=settings.seed, prices=prices, emissions=emissions, trace=True,
    )  # fmt: skip
    for name, reason in evaluation.unfit.items():
        err.print(f"{name} is skipped: {reason}")
    for name, error in evaluation.failures.items():
        raise InvalidConfig(f"{name} failed: {error}")
    return evaluation.comparison(command_line())
