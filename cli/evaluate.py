"""`zenostat evaluate`: compare controllers in one scenario and the same weather."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import err, out, progress
from zenostat.cli.name_lists import end_with_failures
from zenostat.cli.node_options import Begin, End
from zenostat.cli.options import Emissions, Price
from zenostat.cli.pairs import read_parameters, read_rates
from zenostat.cli.reports import FIGURES_HELP, REPORT_HELP, ReportOutputs, command_line
from zenostat.cli.tables import show, show_json
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    from zenostat.lab.evaluate import Evaluation, Progress
    from zenostat.metrics.statistics import MetricSummary

_UNITS = {"kwh": "kWh", "w": "W", "kw": "kW", "k": "K", "kh": "K h", "kwh_m2": "kWh/m²", "h": "h", "percent": "%"}
_TEXT_COLUMNS = ("controller", "weather")
_COUNT_COLUMNS = ("episode", "seed", "steps", "late", "rejected")
INTERVAL_NOTE = "± half the 95 % confidence interval of the mean over the episodes (Student's t)"
_PROGRESS_INTERVAL = 24
"""Timesteps between two updates of a progress bar."""


def evaluate(
    scenario: Annotated[str, typer.Argument(help="Scenario id (see `zenostat scenarios`) or scenario file.")],
    controllers: Annotated[
        list[str],
        typer.Option(
            "--controller",
            help="A controller as for `zenostat run`: baseline, rbc, best.yaml, training/office, "
            "path/to/file.py:MyController, ...; repeatable.",
        ),
    ],
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per controller.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; each further episode adds 1.")] = 0,
    begin: Begin = None,
    end: End = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Parameter for each controller that has it; repeatable."),
    ] = None,
    prices: Price = None,
    emissions: Emissions = None,
    record: Annotated[
        Path | None, typer.Option(help="Record to this folder: a file for each controller, named after it.")
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option("--out", help="Write the table of episodes to FILE.parquet or FILE.csv; its folder is created."),
    ] = None,
    report: Annotated[Path | None, typer.Option(help=REPORT_HELP)] = None,
    figures: Annotated[Path | None, typer.Option(help=FIGURES_HELP)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the table of episodes as JSON.")] = False,
) -> None:
    """Run each controller through the same episodes, and compare energy, comfort and reward.

    Example: `zenostat evaluate 5zone-hot-continuous-v1 --controller baseline --controller rbc --begin 07-01 --end
    07-07 --episodes 3 --out results.parquet`

    A controller that does not fit the scenario is skipped with a message; the others still run. They do so as well if
    one fails, with an error of its own code; the exit code is then 1.
    """
    if file is not None:
        check_file(file)
    outputs = ReportOutputs(report, figures)
    from zenostat.lab.evaluate import evaluate as run_all

    options = (("begin", begin), ("end", end))
    overrides: dict[str, Any] = {name: value for name, value in options if value is not None}
    with ExitStack() as stack:
        watch = None if as_json else watcher(stack, episodes)
        evaluation = run_all(
            scenario, controllers, episodes=episodes, seed=seed, parameters=read_parameters(parameters),
            prices=read_rates("--price", prices), emissions=read_rates("--emissions", emissions),
            progress=watch, trace=outputs.wanted, record=record, **overrides,
        )  # fmt: skip
    if file is not None:
        write(evaluation.table(), file)
    if outputs.wanted:
        outputs.write(evaluation.comparison(command_line()))
    for name, reason in evaluation.unfit.items():
        err.print(f"{name} is skipped: {reason}")
    if as_json:
        show_json(evaluation.table())
    else:
        _show(evaluation, f"{scenario}, {counted(episodes, 'episode')} each, seed {seed}")
        if file is not None:
            out.print(f"episodes: {file}")
        outputs.show()
    by_text: dict[str, list[str]] = {}
    for name, texts in evaluation.warnings.items():
        for text in texts:
            by_text.setdefault(text, []).append(name)
    for text, names in by_text.items():
        (err if as_json else out).warning(f"{', '.join(names)}: {text}")
    end_with_failures([f"{name}: {error}" for name, error in evaluation.failures.items()], "failed: ")


def watcher(stack: ExitStack, episodes: int) -> Progress:
    """Show a progress bar for each controller, over the timesteps of all its episodes."""
    bars = stack.enter_context(progress())
    tasks: dict[str, Any] = {}

    def watch(controller: str, episode: int, step: int, steps: int) -> None:
        if controller not in tasks:
            tasks[controller] = bars.add_task(controller, total=steps * episodes, rate="")
        if step % _PROGRESS_INTERVAL == 0 or step == steps:
            speed = bars.tasks[tasks[controller]].speed
            rate = f"{speed:,.0f} steps/s" if speed else ""
            bars.update(tasks[controller], completed=episode * steps + step, rate=rate)

    return watch


def _show(evaluation: Evaluation, title: str) -> None:
    summary = evaluation.summary()
    names = dict.fromkeys(name for metrics in summary.values() for name in metrics)
    shown = [name for name in names if _is_shown(name, summary)]
    rows = [(_label(name), *(metric_text(metrics.get(name)) for metrics in summary.values())) for name in shown]
    show(title, ("", *summary), rows, right=tuple(summary), wrap=("",))
    notes: dict[str, list[str]] = {}
    for name in shown:
        if name in evaluation.sources:
            notes.setdefault(evaluation.sources[name], []).append(_label(name))
    for name in ("kpi.cost_tot", "kpi.emis_tot"):
        if name in evaluation.sources and name not in shown:
            notes.setdefault(evaluation.sources[name], []).append(_label(name))
    if any(metric.count > 1 for metrics in summary.values() for metric in metrics.values()):
        has_interval = any(metric.interval for metrics in summary.values() for metric in metrics.values())
        out.print(INTERVAL_NOTE if has_interval else "Means over the episodes; intervals need SciPy.")
    for source, labels in notes.items():
        out.print(f"{', '.join(labels)}: {source}")


def _is_shown(name: str, summary: Mapping[str, Mapping[str, MetricSummary]]) -> bool:
    """Whether a row is worth printing: counts of irregularities, and air quality, only if any is above zero."""
    if name not in ("late", "rejected", "terminated", "kpi.idis_tot"):
        return True
    return any(metrics[name].mean > 0 for metrics in summary.values() if name in metrics)


def _label(name: str) -> str:
    if name.startswith("kpi."):
        from zenostat.metrics.kpis import KPIS

        text, unit = KPIS[name.removeprefix("kpi.")]
        return f"{text} ({unit})"
    if name.startswith("mean_reward"):
        return name.replace("mean_reward", "reward", 1).replace(".", ": ").replace("_", " ") + " per step"
    words, _, unit = name.removesuffix("_m2").rpartition("_")
    if words and unit in _UNITS:
        unit += name[len(words) + 1 + len(unit) :]
        return f"{words.replace('_', ' ').replace('hvac', 'HVAC').replace('site', 'site energy')} ({_UNITS[unit]})"
    return name.replace(".", ": ").replace("_", " ")


def metric_text(metric: MetricSummary | None) -> str:
    """Return a metric as a table shows it: mean ± half of the 95 % confidence interval.

    It is "" if the node lacks what it needs, and "n/a" if the mean is no finite number, as after a sensor's failure.
    """
    if metric is None:
        return ""
    if not math.isfinite(metric.mean):
        return "n/a"
    size, is_exact = abs(metric.mean), not metric.half_width
    is_whole = is_exact and metric.mean == int(metric.mean)
    digits = 0 if size >= 1000 or is_whole else 1 if size >= 100 else 2 if size >= 1 else 4
    if not is_exact:
        return f"{metric.mean:,.{digits}f} ± {metric.half_width:,.{digits}f}"
    return f"{metric.mean:,.{digits}f}"


def check_file(path: Path) -> None:
    """Check that a table can be written to a path, whose folder need not exist.

    Raises:
        InvalidConfig: the suffix is not supported, the folder cannot be created, or a Parquet file needs a missing
            extra.
    """
    if path.suffix not in (".parquet", ".csv"):
        raise InvalidConfig(f"--out {path}: expected a .parquet or .csv file")
    existing = next(folder for folder in path.absolute().parents if folder.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        raise InvalidConfig(f"--out {path}: {existing} is not a folder that can be written to")
    if path.suffix == ".parquet":
        _parquet()


def _parquet() -> tuple[Any, Any]:
    from zenostat.topics.extras import import_extra

    return import_extra("pyarrow", "parquet", "a Parquet file"), import_extra(
        "pyarrow.parquet", "parquet", "a Parquet file"
    )


def write(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write rows with equal keys atomically; None becomes an empty cell in CSV and null in Parquet.

    The file's folder is created if it does not exist.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary:
        (_write_parquet if path.suffix == ".parquet" else _write_csv)(rows, temporary)


def _write_csv(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _write_parquet(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    arrow, parquet = _parquet()
    columns = {}
    for name in rows[0]:
        number = arrow.uint64() if name in _COUNT_COLUMNS else arrow.float64()
        kind = arrow.string() if name in _TEXT_COLUMNS else number
        columns[name] = arrow.array([row[name] for row in rows], kind)
    parquet.write_table(arrow.table(columns), str(path))
