"""`zenostat benchmark`: score controllers on fixed buildings, weather and seeds."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from zenostat.cli.console import err, out, progress
from zenostat.cli.name_lists import end_with_failures, names_in, numbers_in
from zenostat.cli.options import is_explicit
from zenostat.cli.tables import show, show_json
from zenostat.topics.atomic_file import check_writable
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import import_extra

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from zenostat.lab.benchmark import Results, Selection
    from zenostat.lab.workers import Progress

_ALL = "baseline,fixed,rbc,tuned,pid,random,oracle,ppo,sac"
_SELECTION = ("--building", "--season", "--weather", "--seed", "--training-seed")
_RUNNING = ("--controllers", "--workers", "--trainings", "--policies")
_OUTPUT = ("--page", "--bounds", "--json")
_MODES: Mapping[str, Sequence[str]] = {
    "--schema": (),
    "--sample": ("--submit-check", "--reference", "--sample-seed", *_RUNNING),
    "--submit-check": ("--reference",),
    "--check": (*_RUNNING, *_SELECTION),
    "--show": ("--controllers", *_OUTPUT),
    "--merge": ("--out", *_OUTPUT),
    "--out": ("--set", *_RUNNING, *_SELECTION, *_OUTPUT),
}
"""Options that have an effect with each option that says what to do; the first one that is given counts."""
_NEEDED = {"--merge": "--out", "--sample": "--submit-check"}

_Names = Annotated[
    str | None, typer.Option(help="With --out or --check, only these; names separated by commas.", show_default=False)
]


def benchmark(
    context: typer.Context,
    set_name: Annotated[
        str, typer.Option("--set", help="smoke (a test), quick (for a look) or full (the published one).")
    ] = "quick",
    controllers: Annotated[
        str,
        typer.Option(
            help="Names separated by commas, by default all of the benchmark; also path/to/file.py:MyController, "
            "ppo:model.zip, a training's folder or an exported policy.",
            show_default=False,
        ),
    ] = _ALL,
    file: Annotated[
        Path | None, typer.Option("--out", help="Results, JSON; rows that it already has are not run again.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Buildings that are simulated at the same time.")] = 1,
    trainings: Annotated[
        Path | None, typer.Option(help="Folder that keeps the trainings and tunings; by default beside the results.")
    ] = None,
    policies: Annotated[
        Path | None,
        typer.Option(help="Folder with finished policies, used instead of training; further ones are written to it."),
    ] = None,
    checked: Annotated[
        Path | None, typer.Option("--check", help="Run the rows of this file again, and compare them to the bit.")
    ] = None,
    building: _Names = None,
    season: _Names = None,
    weather: _Names = None,
    seed: _Names = None,
    training_seed: _Names = None,
    merged: Annotated[
        list[Path] | None,
        typer.Option("--merge", help="Write the rows of this file and of the others so given to --out; run nothing."),
    ] = None,
    submitted: Annotated[
        Path | None,
        typer.Option("--submit-check", help="Check results of others: form, versions, hashes, completeness, baseline."),
    ] = None,
    reference: Annotated[
        Path | None,
        typer.Option(help="With --submit-check, the published results; by default those in docs/benchmark."),
    ] = None,
    sample: Annotated[
        int, typer.Option(min=0, help="With --submit-check, number of rows, drawn at random, to run again.")
    ] = 0,
    sample_seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of that draw, to repeat it. [default: another one each time]")
    ] = None,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema of results.")] = False,
    shown: Annotated[Path | None, typer.Option("--show", help="Show the results of this file; nothing is run.")] = None,
    page: Annotated[
        Path | None, typer.Option(help="Write a page with tables and figures to FILE.md and the folder FILE.")
    ] = None,
    bounds: Annotated[
        Path | None,
        typer.Option(help="Also show shares of the gap to the bounds in this folder; see `zenostat bounds`."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON instead of tables.")] = False,
) -> None:
    """Score controllers relative to the baseline control, on buildings and weather that training has not seen.

    Example: `zenostat benchmark --controllers rbc,mine.py:MyController --out results.json --workers 2`

    Ctrl-C ends it; the same command continues. Controllers that learn or are tuned are trained first, unless the
    folder of trainings has them.
    """
    conditions = {
        "controller": None if controllers == _ALL else controllers,
        "building": building, "season": season, "weather": weather, "seed": seed, "training_seed": training_seed,
    }  # fmt: skip
    _check_options({of.opts[0] for of in context.command.params if of.name and is_explicit(context, of.name)})
    if schema:
        from zenostat.lab.benchmark.results_file import schema as json_schema

        show_json(json_schema())
        return
    import_extra("scipy", "benchmark", "the benchmark")
    if page is not None:
        _check_page(page)
    running = _Running(workers, trainings, policies)
    errors: list[str] = []
    if checked is not None:
        _check(checked, conditions, running)
        return
    if submitted is not None:
        _check_submission(submitted, reference, sample, sample_seed, conditions, running)
        return
    if shown is not None:
        results = _load_shown(shown, conditions)
    else:
        assert file is not None
        if merged:
            results = _merge(merged, file)
        else:
            results, errors = _run(set_name, file, names_in(controllers, "--controllers"), conditions, running)
    _show(results, page, bounds, as_json=as_json)
    end_with_failures(errors, "failed: ")


class _Running(NamedTuple):
    """Options of everything that runs episodes."""

    workers: int
    cache: Path | None
    policies: Path | None


def _check_options(options: Collection[str]) -> None:
    """Check the options of the command line.

    Raises:
        InvalidConfig: it does not say what to do, or some have no effect.
    """
    mode = next((name for name in _MODES if name in options), None)
    if mode is None:
        raise InvalidConfig(
            "one of --out, --check, --show and --submit-check expected: a file of results (JSON); or --schema"
        )
    if (needed := _NEEDED.get(mode, mode)) not in options:
        raise InvalidConfig(f"{mode}: only with {needed}")
    faults = []
    for option in sorted(set(options) - {mode, *_MODES[mode]}):
        modes = [name for name, allowed in _MODES.items() if option in allowed]
        only = f"only with {' or '.join(modes)}, " if modes and option not in _MODES else ""
        faults.append(f"{option}: {only}not with {mode}")
    if {"--json", "--bounds"} <= set(options) and "--page" not in options:
        faults.append("--bounds: not with --json, which prints the rows alone; only with --page as well")
    if faults:
        raise InvalidConfig("\n".join(faults))


def _run(
    set_name: str, file: Path, names: list[str], conditions: Mapping[str, str | None], running: _Running
) -> tuple[Results, list[str]]:
    from zenostat.lab.benchmark import run_benchmark

    with ExitStack() as stack:
        return run_benchmark(
            set_name, file, names, selection=_selection({**conditions, "controller": None}), workers=running.workers,
            cache=running.cache, policies=running.policies, hashes=file_hashes(set_name), progress=watcher(stack),
        )  # fmt: skip


def _merge(files: Sequence[Path], target: Path) -> Results:
    from zenostat.lab.benchmark.merge import merge_results

    check_writable(target, f"--out {target}")
    results = merge_results([*files, *([target] if target.exists() and target not in files else [])])
    results.save(target)
    return results


def _load_shown(path: Path, conditions: Mapping[str, str | None]) -> Results:
    """Return the results of a file, without the rows of controllers that were not named."""
    from zenostat.lab.benchmark import load_results
    from zenostat.lab.benchmark.merge import with_controllers

    results, names = load_results(path), conditions["controller"]
    return results if names is None else with_controllers(results, names_in(names, "--controllers"), str(path))


def _selection(conditions: Mapping[str, str | None]) -> Selection:
    from zenostat.lab.benchmark import Selection

    values: dict[str, Any] = {}
    for name, text in conditions.items():
        if text is not None:
            option = "--controllers" if name == "controller" else f"--{name.replace('_', '-')}"
            values[name] = (numbers_in if name in ("seed", "training_seed") else names_in)(text, option)
    return Selection(**values)


def _check(path: Path, conditions: Mapping[str, str | None], running: _Running) -> None:
    from zenostat.lab.benchmark import check, load_results
    from zenostat.lab.benchmark.rerun import selected_rows

    results, selection = load_results(path), _selection(conditions)
    count = len(selected_rows(results, selection, str(path)))
    with ExitStack() as stack:
        differences = check(
            path, selection, workers=running.workers, cache=running.cache, policies=running.policies,
            hashes=file_hashes(results.set), progress=watcher(stack),
        )  # fmt: skip
    _report(differences, f"{path}: {count} rows are equal to the bit")


def _check_submission(
    path: Path, reference: Path | None, sample: int, sample_seed: int | None, conditions: Mapping[str, str | None],
    running: _Running,
) -> None:  # fmt: skip
    from zenostat.lab.benchmark import load_results
    from zenostat.lab.benchmark.submission import check_submission

    named = conditions["controller"]
    names = [] if named is None else names_in(named, "--controllers")
    with ExitStack() as stack:
        errors, notes = check_submission(
            path, reference, file_hashes(load_results(path).set), sample=sample, sample_seed=sample_seed,
            controllers=names, workers=running.workers, cache=running.cache, policies=running.policies,
            progress=watcher(stack),
        )  # fmt: skip
    for note in notes:
        err.print(note)
    _report(errors, f"{path}: no errors; the notes say what was not checked")


def _report(errors: Sequence[str], success: str) -> None:
    end_with_failures(errors)
    out.print(success)


def _check_page(page: Path) -> None:
    if page.suffix != ".md":
        raise InvalidConfig(f"--page {page}: expected a .md file")
    check_writable(page, f"--page {page}")
    import_extra("matplotlib", "plots", "a page with figures")


def file_hashes(set_name: str) -> dict[str, str]:
    """Return the sha256 of the models and weather files of a set; empty if there is no such set."""
    from zenostat.bridge.recording.file import file_digest
    from zenostat.lab.benchmark.definition import SETS, TRAINING_WEATHERS
    from zenostat.models.catalog import find_building, find_weather

    if set_name not in SETS:
        return {}
    paths = {name: find_building(name).path for name in SETS[set_name].buildings}
    paths |= {name: find_weather(name).path for name in (*SETS[set_name].weathers, *TRAINING_WEATHERS)}
    return {name: file_digest(path) for name, path in paths.items()}


def watcher(stack: ExitStack) -> Progress:
    """Show a progress bar for the trainings and one for the tasks; without a terminal, a line for each finished one."""
    if not out.is_interactive:
        return lambda stage, done, total: err.print(f"{stage}: {done} of {total}")
    bars = stack.enter_context(progress())
    bar_of: dict[str, Any] = {}

    def watch(stage: str, done: int, total: int) -> None:
        if stage not in bar_of:
            bar_of[stage] = bars.add_task(stage, total=total, rate="")
        bars.update(bar_of[stage], completed=done)

    return watch


def _show(results: Results, page: Path | None, bounds: Path | None, *, as_json: bool) -> None:
    from zenostat.lab.benchmark.bound_file import load_bounds
    from zenostat.lab.benchmark.gap import tables_with_gap
    from zenostat.lab.benchmark.page import write_page

    known = {} if bounds is None else load_bounds(bounds, results.set)
    if as_json:
        show_json(results.plain()["rows"])
    else:
        for table in tables_with_gap(results, known):
            if not out.is_terminal:
                out.print(f"\n{table.title}")
            show(table.title, table.columns, table.rows, right=table.columns[1:], wrap=table.columns[:1])
    if page is not None:
        write_page(results, page, known)
        if not as_json:
            out.print(f"page: {page}")
