"""The report of a calibration: one HTML file that loads nothing, and its figures and its trials as files."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from zenostat.lab.calibration.calibrate import CalibrationResult
from zenostat.lab.calibration.objective import ColumnErrors
from zenostat.metrics.calibration_errors import HOURLY, MONTHLY, FitErrors
from zenostat.topics import VERSION
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.units import unit_label
from zenostat.views.report.document import document, heading
from zenostat.views.report.svg import inline_svg, save

Row = tuple[str, ...]

_NONE = "\N{EN DASH}"


def error_rows(result: CalibrationResult) -> tuple[Row, list[Row]]:
    """Return headings and rows of the table of errors: each column before and after, in training and held out."""
    headings = ("column", "model", "CV(RMSE)", "NMBE", "monthly CV(RMSE)", "monthly NMBE", "within limits")
    rows: list[Row] = []
    for header in [column.header for column in result.data.columns]:
        for name, fit in result.fits.items():
            (errors,) = [each for each in fit.columns if each.header == header]
            rows.append((header, name, *_errors(errors, errors.rows), *_errors(errors, errors.months), _within(errors)))
    return headings, rows


def _errors(errors: ColumnErrors, each: FitErrors | None) -> tuple[str, str]:
    if each is None or math.isnan(each.rmse):
        return _NONE, _NONE
    if errors.is_absolute:
        unit = "K" if errors.unit == "degC" else errors.unit
        return f"{each.rmse:.2f} {unit}", f"{each.mbe:+.2f} {unit}"
    return f"{each.cv_rmse_percent:.1f} %", f"{each.nmbe_percent:+.1f} %"


def _within(errors: ColumnErrors) -> str:
    named = (("hourly", errors.is_hourly_within), ("monthly", errors.is_monthly_within))
    parts = [f"{name}: {'yes' if value else 'no'}" for name, value in named if value is not None]
    return ", ".join(parts) or "no limits"


def parameter_rows(result: CalibrationResult) -> tuple[Row, list[Row]]:
    """Return headings and rows of the table of parameters."""
    has_truth = any(parameter.truth is not None for parameter in result.config.parameters.values())
    headings = ("parameter", "value", *(("truth",) if has_truth else ()), "from", "to", "share of range", "verdict")
    rows: list[Row] = []
    for each in result.parameters:
        truth = result.config.parameters[each.name].truth
        shown = (_number(truth) if truth is not None else _NONE,) if has_truth else ()
        cells = (_number(each.value), *shown, _number(each.low), _number(each.high), f"{100 * each.share:.0f} %")
        rows.append((each.name, *cells, each.verdict))
    return headings, rows


def _number(value: float) -> str:
    return f"{value:.4g}"


def write_report(
    result: CalibrationResult,
    texts: Mapping[str, tuple[str, str]],
    model: str,
    measured: str,
    weather: str,
    command: str,
) -> list[Path]:
    """Write `report.html`, `trials.csv` and the figures of a calibration into its folder; return their paths.

    Args:
        result: the calibration.
        texts: unit of each parameter, and what it changes.
        model: name of the model.
        measured: name of the file with measured data.
        weather: name of the weather file.
        command: the command line.
    """
    from zenostat.lab.calibration.report_figures import figures

    folder = result.config.folder
    drawn = figures(result, {name: unit for name, (unit, _) in texts.items()})
    files = [save(figure, folder, name)[1] for name, (_, _, figure) in drawn.items()]
    facts = [
        ("Model", model), ("Measured data", measured), ("Weather", weather),
        ("Training", _days(result.config.periods)), ("Held out", _days(result.config.held_out)),
        ("Trials", ", ".join(f"{count} {state}" for state, count in result.states.items())),
        ("Sampler", f"{result.config.sampler}, seed {result.config.seed}, batches of {result.config.batch_size}"),
        ("Version", f"Zenostat {VERSION}"),
    ]  # fmt: skip
    path = folder / "report.html"
    with atomic_file(path) as temporary:
        temporary.write_text(_page(result, texts, facts, drawn, command), encoding="utf-8")
    return [path, _write_trials(result), *files]


def _write_trials(result: CalibrationResult) -> Path:
    """Write `trials.csv` with state, error, values and the reason of its end of each trial; return its path."""
    path, names = result.config.folder / "trials.csv", list(result.config.parameters)
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["trial", "state", "error", *names, "reason"])
        for trial in result.ended:
            error = trial.error if trial.is_complete else ""
            values = [trial.values[name] for name in names]
            writer.writerow([trial.number, trial.result["state"], error, *values, trial.result.get("reason", "")])
    return path


def _days(periods: Sequence[tuple[Any, Any]]) -> str:
    return ", ".join(f"{first} to {last}" for first, last in periods)


def _page(
    result: CalibrationResult, texts: Mapping[str, tuple[str, str]], facts: Sequence[tuple[str, str]],
    drawn: Mapping[str, tuple[str, str, Any]], command: str,
) -> str:  # fmt: skip
    title = f"Calibration of {facts[0][1]}"
    parts = [f"<header>{heading(title, facts)}</header><main>"]
    parts += [f'<p class="lead">{escape(text)}</p>' for text in summary(result)]
    errors = _table(*error_rows(result), numbers=range(2, 6))
    parts.append(f"<section><h2>Errors</h2>{errors}<p class='note'>{escape(_ERRORS)}</p></section>")
    parts.append(f"<section><h2>Curves</h2>{_figures(drawn, 'curves')}</section>")
    parameters = _table(*parameter_rows(result), numbers=range(1, len(parameter_rows(result)[0]) - 1))
    note = _PARAMETERS.format(margin=f"{result.config.margin:g}", share=f"{100 * result.config.determined:g}")
    parts.append(f"<section><h2>Parameters</h2>{parameters}<p class='note'>{escape(note)}</p>")
    changes = [(name, unit_label(unit) or "factor", _range(result, name), text) for name, (unit, text) in texts.items()]
    parts.append(f"<h3>What they change</h3>{_table(('parameter', 'unit', 'range', 'edits'), changes)}")
    parts.append(f"{_figures(drawn, 'profile')}<h3>Correlations</h3>{_correlations(result)}</section>")
    parts.append(f"<section><h2>To run it again</h2><pre>{escape(command)}</pre></section></main>")
    return document(title, "".join(parts), "")


_ERRORS = (
    "NMBE = sum(m - s) / ((n - p) mean(m)) and CV(RMSE) = sqrt(sum((m - s)^2) / (n - p)) / mean(m), with measured m, "
    "simulated s and p = 1 unless set otherwise; limits of ASHRAE Guideline 14: hourly "
    f"{HOURLY.cv_rmse_percent:g} % and {HOURLY.nmbe_percent:g} %, monthly {MONTHLY.cv_rmse_percent:g} % and "
    f"{MONTHLY.nmbe_percent:g} %. Monthly errors are those of calendar months as far as these are measured. A "
    "temperature has RMSE and mean bias in its unit, and no limits."
)
_PARAMETERS = (
    "From and to join the values of all trials whose error is at most the lowest one times 1 + {margin}, and the 95 % "
    "confidence interval of a linear regression around the best values. A parameter is determined if that is at most "
    "{share} % of its range."
)


def _range(result: CalibrationResult, name: str) -> str:
    low, high = result.config.parameters[name].ends
    return f"{low:g} to {high:g}{' (log)' if result.config.parameters[name].log else ''}"


def _change(before: float, after: float) -> str:
    if after == before:
        return f"stayed at {before:.3g}"
    return f"{'fell' if after < before else 'rose'} from {before:.3g} to {after:.3g}"


def summary(result: CalibrationResult) -> list[str]:
    """Return the result in sentences."""
    before, after = result.fits["before"], result.fits["after"]
    texts = [f"The error {_change(before.error, after.error)}; 1 is at the guideline's limits."]
    if "held-out after" in result.fits:
        first, last = (result.fits[f"held-out {name}"].error for name in ("before", "after"))
        if math.isnan(first) or math.isnan(last):
            text = "has no defined error: too few values, or a mean of zero"
        else:
            text = f"the error {_change(first, last)}"
        texts.append(f"On days that the calibration has not seen, {text}.")
        if last > first:
            advice = "the model is fitted to its training days alone. Use fewer parameters or more data."
            texts[-1] = f"{texts[-1][:-1]}: {advice}"
    unknown = [each.name for each in result.parameters if not each.is_determined]
    if unknown:
        texts.append(f"The data do not determine {', '.join(unknown)}: other values fit nearly as well.")
    ends = [each.name for each in result.parameters if each.is_at_end]
    if ends:
        texts.append(f"At an end of the range: {', '.join(ends)}. Check the range, and what the model may lack.")
    return texts


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(f"<{tag}{_look(place, numbers)}>{escape(text)}</{tag}>" for place, text in enumerate(row))

    head, body = cells("th", columns), "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<div class="scroll" tabindex="0"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _look(place: int, numbers: Sequence[int]) -> str:
    if place in numbers:
        return ' class="n"'
    return ' style="padding-left:18px"' if place - 1 in numbers else ""


def _correlations(result: CalibrationResult) -> str:
    names = [each.name for each in result.parameters]
    rows = [
        (each.name, *("1" if name == each.name else f"{each.correlations[name]:+.2f}" for name in names))
        for each in result.parameters
    ]
    return _table(("", *names), rows, numbers=range(1, len(names) + 1))


def _figures(drawn: Mapping[str, tuple[str, str, Any]], beginning: str) -> str:
    return "".join(
        f"<figure>{inline_svg(figure, name, title, caption)}<figcaption>{escape(caption)}</figcaption></figure>"
        for name, (title, caption, figure) in drawn.items()
        if name.startswith(beginning)
    )
