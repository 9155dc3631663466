"""Check results of others before they are published beside those of the benchmark."""

from __future__ import annotations

import math
import random
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from zenostat.lab.benchmark.definition import BASELINE, BASELINES, SETS, VERSION, Episode, is_prepared
from zenostat.lab.benchmark.rerun import check_rows
from zenostat.lab.benchmark.results import Results, changed_versions, episode_of, load_results
from zenostat.lab.benchmark.results_file import Row
from zenostat.lab.benchmark.run import name_of, stale_trainings
from zenostat.lab.benchmark.scores import relative_reward
from zenostat.lab.workers import Progress
from zenostat.topics.errors import InvalidConfig

_SHOWN = 5
_TOLERANCE = 1e-6
_HIGHEST, _LOWEST = 1.0, -100.0
"""Scores out of this range are errors of a program: 1 is a week without any costs."""


def check_submission(
    path: Path, reference: Path | None, hashes: Mapping[str, str], *, sample: int = 0, sample_seed: int = 0,
    controllers: Sequence[str] = (), workers: int = 1, cache: Path | None = None, policies: Path | None = None,
    progress: Progress | None = None,
) -> tuple[list[str], list[str]]:  # fmt: skip
    """Check results of others: versions, hashes, completeness, plausible rewards, and the rows of the baseline control.

    The form of the file, its version, definition and the hash of its rows are checked when it is read.

    Args:
        path: the results.
        reference: published results of the same set; None: those in `docs/benchmark` of the working directory, if any.
        hashes: sha256 of the models and weather files by name.
        sample: number of rows to run again; 0: none.
        sample_seed: seed with which they are drawn.
        controllers: controllers that are not part of the benchmark and may be run: a file of results chooses no code.
        workers: as of `run_benchmark`.
        cache: folder of the trainings and tunings; None: a temporary one.
        policies: as of `run_benchmark`.
        progress: as of `run_benchmark`.

    Returns:
        The errors, and notes on what could not be checked.

    Raises:
        UnknownName, InvalidConfig: see `load_results`.
    """
    results = load_results(path)
    errors = [f"{name}: not the file of the benchmark" for name in hashes if results.hashes.get(name) != hashes[name]]
    errors += [f"{name}: trained or tuned for another definition" for name in stale_trainings(results)]
    errors += _incomplete(results) + _implausible(results)
    different, notes = _compare_baseline(results, path, reference)
    errors += different
    if sample:
        drawn, skipped = _draw(results, sample, sample_seed, controllers)
        notes += skipped
        with tempfile.TemporaryDirectory() as folder:
            errors += check_rows(
                results, drawn, cache=cache or Path(folder), workers=workers, policies=policies, progress=progress,
                hashes=hashes,
            )  # fmt: skip
    return errors, notes


def _compare_baseline(results: Results, path: Path, reference: Path | None) -> tuple[list[str], list[str]]:
    """Return the errors of a comparison with the published rows of the baseline control, and why it was not possible.

    Raises:
        UnknownName, InvalidConfig: the reference cannot be read, or is one of another set.
    """
    not_compared = "the rows of the baseline control were not compared"
    published_path = reference or Path("docs", "benchmark", f"{results.set}-{VERSION}.json")
    if reference is None and not published_path.is_file():
        return [], [f"{not_compared}: no published rows are in {published_path}; --reference names others"]
    published = load_results(published_path)
    if published.set != results.set:
        raise InvalidConfig(f"{path} has results of the set {results.set!r}, the reference those of {published.set!r}")
    if changes := changed_versions(results, published.versions):
        notes = [f"version of {change}" for change in changes]
        return [], [*notes, f"{not_compared}: they were made with other versions"]
    return _other_baseline(results, published), []


def _incomplete(results: Results) -> list[str]:
    """Return an error for each controller without all tasks, seeds and trainings, and for episodes of no set."""
    names = results.names()
    errors = [] if BASELINE in names else ["there are no rows of the baseline control"]
    if not set(names) - {BASELINE}:
        errors.append("there are no rows of a controller besides the baseline control")
    expected = {episode.key: episode for episode in SETS[results.set].episodes(names)}
    errors += [
        f"{name}: {len(absent)} episodes are missing, such as {absent[0]}"
        for name in names
        if (absent := results.missing([name]))
    ]
    others = [episode_of(row) for key, row in results.rows.items() if key not in expected]
    errors += [f"{episode}: no episode of the set {results.set!r}" for episode in others[:_SHOWN]]
    needed = {name_of(episode) for episode in expected.values() if is_prepared(episode.controller)}
    errors += [f"{name}: its training or tuning is missing" for name in sorted(needed - results.trainings.keys())]
    return errors + [f"{name}: its hash is missing" for name in names if not _is_identified(name, results)]


def _is_identified(name: str, results: Results) -> bool:
    return is_prepared(name) or name in results.controllers


def _implausible(results: Results) -> list[str]:
    """Return an error for each row whose terms are not its reward, or whose score is out of range."""
    errors = []
    baselines = {episode_of(row).key[1:5]: row for row in results.rows.values() if row.controller == BASELINE}
    for row in results.sorted_rows():
        episode: Episode = episode_of(row)
        total = sum(row.terms.values())
        if not math.isclose(row.reward, total, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE):
            errors.append(f"{episode}: the terms add up to {total!r}, the reward is {row.reward!r}")
        baseline = baselines.get(episode.key[1:5])
        score = None if baseline is None else relative_reward(row, baseline)
        if score is not None and not _LOWEST <= score <= _HIGHEST:
            errors.append(f"{episode}: a score of {score:g} is out of range ({_LOWEST:g} to {_HIGHEST:g})")
    return errors


def _other_baseline(results: Results, published: Results) -> list[str]:
    """Return an error for each row of the baseline control that is not equal to the published one."""
    rows = [row for row in published.rows.values() if row.controller == BASELINE]
    pairs = [(row, results.rows.get(episode_of(row).key)) for row in rows]
    different = [row for row, own in pairs if own is not None and not row.same(own)]
    return [f"{episode_of(row)}: not the published row of the baseline control" for row in different[:_SHOWN]]


def _draw(results: Results, count: int, seed: int, controllers: Sequence[str]) -> tuple[list[Row], list[str]]:
    """Return rows to run again, and notes on controllers whose rows cannot be drawn."""
    runnable = BASELINES.keys() | set(controllers)
    rows = [row for row in results.sorted_rows() if row.controller in runnable]
    notes = [
        f"{name}: not part of the benchmark, so its rows are run again only if --controllers names it"
        for name in sorted({row.controller for row in results.rows.values()} - runnable)
    ]
    return random.Random(seed).sample(rows, min(count, len(rows))), notes  # noqa: S311  # no secret
