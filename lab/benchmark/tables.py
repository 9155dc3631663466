"""Tables of a benchmark's results."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean

from zenostat.lab.benchmark.definition import BASELINE, BUILDINGS
from zenostat.lab.benchmark.results import Results, episode_of
from zenostat.lab.benchmark.results_file import TERMS, Row
from zenostat.lab.benchmark.scores import Interval, Scores, absent_episodes, compared_rows, relative_linear, score_rows


@dataclass(frozen=True)
class Table:
    """A table of texts, whose first column has the controllers."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """Return the table as Markdown, with the names of controllers as plain text."""
        rows = [(escaped(row[0]), *row[1:]) for row in self.rows]
        lines = [self.columns, ("---", *("---:" for _ in self.columns[1:])), *rows]
        return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def escaped(text: str) -> str:
    """Return a text for a line of Markdown, in which it is no markup and no end of a cell."""
    return re.sub(r"([\\`*\[\]<>&|])", r"\\\1", " ".join(text.split()))


def tables(results: Results) -> list[Table]:
    """Return the scores, the scores by building, means of what they consist of, and the processor time.

    Raises:
        InvalidConfig: see `score_rows`.
    """
    scores = score_rows(results.rows.values())
    linear = {of.controller: of.overall for of in score_rows(results.rows.values(), relative_linear)}
    saved = saved_shares(results.rows.values())
    count = len({episode_of(row).key[1:5] for row in compared_rows(results.rows.values())[BASELINE]})
    head = tuple(
        (
            of.controller,
            f"{of.overall.rows:,}",
            interval_text(of.overall),
            f"{100.0 * saved[of.controller]:.1f}",
            interval_text(linear[of.controller]),
        )
        for of in scores
    )
    has_intervals = not math.isnan(scores[0].overall.low)
    title = f"Scores of the set {results.set}: interquartile means over {count} episodes"
    title += " [95 % interval]" * has_intervals
    if absent := absent_episodes(results.rows.values()):
        others = {episode_of(row).key[1:5] for row in results.rows.values()}
        title += f"; {len(others) - count} more lack rows, such as {absent[0]}"
    return [
        Table(title, ("controller", "rows", "score", "of all costs saved (%)", "score, linear reward"), head),
        _by_building(scores),
        _means(results, scores),
        _times(results, scores),
    ]


def saved_shares(rows: Iterable[Row]) -> dict[str, float]:
    """Return by controller the share of the baseline's costs over all compared episodes that it saves.

    It weighs each episode by its costs and leaves none out, where the score is an interquartile mean of shares.

    Raises:
        InvalidConfig: see `score_rows`.
    """
    means = {name: fmean(row.reward for row in chosen) for name, chosen in compared_rows(rows).items() if chosen}
    baseline = means[BASELINE]
    return {name: (mean - baseline) / abs(baseline) if baseline else math.nan for name, mean in means.items()}


def _by_building(scores: Sequence[Scores]) -> Table:
    buildings = list(scores[0].buildings)
    rows = [
        (of.controller, *(interval_text(of.buildings[name]) for name in buildings))
        for of in scores
    ]  # fmt: skip
    columns = ("controller", *(BUILDINGS.get(name, name) for name in buildings))
    return Table("Scores by building", columns, tuple(rows))


def _means(results: Results, scores: Sequence[Scores]) -> Table:
    compared = compared_rows(results.rows.values())
    lines = []
    for name in (of.controller for of in scores):
        chosen = compared[name]
        terms = [0.0 - fmean(row.terms.get(term, 0.0) for row in chosen) for term in TERMS]
        total = -fmean(row.reward for row in chosen)
        outside = fmean(row.metrics["occupied_outside_kh"] for row in chosen)
        lines.append((name, *(f"{value + 0.0:,.1f}" for value in (total, *terms, outside))))
    columns = (
        "controller", "all (EUR)", "electricity (EUR)", "gas (EUR)", "peak (EUR)", "comfort (EUR)",
        "occupied outside (K h)",
    )  # fmt: skip
    return Table("Means over the episodes, for a week of a building", columns, tuple(lines))


def _times(results: Results, scores: Sequence[Scores]) -> Table:
    lines = []
    for name in (of.controller for of in scores):
        episodes = [row.processor_s for row in results.rows.values() if row.controller == name]
        records = [record for key, record in results.trainings.items() if key.split("/")[0] == name]
        trainings = [record["processor_s"] for record in records if record.get("processor_s") is not None]
        known = [seconds for seconds in episodes if seconds is not None]
        counted = ((known, len(episodes)), (trainings, len(records)))
        total = sum(fmean(times) * count / 3600.0 for times, count in counted if times)
        is_known = all(times or not count for times, count in counted)
        lines.append((
            name, _mean_text(known), str(len(records) or ""), _mean_text(trainings), f"{total:.1f}" if is_known else "",
        ))  # fmt: skip
    columns = ("controller", "an episode (s)", "trainings or tunings", "one of them (s)", "all (h)")
    return Table("Processor time", columns, tuple(lines))


def _mean_text(seconds: Sequence[float]) -> str:
    return f"{fmean(seconds):.1f}" if seconds else ""


def interval_text(interval: Interval, digits: int = 3) -> str:
    """Return an interval as text, with some digits after the point: `0.120 [0.080, 0.150]`."""
    value, low, high = (f"{number:.{digits}f}" for number in (interval.value, interval.low, interval.high))
    return value if math.isnan(interval.low) else f"{value} [{low}, {high}]"
