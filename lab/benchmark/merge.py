"""Merge results of one set that were made in parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from zenostat.lab.benchmark.definition import BASELINE
from zenostat.lab.benchmark.results import Results, changed_versions, episode_of, load_results
from zenostat.lab.benchmark.run import same_controller
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean


def merge_results(paths: Sequence[Path]) -> Results:
    """Return the rows of all files, which have the same set, versions and hashes.

    Raises:
        InvalidConfig: files contradict each other, such as two rows of an episode that are not equal to the bit.
    """
    parts = [(path, load_results(path)) for path in dict.fromkeys(paths)]
    for (path, results), (other_path, others) in combinations(parts, 2):
        _check_agreement(results, others, path, other_path)
    merged = parts[0][1]
    for _, results in parts[1:]:
        merged.versions = results.versions | merged.versions
        merged.hashes |= results.hashes
        merged.controllers |= results.controllers
        merged.trainings = results.trainings | merged.trainings
        merged.rows = results.rows | merged.rows
    return merged


def _check_agreement(results: Results, others: Results, path: Path, other_path: Path) -> None:
    what = f"{other_path} and {path}"
    if others.set != results.set:
        raise InvalidConfig(f"{what} have results of the sets {others.set!r} and {results.set!r}")
    if changes := changed_versions(others.versions, results.versions):
        raise InvalidConfig(f"{what} have rows of different versions: {'; '.join(changes)}")
    _check_equal(results.hashes, others.hashes, f"{what} have rows of different files")
    _check_equal(results.identities(), others.identities(), f"{what} have rows of different versions of")
    for name in results.trainings.keys() & others.trainings:
        if not same_controller(results.trainings[name], others.trainings[name]):
            raise InvalidConfig(f"{what} have different trainings {name}")
    for key in results.rows.keys() & others.rows:
        if not results.rows[key].same(others.rows[key]):
            raise InvalidConfig(f"{what} have different rows of {episode_of(others.rows[key])}")


def _check_equal(known: Mapping[str, Any], now: Mapping[str, Any], text: str) -> None:
    differing = sorted(name for name in known.keys() & now if known[name] != now[name])
    if differing:
        raise InvalidConfig(f"{text} {differing[0]}")


def with_controllers(results: Results, names: Sequence[str], what: str) -> Results:
    """Return the results with only the rows of the named controllers and of the baseline control.

    Raises:
        UnknownName: there are no rows of one of them.
    """
    known = sorted(results.names())
    if unknown := [name for name in names if name not in known]:
        raise UnknownName(f"{what} has no rows of {unknown[0]!r}; {did_you_mean(unknown[0], known, limit=len(known))}")
    rows = [row for row in results.rows.values() if row.controller in {BASELINE, *names}]
    chosen = Results(
        results.set, hashes=results.hashes, trainings=results.trainings, controllers=results.controllers,
        versions=results.versions,
    )  # fmt: skip
    chosen.add(rows)
    return chosen
