"""`zenostat benchmark`: score controllers on fixed buildings, weather and seeds."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import err, out, progress
from zenostat.cli.tables import show, show_json
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import import_extra

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zenostat.lab.benchmark import Results, Selection
    from zenostat.lab.benchmark.run import Progress

_ALL = "baseline,fixed,rbc,pid,random,ppo,sac,oracle"


_Names = Annotated[
    str | None, typer.Option(help="With --check, only these rows; names separated by commas.", show_default=False)
]


def benchmark(
    set_name: Annotated[
        str, typer.Option("--set", help="smoke (seconds), quick (the published one) or full.")
    ] = "quick",
    controllers: Annotated[
        str,
        typer.Option(
            help="Names separated by commas, by default all of the benchmark; also path/to/file.py:MyController, "
            "ppo:model.zip or a training's folder.",
            show_default=False,
        ),
    ] = _ALL,
    file: Annotated[
        Path | None, typer.Option("--out", help="Results, JSON; rows that it already has are not run again.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Buildings that are simulated at the same time.")] = 1,
    trainings: Annotated[
        Path | None, typer.Option(help="Folder that keeps the trainings; by default beside the results.")
    ] = None,
    checked: Annotated[
        Path | None, typer.Option("--check", help="Run the rows of this file again, and compare them to the bit.")
    ] = None,
    building: _Names = None,
    season: _Names = None,
    weather: _Names = None,
    seed: _Names = None,
    shown: Annotated[Path | None, typer.Option("--show", help="Show the results of this file; nothing is run.")] = None,
    page: Annotated[
        Path | None, typer.Option(help="Write a page with tables and figures to FILE.md and the folder FILE.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON instead of tables.")] = False,
) -> None:
    """Score controllers relative to the baseline control, on buildings and weather that training has not seen.

    Example: `zenostat benchmark --controllers rbc,mine.py:MyController --out results.json --workers 2`

    Ctrl-C ends it; the same command continues. PPO and SAC are trained first, unless the folder of trainings has them.
    """
    if sum(option is not None for option in (file, checked, shown)) != 1:
        raise InvalidConfig("one of --out, --check and --show expected: a file of results (JSON)")
    import_extra("scipy", "benchmark", "the benchmark")
    if page is not None:
        _check_page(page)
    names = _listed(controllers)
    conditions = {"building": building, "season": season, "weather": weather, "seed": seed}
    if checked is None and (named := [name for name, value in conditions.items() if value is not None]):
        raise InvalidConfig(f"--{', --'.join(named)}: only with --check, which runs the rows of a file again")
    errors: list[str] = []
    if checked is not None:
        _check(checked, {"controller": None if controllers == _ALL else controllers, **conditions}, workers, trainings)
        return
    if shown is not None:
        from zenostat.lab.benchmark import load_results

        results = load_results(shown)
    else:
        assert file is not None
        from zenostat.lab.benchmark import run_benchmark

        with ExitStack() as stack:
            results, errors = run_benchmark(
                set_name, file, names, workers=workers, cache=trainings, hashes=_hashes(set_name),
                progress=_watcher(stack),
            )  # fmt: skip
    _show(results, page, as_json=as_json)
    for error in errors:
        err.print(f"failed: {error}", soft_wrap=True, markup=False)
    if errors:
        raise typer.Exit(1)


def _check_page(page: Path) -> None:
    if page.suffix != ".md":
        raise InvalidConfig(f"--page {page}: expected a .md file")
    if not page.absolute().parent.is_dir():
        raise InvalidConfig(f"--page {page}: there is no folder {page.absolute().parent}")
    import_extra("matplotlib", "plots", "a page with figures")


def _hashes(set_name: str) -> dict[str, str]:
    """Return the sha256 of the models and weather files of a set; empty if there is no such set."""
    from zenostat.bridge.recording.file import file_digest
    from zenostat.lab.benchmark.definition import SETS, TRAINING_WEATHERS
    from zenostat.models.catalog import find_building, find_weather

    if set_name not in SETS:
        return {}
    paths = {name: find_building(name).path for name in SETS[set_name].buildings}
    paths |= {name: find_weather(name).path for name in (*SETS[set_name].weathers, *TRAINING_WEATHERS)}
    return {name: file_digest(path) for name, path in paths.items()}


def _listed(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _selection(conditions: Mapping[str, str | None]) -> Selection:
    from zenostat.lab.benchmark import Selection

    values: dict[str, Any] = {name: _listed(text) for name, text in conditions.items() if text is not None}
    if "seed" in values:
        try:
            values["seed"] = [int(seed) for seed in values["seed"]]
        except ValueError:
            raise InvalidConfig(f"--seed {conditions['seed']}: numbers separated by commas expected") from None
    return Selection(**values)


def _check(path: Path, conditions: Mapping[str, str | None], workers: int, trainings: Path | None) -> None:
    from zenostat.lab.benchmark import check, load_results
    from zenostat.lab.benchmark.run import selected_rows

    results, selection = load_results(path), _selection(conditions)
    count = len(selected_rows(results, selection, str(path)))
    with ExitStack() as stack:
        differences = check(
            path, selection, workers=workers, cache=trainings, hashes=_hashes(results.set), progress=_watcher(stack)
        )
    for difference in differences:
        err.print(difference, soft_wrap=True, markup=False)
    if differences:
        raise typer.Exit(1)
    out.print(f"{path}: {count} rows are equal to the bit", soft_wrap=True, markup=False)


def _watcher(stack: ExitStack) -> Progress:
    """Show a progress bar for the trainings and one for the tasks; without a terminal, a line for each finished one."""
    if not out.is_interactive:
        return lambda stage, done, total: err.print(f"{stage}: {done} of {total}", soft_wrap=True, markup=False)
    bars = stack.enter_context(progress())
    bar_of: dict[str, Any] = {}

    def watch(stage: str, done: int, total: int) -> None:
        if stage not in bar_of:
            bar_of[stage] = bars.add_task(stage, total=total, rate="")
        bars.update(bar_of[stage], completed=done)

    return watch


def _show(results: Results, page: Path | None, *, as_json: bool) -> None:
    from zenostat.lab.benchmark.page import write_page
    from zenostat.lab.benchmark.tables import tables

    if page is not None:
        write_page(results, page)
    if as_json:
        show_json(results.plain()["rows"])
        return
    for table in tables(results):
        show(table.title, table.columns, table.rows, right=table.columns[1:], wrap=table.columns[:1])
    if page is not None:
        out.print(f"page: {page}", soft_wrap=True, markup=False)
