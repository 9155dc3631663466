"""The section of totals and key performance indicators of a page."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from zenostat.views.report.document import note_block
from zenostat.views.report.runs import Comparison
from zenostat.views.report.sections import not_measured
from zenostat.views.report.totals import Difference, Metric, difference, kpis, metrics, names, number, signed, total

MINUS, NONE = "\N{MINUS SIGN}", "\N{EN DASH}"
_MARKS = {"better": "\N{CHECK MARK}", "worse": "\N{BALLOT X}"}


def totals_section(comparison: Comparison) -> str:
    """Return the totals, the KPIs, and what they are derived from, as HTML."""
    rows, indicators = metrics(comparison), kpis(comparison)
    notes = [*_notes_on_episodes(comparison, rows)]
    if not _has_difference_columns(comparison):
        notes.insert(0, f"Below each number: its difference to {comparison.reference.label}.")
    missing = not_measured(comparison)
    if missing:
        notes.append(f"Not measured: {names(missing)}.")
    notes += _sources(comparison, rows)
    parts = [_table(comparison, rows, "Totals"), note_block(notes)]
    if indicators:
        parts.append('<h3 id="kpis">Key performance indicators, as BOPTEST defines them</h3>')
        parts += [
            _table(comparison, indicators, "Key performance indicators"),
            note_block(_sources(comparison, indicators)),
        ]
    return f'<section id="totals"><h2>Totals</h2>{"".join(parts)}</section>'


def _notes_on_episodes(comparison: Comparison, rows: Sequence[Metric]) -> list[str]:
    if comparison.episodes == 1:
        return []
    summaries = [total(comparison.reference, metric.key) for metric in rows]
    has_interval = any(summary is not None and summary.interval is not None for summary in summaries)
    text = (
        " \N{PLUS-MINUS SIGN} half the 95 % confidence interval (Student's t). Differences are those of the same "
        "episodes, and unclear where their interval contains zero."
    )
    return [
        f"Means over {comparison.episodes} episodes{text if has_interval else '; intervals need SciPy.'}",
        "All figures show the first episode.",
    ]


def _sources(comparison: Comparison, rows: Sequence[Metric]) -> list[str]:
    by_source: dict[str, list[str]] = {}
    for metric in rows:
        if metric.key in comparison.sources:
            label = metric.label.removeprefix("of which ")
            by_source.setdefault(comparison.sources[metric.key], []).append(label)
    sources = "; ".join(f"{', '.join(labels)}: {source}" for source, labels in by_source.items())
    return [f"Sources: {sources}."] if sources else []


def _table(comparison: Comparison, rows: Sequence[Metric], title: str) -> str:
    reference, others = comparison.reference, comparison.runs[1:]
    head = "".join(f'<th scope="col" class="n">{escape(run.label)}</th>' for run in comparison.runs)
    if _has_difference_columns(comparison):
        head += "".join(
            f'<th scope="colgroup" colspan="2" class="n">{escape(run.label)} {MINUS} {escape(reference.label)}</th>'
            for run in others
        )
    body = "".join(
        _row(comparison, metric) + (_peak_times(comparison) if metric.key == "peak_kw" else "") for metric in rows
    )
    return (
        f'<div class="scroll" role="group" aria-label="{escape(title)}" tabindex="0"><table class="totals">'
        f'<thead><tr><th scope="col">Quantity</th>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _row(comparison: Comparison, metric: Metric) -> str:
    cells = []
    is_wide = _has_difference_columns(comparison)
    for place, run in enumerate(comparison.runs):
        amount = total(run, metric.key)
        text = NONE if amount is None else number(amount.mean)
        if amount is not None and amount.half_width is not None:
            text += f" ± {number(amount.half_width)}"
        if place and not is_wide:
            text += _difference_line(difference(run, comparison.reference, metric))
        cells.append(f'<td class="n">{text}</td>')
    if is_wide:
        cells += [_difference_cells(difference(run, comparison.reference, metric)) for run in comparison.runs[1:]]
    unit = f' <span class="unit">{escape(metric.unit)}</span>' if metric.unit else ""
    label_class = ' class="part"' if metric.is_part else ""
    head = f'<th scope="row"{label_class}>{escape(metric.label)}{unit}</th>'
    return f'<tr data-metric="{escape(metric.key)}">{head}{"".join(cells)}</tr>'


def _peak_times(comparison: Comparison) -> str:
    """Return a row with the time of the peak of each controller's first episode."""
    times = [run.quantities.peak_time for run in comparison.runs]
    if not any(times):
        return ""
    cells = "".join(f'<td class="n">{NONE if time is None else f"{time:%d %b %H:%M}"}</td>' for time in times)
    empty = "<td></td>" * (2 * (len(comparison.runs) - 1) * _has_difference_columns(comparison))
    where = ", first episode" if comparison.episodes > 1 else ""
    head = f'<th scope="row" class="part">at (end of the timestep{where})</th>'
    return f'<tr data-metric="peak_time">{head}{cells}{empty}</tr>'


def _has_difference_columns(comparison: Comparison) -> bool:
    """Whether differences have columns of their own; of several controllers they stand below the numbers, to fit."""
    return len(comparison.runs) <= 2


def _difference_cells(change: Difference | None) -> str:
    if change is None:
        return f'<td class="n">{NONE}</td><td></td>'
    amount, percent, verdict = _difference_texts(change)
    return f'<td class="n d">{amount}</td><td class="n p">{percent} {verdict}</td>'


def _difference_line(change: Difference | None) -> str:
    if change is None:
        return ""
    amount, percent, verdict = _difference_texts(change)
    return f'<span class="d">{amount}</span><span class="d">{percent} {verdict}</span>'


def _difference_texts(change: Difference) -> tuple[str, str, str]:
    """Return the difference, the same in percent, and its verdict, as HTML."""
    amount = signed(change.mean)
    if change.half_width is not None:
        amount += f" ± {number(change.half_width)}"
    percent = "" if change.percent is None else f"{signed(change.percent, 1)} %"
    mark = _MARKS.get(change.verdict, "")
    verdict = f'<span class="v {change.verdict}">{mark} {change.verdict}</span>' if change.verdict else ""
    return amount, percent, verdict
