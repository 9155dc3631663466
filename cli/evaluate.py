"""`zenostat evaluate`: controllers compared in one scenario, on the same weather."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.console import err, out, progress
from cli.run import read_parameters
from cli.tables import show, show_json
from topics.atomic_file import atomic_file
from topics.errors import InvalidConfig

if TYPE_CHECKING:
    from agent_sdk.evaluation.evaluate import Evaluation, MetricSummary, Progress

_UNITS = {"kwh": "kWh", "w": "W", "kw": "kW", "k": "K", "kh": "K h", "percent": "%"}
_TEXTS = ("controller", "weather")
_COUNTS = ("episode", "seed", "steps", "late", "rejected")
_EVERY = 24
"""Timesteps from one look of the progress bar to the next."""


def evaluate(
    scenario: Annotated[str, typer.Argument(help="An id, as `zenostat scenarios` lists them, or a scenario file.")],
    controllers: Annotated[
        list[str],
        typer.Option(
            "--controller",
            help="As `zenostat run` takes it (building, rbc, path/to/file.py:MyController, ...), or a model of "
            "stable-baselines3: ppo:model.zip; repeated.",
        ),
    ],
    episodes: Annotated[int, typer.Option(min=1, help="How many for each controller.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Of the first episode; the others have the next ones.")] = 0,
    begin: Annotated[str | None, typer.Option(help="First day, MM-DD or YYYY-MM-DD.")] = None,
    end: Annotated[str | None, typer.Option(help="Last day.")] = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A parameter, of each controller that takes it; repeated."),
    ] = None,
    file: Annotated[
        Path | None, typer.Option("--out", help="Where the episodes' table goes: FILE.parquet or FILE.csv.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the episodes' table as JSON.")] = False,
) -> None:
    """Runs each controller through the same episodes and compares energy, comfort and reward.

    Example: `zenostat evaluate 5zone-hot-continuous-v1 --controller building --controller rbc --begin 07-01 --end
    07-07 --episodes 3 --out results.parquet`

    A controller that does not fit the scenario is left out; a line says why, and the others go on.
    """
    if file is not None:
        check_file(file)
    from agent_sdk.evaluation.evaluate import evaluate as run_all

    period = {name: day for name, day in (("begin", begin), ("end", end)) if day is not None}
    with ExitStack() as stack:
        watch = None if as_json else _watcher(stack, episodes)
        given = read_parameters(parameters or [])
        found = run_all(
            scenario, controllers, episodes=episodes, seed=seed, parameters=given, progress=watch, **period
        )  # fmt: skip
    if file is not None:
        write(found.table(), file)
    for name, why in found.unfit.items():
        err.print(f"{name} is left out: {why}", soft_wrap=True, markup=False)
    if as_json:
        show_json(found.table())
        return
    _show(found, f"{scenario}, {episodes} episode{'s' if episodes > 1 else ''} each, seed {seed}")
    if file is not None:
        out.print(f"episodes: {file}", soft_wrap=True)


def _watcher(stack: ExitStack, episodes: int) -> Progress:
    """A bar for each controller, over the timesteps of all its episodes."""
    bars = stack.enter_context(progress())
    tasks: dict[str, Any] = {}

    def watch(controller: str, episode: int, step: int, steps: int) -> None:
        if controller not in tasks:
            tasks[controller] = bars.add_task(controller, total=steps * episodes, rate="")
        if step % _EVERY == 0 or step == steps:
            speed = bars.tasks[tasks[controller]].speed
            rate = f"{speed:,.0f} steps/s" if speed else ""
            bars.update(tasks[controller], completed=episode * steps + step, rate=rate)

    return watch


def _show(found: Evaluation, title: str) -> None:
    summary = found.summary()
    metrics = [name for name in dict.fromkeys(n for of in summary.values() for n in of) if _tells(name, summary)]
    rows = [(_label(name), *(_cell(of.get(name)) for of in summary.values())) for name in metrics]
    show(title, ("", *summary), rows, right=tuple(summary), wrap=("",))
    notes: dict[str, list[str]] = {}
    for name in metrics:
        if name in found.sources:
            notes.setdefault(found.sources[name], []).append(_label(name))
    for source, names in notes.items():
        out.print(f"{', '.join(names)}: {source}", soft_wrap=True, markup=False)


def _tells(name: str, summary: Mapping[str, Mapping[str, MetricSummary]]) -> bool:
    """Whether a row says something: counts of what should not happen only where it did."""
    if name not in ("late", "rejected", "terminated"):
        return True
    return any(of[name].mean > 0 for of in summary.values() if name in of)


def _label(name: str) -> str:
    if name.startswith("mean_reward"):
        return name.replace("mean_reward", "reward", 1).replace(".", ": ").replace("_", " ") + ", a step"
    words, _, unit = name.rpartition("_")
    if words and unit in _UNITS:
        return f"{words.replace('_', ' ').replace('hvac', 'HVAC')} ({_UNITS[unit]})"
    return name.replace(".", ": ").replace("_", " ")


def _cell(spread: MetricSummary | None) -> str:
    if spread is None:
        return ""
    size = abs(spread.mean)
    digits = 0 if size >= 1000 or spread.mean == int(spread.mean) else 1 if size >= 100 else 2 if size >= 1 else 4
    if spread.deviation:
        return f"{spread.mean:,.{digits}f} ± {spread.deviation:,.{digits}f}"
    return f"{spread.mean:,.{digits}f}"


def check_file(path: Path) -> None:
    """Whether a table can be written there.

    Raises:
        InvalidConfig: another suffix, no such folder, or the extra for it is missing.
    """
    if path.suffix not in (".parquet", ".csv"):
        raise InvalidConfig(f"--out {path}: a table goes to a file .parquet or .csv")
    if not path.absolute().parent.is_dir():
        raise InvalidConfig(f"--out {path}: there is no folder {path.absolute().parent}")
    if path.suffix == ".parquet":
        _parquet()


def _parquet() -> tuple[Any, Any]:
    from agent_sdk.wrappers.extras import load

    return load("pyarrow", "parquet", "a Parquet file"), load("pyarrow.parquet", "parquet", "a Parquet file")


def write(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Writes rows of the same keys; the file is there whole or not at all. None is an empty cell, or null."""
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
        kind = arrow.string() if name in _TEXTS else arrow.int64() if name in _COUNTS else arrow.float64()
        columns[name] = arrow.array([row[name] for row in rows], kind)
    parquet.write_table(arrow.table(columns), str(path))
