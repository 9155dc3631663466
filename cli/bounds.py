"""`zenostat bounds`: search the best known score of each task of the benchmark."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import err, out, progress
from zenostat.cli.name_lists import end_with_failures, names_in, numbers_in
from zenostat.cli.options import is_explicit
from zenostat.cli.tables import show
from zenostat.topics.errors import InvalidConfig

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zenostat.lab.benchmark.bound_file import Bound
    from zenostat.lab.benchmark.bounds import BoundTask

_Names = Annotated[str | None, typer.Option(help="Only these tasks; names separated by commas.", show_default=False)]
_SEARCH = {"simulations": "--simulations", "controllers": "--controllers", "policies": "--policies",
           "search_seed": "--search-seed"}  # fmt: skip
"""Options of a search by parameter; all but the first have an effect only where it begins."""


def bounds(
    context: typer.Context,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder with a file for each task and seed.")],
    set_name: Annotated[str, typer.Option("--set", help="Set of the benchmark: smoke, quick or full.")] = "quick",
    simulations: Annotated[
        int, typer.Option(min=1, help="Simulated episodes of each task, those of earlier runs included.")
    ] = 1000,
    controllers: Annotated[
        str,
        typer.Option(
            help="Controllers with whose best the search begins, separated by commas; also "
            "path/to/file.py:MyController or a training's folder."
        ),
    ] = "baseline,fixed,rbc,oracle",
    policies: Annotated[
        Path | None, typer.Option(help="Folder with the policies of `tuned`, `ppo` or `sac`, as of the benchmark.")
    ] = None,
    workers: Annotated[
        int, typer.Option(min=1, max=256, help="Tasks that are searched, or checked, at the same time.")
    ] = 1,
    building: _Names = None,
    season: _Names = None,
    weather: _Names = None,
    seed: _Names = None,
    search_seed: Annotated[int, typer.Option(min=0, help="Seed of new searches.")] = 0,
    checked: Annotated[
        bool, typer.Option("--check", help="Run the actions in the files again, and compare the rewards to the bit.")
    ] = False,
) -> None:
    """Search for the best known score of each task of the benchmark, on its true model.

    Example: `zenostat bounds bounds --set quick --season summer --simulations 1000 --workers 2`

    Ctrl-C ends it; the same command continues where the file of the task was written last. More simulations improve it.
    """
    from zenostat.cli.benchmark import file_hashes, watcher
    from zenostat.lab.benchmark.bounds import BoundTask, check_starts, improve_bound, tasks_of
    from zenostat.lab.workers import worker_pool

    explicit = [option for name, option in _SEARCH.items() if is_explicit(context, name)]
    if checked and explicit:
        raise InvalidConfig(
            "\n".join(f"{option}: not with --check, which runs the saved actions" for option in explicit)
        )
    names = {"building": building, "season": season, "weather": weather}
    conditions: dict[str, Any] = {name: names_in(text, f"--{name}") for name, text in names.items() if text is not None}
    tasks = tasks_of(set_name, **conditions, seed=None if seed is None else numbers_in(seed, "--seed"))
    hashes = file_hashes(set_name)
    if checked:
        _check(folder, set_name, [(*task.key, number) for task, number in tasks], hashes, workers)
        return
    starts = names_in(controllers, "--controllers")
    jobs = [BoundTask(set_name, task, number, folder, starts, hashes, policies) for task, number in tasks]
    check_starts(jobs)
    continued = sum(job.path.exists() for job in jobs)
    if continued and (unused := [option for option in explicit if option != "--simulations"]):
        what = f"{', '.join(unused)}: of new searches alone"
        err.print(f"{what}; {continued} of {len(jobs)} tasks have a file, with which their search continues")
    errors: list[str] = []
    improve = partial(_improve if workers == 1 else improve_bound, simulations=simulations, search_seed=search_seed)
    with ExitStack() as stack, worker_pool(workers) as run_all:
        watch = None if workers == 1 else watcher(stack)  # one at a time shows its own progress
        improved = list(run_all(improve, jobs, "bounds", watch, errors))
    if improved:
        _show(sorted(improved, key=lambda bound: bound.key))
    end_with_failures(errors, "failed: ")


def _improve(job: BoundTask, simulations: int, search_seed: int) -> Bound:
    from zenostat.lab.benchmark.bounds import improve_bound

    name = str(job)
    if not out.is_interactive:

        def tell(done: int, reward: float) -> None:
            err.print(f"{name}: {done} of {max(done, simulations)} simulations, {reward:.2f}")

        return improve_bound(job, simulations, search_seed=search_seed, progress=tell)
    with progress() as bars:
        bar = bars.add_task(name, total=simulations, rate="")

        def watch(done: int, reward: float) -> None:
            bars.update(bar, completed=done, rate=f"{reward:.2f}")

        return improve_bound(job, simulations, search_seed=search_seed, progress=watch)


def _check(folder: Path, set_name: str, keys: Sequence[Any], hashes: dict[str, str], workers: int) -> None:
    from zenostat.cli.benchmark import watcher
    from zenostat.lab.benchmark.bound_file import load_bounds
    from zenostat.lab.benchmark.bounds import check_bound
    from zenostat.lab.workers import worker_pool

    chosen = [bound for key, bound in load_bounds(folder, set_name).items() if key in set(keys)]
    if not chosen:
        raise InvalidConfig(f"{folder} has no bounds of the chosen tasks")
    differences: list[str] = []
    check = partial(check_bound, set_name=set_name, hashes=hashes)
    with ExitStack() as stack, worker_pool(workers) as run_all:
        for changes in run_all(check, chosen, "bounds", watcher(stack), differences):
            differences += changes
    end_with_failures(differences)
    out.print(f"{folder}: bounds that are equal to the bit: {len(chosen)}")


def _show(bounds_of_tasks: Sequence[Bound]) -> None:
    rows = []
    for bound in bounds_of_tasks:
        best = max(bound.starts, key=lambda name: bound.starts[name])
        baseline = bound.starts.get("baseline (relative)")
        rows.append(
            (
                str(bound), "" if baseline is None else f"{baseline:,.2f}", best,
                f"{bound.starts[best]:,.2f}", f"{bound.reward:,.2f}", str(bound.simulations),
            )
        )  # fmt: skip
    columns = ("task", "baseline (EUR)", "best start", "(EUR)", "bound (EUR)", "simulations")
    show("Total rewards", columns, rows, right=("baseline (EUR)", "(EUR)", "bound (EUR)", "simulations"))
