"""Scores as share of the gap between the baseline control and the bound."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from zenostat.lab.benchmark.bound_file import Bound, Key
from zenostat.lab.benchmark.definition import BASELINE, BUILDINGS
from zenostat.lab.benchmark.results import Results, changed_versions
from zenostat.lab.benchmark.results_file import Row
from zenostat.lab.benchmark.scores import compared_rows, score_rows
from zenostat.lab.benchmark.tables import Table, interval_text, tables
from zenostat.topics.errors import InvalidConfig

BOUND = "bound"


def tables_with_gap(results: Results, bounds: Mapping[Key, Bound] | None) -> Iterator[Table]:
    """Yield the tables of results, and that of the shares of the gap if there are bounds.

    Raises:
        InvalidConfig: see `score_rows` and `gap_table`; or the rows and the bound of an episode were made with other
            versions or files.
    """
    yield from tables(results)
    if bounds:
        for key in sorted({_key(row) for row in results.rows.values()} & bounds.keys()):
            bound = bounds[key]
            changes = changed_versions(bound.versions, results.versions) + bound.changed_files(results.hashes)
            if changes:
                raise InvalidConfig(
                    f"the rows of {bound} cannot be compared with its bound, which was made with "
                    f"something else: {'; '.join(changes)}"
                )
        yield gap_table(results.rows.values(), bounds)


def gap_share(reward: float, baseline: float, bound: float) -> float | None:
    """Return (reward - baseline) / (bound - baseline): 0 as the baseline control, 1 as the bound, above it if better.

    Returns:
        None where the bound does not exceed the baseline: the gap is empty, and no controller has a share of it.
    """
    return (reward - baseline) / (bound - baseline) if bound > baseline else None


def gap_table(rows: Iterable[Row], bounds: Mapping[Key, Bound]) -> Table:
    """Return the shares of the gap of all controllers, the best first, over the episodes that have a bound.

    Only episodes that all controllers have, and in which the bound exceeds the baseline control, are compared.

    Args:
        rows: rows of a set, with those of the baseline control.
        bounds: bounds of the same set.

    Raises:
        InvalidConfig: there are no rows of the baseline control, or no episode of all controllers has such a bound.
    """
    rows = list(rows)
    if not any(row.controller == BASELINE for row in rows):
        raise InvalidConfig(f"shares of a gap begin at the baseline control: run the controller {BASELINE!r} too")
    baselines = {_key(row): row for row in rows if row.controller == BASELINE and _key(row) in bounds}
    usable = {key for key, row in baselines.items() if gap_share(0.0, row.reward, bounds[key].reward) is not None}
    compared = compared_rows(row for row in rows if _key(row) in baselines)
    shared = {_key(row) for row in compared.get(BASELINE, ())}
    chosen = [row for of_controller in compared.values() for row in of_controller if _key(row) in usable]
    if not chosen:
        raise InvalidConfig("no episode of all controllers has a bound above the baseline control")
    reached = [
        replace(row, controller=BOUND, reward=bounds[_key(row)].reward) for row in chosen if row.controller == BASELINE
    ]

    def share(row: Row, baseline: Row) -> float | None:
        return gap_share(row.reward, baseline.reward, bounds[_key(row)].reward)

    scores = {of.controller: of.overall for of in score_rows([*chosen, *reached])}
    lines = []
    shares = score_rows([*chosen, *reached], share)
    for of in shares:
        intervals = [of.overall, scores[of.controller], *of.buildings.values()]
        lines.append((of.controller, *map(interval_text, intervals)))
    count = len({_key(row) for row in compared_rows(rows)[BASELINE]})
    title = f"Shares of the gap between baseline control and bound over {len(reached)} of {count} episodes"
    if len(shared) < count:
        title += f"; {count - len(shared)} have no bound"
    if empty := len(shared - usable):
        title += f"; {empty} without a gap are left out"
    columns = ("controller", "share of the gap", "score", *(BUILDINGS.get(name, name) for name in shares[0].buildings))
    return Table(title, columns, tuple(lines))


def _key(row: Row) -> Key:
    return (row.building, row.season, row.weather, row.seed)
