"""Scores as share of the gap between the baseline control and the bound."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from zenostat.lab.benchmark.bound_file import Bound, Key
from zenostat.lab.benchmark.definition import BASELINE, BUILDINGS
from zenostat.lab.benchmark.results import Results
from zenostat.lab.benchmark.results_file import Row
from zenostat.lab.benchmark.scores import score_rows
from zenostat.lab.benchmark.tables import Table, interval_text, tables
from zenostat.topics.errors import InvalidConfig

BOUND = "bound"


def tables_with_gap(results: Results, bounds: Mapping[Key, Bound] | None) -> list[Table]:
    """Return the tables of results, and that of the shares of the gap if there are bounds.

    Raises:
        InvalidConfig: see `score_rows` and `gap_table`.
    """
    return [*tables(results), *([gap_table(results.rows.values(), bounds)] if bounds else [])]


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
    chosen = [row for row in rows if _key(row) in bounds]
    baseline = {_key(row): row.reward for row in chosen if row.controller == BASELINE}
    gaps = {key for key, reward in baseline.items() if bounds[key].reward > reward}
    if baseline and not gaps:
        raise InvalidConfig("no episode of the results has a bound above the baseline control")
    chosen = [row for row in chosen if _key(row) in gaps] + [_row(bounds[key]) for key in sorted(gaps)]
    shares = score_rows(chosen, lambda row, of: gap_share(row.reward, of.reward, bounds[_key(row)].reward))
    scores = {of.controller: of.overall for of in score_rows(chosen)}
    buildings = list(shares[0].buildings)
    lines = [
        (
            of.controller, interval_text(of.overall), interval_text(scores[of.controller]),
            *(interval_text(of.buildings[name]) for name in buildings),
        )
        for of in shares
    ]  # fmt: skip
    count = next(of.overall.rows for of in shares if of.controller == BOUND)
    title = f"Shares of the gap between baseline control and bound over {count} episodes [95 % interval]"
    if empty := len(baseline) - len(gaps):
        title += f"; {empty} without a gap are left out"
    columns = ("controller", "share of the gap", "score", *(BUILDINGS.get(name, name) for name in buildings))
    return Table(title, columns, tuple(lines))


def _key(row: Row) -> Key:
    return (row.building, row.season, row.weather, row.seed)


def _row(bound: Bound) -> Row:
    return Row(
        controller=BOUND, building=bound.building, season=bound.season, weather=bound.weather, seed=bound.seed,
        reward=bound.reward, terms=bound.terms, linear=bound.linear, metrics={}, training_seed=None, processor_s=0.0,
    )  # fmt: skip
