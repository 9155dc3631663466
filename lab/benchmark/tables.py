"""Tables of a benchmark's results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from zenostat.lab.benchmark.definition import BUILDINGS
from zenostat.lab.benchmark.results import Results
from zenostat.lab.benchmark.scores import Interval, Scores, score_rows


@dataclass(frozen=True)
class Table:
    """A table of texts, whose first column has the controllers."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """Return the table as Markdown."""
        lines = [self.columns, ("---", *("---:" for _ in self.columns[1:])), *self.rows]
        return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def tables(results: Results) -> list[Table]:
    """Return the scores, the scores by building, and means of what they consist of.

    Raises:
        InvalidConfig: see `score_rows`.
    """
    scores = score_rows(results.rows.values())
    linear = {of.controller: of.overall for of in score_rows(results.rows.values(), "linear")}
    count = scores[0].overall.rows
    head = tuple(
        (of.controller, interval_text(of.overall), interval_text(linear[of.controller]))
        for of in scores
    )  # fmt: skip
    title = f"Scores of the set {results.set}: interquartile means over {count} episodes [95 % interval]"
    return [
        Table(title, ("controller", "score", "score, linear reward"), head),
        _by_building(scores),
        _means(results, scores),
    ]


def _by_building(scores: Sequence[Scores]) -> Table:
    buildings = list(scores[0].buildings)
    rows = [
        (of.controller, *(interval_text(of.buildings[name]) for name in buildings))
        for of in scores
    ]  # fmt: skip
    columns = ("controller", *(BUILDINGS.get(name, name) for name in buildings))
    return Table("Scores by building", columns, tuple(rows))


def _means(results: Results, scores: Sequence[Scores]) -> Table:
    by_name = {
        of.controller: [row for row in results.rows.values() if row.controller == of.controller] for of in scores
    }
    shared = set.intersection(*({row.key[1:] for row in rows} for rows in by_name.values()))
    lines = []
    for name, rows in by_name.items():
        chosen = [row for row in rows if row.key[1:] in shared]
        terms = [0.0 - fmean(row.terms.get(term, 0.0) for row in chosen) for term in ("cost", "gas", "peak", "comfort")]
        total = -fmean(row.reward for row in chosen)
        outside = fmean(row.metrics["occupied_outside_kh"] for row in chosen)
        lines.append((name, *(f"{value + 0.0:,.1f}" for value in (total, *terms, outside))))
    columns = (
        "controller", "all (EUR)", "electricity (EUR)", "gas (EUR)", "peak (EUR)", "comfort (EUR)",
        "occupied outside (K h)",
    )  # fmt: skip
    return Table("Means over the episodes, for a week of a building", columns, tuple(lines))


def interval_text(interval: Interval) -> str:
    """Return an interval as text: `0.12 [0.08, 0.15]`."""
    if math.isnan(interval.low):
        return f"{interval.value:.3f}"
    return f"{interval.value:.3f} [{interval.low:.3f}, {interval.high:.3f}]"
