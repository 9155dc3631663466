"""Check results by running rows again."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from zenostat.lab.benchmark.definition import BASELINES, Episode
from zenostat.lab.benchmark.episodes import jobs, run_job
from zenostat.lab.benchmark.results import Results, changed_versions, episode_of, load_results
from zenostat.lab.benchmark.results_file import Row, is_rounding, is_same
from zenostat.lab.benchmark.run import cache_folder, check_controllers, name_of, prepare_missing, stale_trainings
from zenostat.lab.benchmark.selection import Selection
from zenostat.lab.workers import Progress, worker_pool
from zenostat.topics.errors import InvalidConfig


def check(
    path: Path, selection: Selection | None = None, *, workers: int = 1, cache: Path | None = None,
    policies: Path | None = None, progress: Progress | None = None, hashes: Mapping[str, str] | None = None,
) -> list[str]:  # fmt: skip
    """Run the rows of a file again, and return what differs; empty if all rows are equal to the bit.

    Args:
        path: file of the results.
        selection: check only these rows; None: all. A controller that is not part of the benchmark is run only if the
            selection names it, since a file of results must not choose code.
        workers: as of `run_benchmark`.
        cache: as of `run_benchmark`.
        policies: as of `run_benchmark`.
        progress: as of `run_benchmark`.
        hashes: as of `run_benchmark`.

    Raises:
        UnknownName, InvalidConfig: see `load_results`; or there are no such rows; or rows of a controller that is not
            part of the benchmark.
    """
    results = load_results(path)
    chosen = selected_rows(results, selection, str(path))
    files = check_controllers(list(dict.fromkeys(row.controller for row in chosen)))
    differences = [f"definition of {name}" for name in stale_trainings(results)]
    for known, now in ((results.hashes, hashes or {}), (results.controllers, files)):
        differences += [f"file {name}" for name, digest in now.items() if known.get(name, digest) != digest]
    return differences + check_rows(
        results, chosen, workers=workers, cache=cache_folder(path) if cache is None else cache, policies=policies,
        progress=progress,
    )  # fmt: skip


def check_rows(
    results: Results, chosen: Collection[Row], *, cache: Path, workers: int = 1, policies: Path | None = None,
    progress: Progress | None = None, but_for_rounding: bool = False,
) -> list[str]:  # fmt: skip
    """Run some rows of results again, and return those that differ, if any with the versions that do; see `check`.

    With `but_for_rounding`, rows that are equal but for it are accepted.
    """
    differences: list[str] = []
    episodes = [episode_of(row) for row in chosen]
    again: dict[Episode, Row] = {}
    with worker_pool(workers) as run_all:
        unprepared = prepare_missing(results, episodes, cache, policies, run_all, progress, differences)
        runnable = [episode for episode in episodes if name_of(episode) not in unprepared]
        for rows, failures in run_all(run_job, jobs(results.set, runnable, cache), "episodes", progress, differences):
            differences += failures
            again.update({episode_of(row): row for row in rows})
    is_equal = is_rounding if but_for_rounding else is_same
    for row in chosen:
        new = again.get(episode_of(row))
        changes = ["could not be run again"] if new is None else row.differences(new, is_equal)
        differences += [f"{episode_of(row)}: {'; '.join(changes)}"] * bool(changes)
    versions = [f"version of {change}" for change in changed_versions(results.versions)]
    return [*versions, *differences] if differences else []


def selected_rows(results: Results, selection: Selection | None, what: str) -> list[Row]:
    """Return the selected rows in order; errors as of `check`."""
    selection, rows = selection or Selection(), results.sorted_rows()
    selection.check(map(episode_of, rows), what)
    chosen = [row for row in rows if selection.has(episode_of(row))]
    named = selection.controller or ()
    if others := sorted({row.controller for row in chosen} - BASELINES.keys() - set(named)):
        raise InvalidConfig(
            f"{what} has rows of {', '.join(others)}, which is not part of the benchmark: name the controllers to run "
            f"with --controllers {','.join([*{row.controller: None for row in chosen}])}"
        )
    return chosen
