"""The HTML page of a report: one file that requests nothing from anywhere."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from html import escape
from importlib.metadata import PackageNotFoundError, version
from math import isnan
from typing import Any

import numpy as np

from zenostat.metrics.comfort import band_text
from zenostat.topics.plurals import counted
from zenostat.views.report.district_section import ANCHOR, TITLE, district_section, has_district
from zenostat.views.report.document import REPORT_SCRIPT, document, heading
from zenostat.views.report.figures.base import Figure
from zenostat.views.report.readings import readings
from zenostat.views.report.runs import Comparison, Run
from zenostat.views.report.sections import Section, sections
from zenostat.views.report.summary import summary
from zenostat.views.report.svg import inline_svg
from zenostat.views.report.totals import names, number
from zenostat.views.report.totals_section import NONE, totals_section

_PACKAGES = ("numpy", "gymnasium", "eclipse-zenoh", "pyenergyplus-lbnl", "matplotlib")
_MAX_TABLE_ROWS = 100
_HINT = (
    "Point at a figure over time to read its values; drag to zoom in, double-click or press Escape to zoom out. With "
    "the keyboard: Tab to a figure, arrow keys, + and \N{MINUS SIGN}."
)


def page(comparison: Comparison) -> str:
    """Return the report as an HTML document; the same input gives the same text."""
    parts = sections(comparison)
    heading = _heading(comparison)
    district = [(ANCHOR, TITLE)] if has_district(comparison) else []
    links = [("totals", "Totals"), *district, *((part.anchor, part.title) for part in parts), ("scenario", "Scenario")]
    toc = "".join(f'<li><a href="#{anchor}">{escape(title)}</a></li>' for anchor, title in links)
    body = "".join(
        [
            f'<header>{heading}</header><nav aria-label="Sections"><ul>{toc}</ul></nav><main>',
            f'<p class="note" id="hint" hidden>{escape(_HINT)}</p>',
            _result(comparison),
            totals_section(comparison),
            district_section(comparison),
            *(_section(part) for part in parts),
            _origin(comparison),
            "</main>",
        ]
    )
    return document(_title(comparison), body, REPORT_SCRIPT)


def _title(comparison: Comparison) -> str:
    manifest = comparison.reference.trajectory.manifest
    return f"{manifest.building}: {' and '.join(run.label for run in comparison.runs)}"


def _heading(comparison: Comparison) -> str:
    reference = comparison.reference
    trajectory, manifest = reference.trajectory, reference.trajectory.manifest
    weathers = list(dict.fromkeys(name for name in reference.weather_names if name)) or [manifest.weather]
    place = f"{manifest.location} ({names(weathers)})" if manifest.location else names(weathers)
    comfort = reference.quantities.comfort
    steps = f"{counted(trajectory.steps, 'timestep', ',')} of {_duration(manifest.step_s)}"
    versions = manifest.versions
    rows = [
        ("Weather", place),
        ("Run period", f"{trajectory.begin:%Y-%m-%d %H:%M} to {trajectory.end:%Y-%m-%d %H:%M}, {steps}"),
        ("Comfort band", _band(reference) if comfort is not None else "none"),
        ("Controllers", names([_full_name(run) for run in comparison.runs])),
        ("Episodes", _episodes(comparison)),
        (
            "Versions",
            f"Zenostat {versions.zenostat}" + (f", EnergyPlus {versions.energyplus}" * bool(versions.energyplus)),
        ),
    ]
    return heading(manifest.building, rows)


def _duration(seconds: float) -> str:
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= size and seconds % size == 0:
            return f"{seconds / size:g} {unit}"
    return f"{seconds:g} s"


def _band(run: Run) -> str:
    comfort = run.quantities.comfort
    assert comfort is not None
    bands = np.unique(np.stack([comfort.low.ravel(), comfort.high.ravel()]), axis=1).T.tolist()
    texts = [band_text(low, high) for low, high in bands]
    if len(texts) > 2:
        low, high = (limits[np.isfinite(limits)] for limits in (comfort.low, comfort.high))
        texts = [f"by zone and time, {band_text(low.min(initial=np.inf), high.max(initial=-np.inf))}"]
    text = names(texts)
    return f"{text} ({comfort.source})" if comfort.is_rated else f"{text} (assumed: no reward has a band)"


def _full_name(run: Run) -> str:
    return run.label if run.label == run.name else f"{run.label} ({run.name})"


def _episodes(comparison: Comparison) -> str:
    seeds = [str(seed) for seed in comparison.reference.seeds if seed is not None]
    text = f"{comparison.episodes} each" if len(comparison.runs) > 1 else str(comparison.episodes)
    plural = "s" if len(seeds) > 1 else ""
    shown = f"{seeds[0]} to {seeds[-1]}" if len(seeds) > 3 else names(seeds)
    return f"{text}, seed{plural} {shown}" if seeds else text


def _result(comparison: Comparison) -> str:
    notes = [f"{name} was skipped: {reason}" for name, reason in comparison.unfit.items()]
    paragraphs = [f'<p class="lead">{escape(text)}</p>' for text in summary(comparison)]
    paragraphs += [f'<p class="note">{escape(note)}</p>' for note in notes]
    return f'<section id="result"><h2>Result</h2>{"".join(paragraphs)}</section>'


def _section(section: Section) -> str:
    if section.is_single:
        return f'<section id="{section.anchor}"><h2>{escape(section.title)}</h2>{_figure(section.figures[0])}</section>'
    figures = "".join(f"<h3>{escape(figure.title)}</h3>{_figure(figure)}" for figure in section.figures)
    return f'<section id="{section.anchor}"><h2>{escape(section.title)}</h2>{figures}</section>'


def _figure(figure: Figure) -> str:
    caption = f"<figcaption>{escape(figure.caption)}</figcaption>"
    if figure.drawing is None:
        return f"<figure>{caption}</figure>"
    drawing = inline_svg(figure.drawing, figure.name, figure.title, figure.alt)
    label = escape(figure.title)
    values = readings(figure.drawing)
    block = f'<script type="application/json">{values}</script>' if values else ""
    return (
        f'<figure>{block}<div class="scroll" role="group" tabindex="0" aria-label="{label}">{drawing}</div>'
        f"{caption}</figure>{_numbers(figure)}"
    )


def _numbers(figure: Figure) -> str:
    """Return the data of a figure as a folded table, if there are not too many."""
    columns = list(figure.data.items())
    rows = len(columns[0][1]) if columns else 0
    if not figure.is_tabular or rows > _MAX_TABLE_ROWS:
        return ""
    head = "".join(
        f'<th scope="col"{_number_class(place)}>{escape(name)}</th>' for place, (name, _) in enumerate(columns)
    )
    body = "".join(
        "<tr>" + "".join(_cell(place, column[row]) for place, (_, column) in enumerate(columns)) + "</tr>"
        for row in range(rows)
    )
    return (
        f'<details><summary>Numbers</summary><div class="scroll" role="group" tabindex="0" '
        f'aria-label="{escape(figure.title)}: numbers"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody>'
        "</table></div></details>"
    )


def _number_class(place: int) -> str:
    return ' class="n"' if place else ""


def _cell(place: int, value: Any) -> str:
    text = value if isinstance(value, str) else NONE if isnan(value) else number(float(value))
    return f'<td class="n">{escape(text)}</td>' if place else f'<th scope="row">{escape(str(text))}</th>'


def _origin(comparison: Comparison) -> str:
    manifest = comparison.reference.trajectory.manifest
    versions = [("Zenostat", manifest.versions.zenostat), ("EnergyPlus", manifest.versions.energyplus)]
    versions += [("Python", ".".join(map(str, sys.version_info[:3])))]
    versions += [(name, installed) for name in _PACKAGES if (installed := _version(name))]
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(text)}</td></tr>' for name, text in versions if text
    )
    parts = ['<section id="scenario"><h2>Scenario</h2>']
    if comparison.scenario:
        parts.append(
            f'<details class="print"><summary>Scenario file (YAML)</summary><pre>{escape(comparison.scenario.strip())}'
            "</pre></details>"
        )
    episodes = _episode_table(comparison)
    if episodes:
        parts.append(f"<h3>Episodes</h3>{episodes}")
    if comparison.command:
        parts.append(f"<h3>To run it again</h3><pre>{escape(comparison.command)}</pre>")
    parts.append(
        '<h3>Versions</h3><table class="versions"><thead><tr><th scope="col">Software</th><th scope="col">Version</th>'
        f"</tr></thead><tbody>{rows}</tbody></table></section>"
    )
    return "".join(parts)


def _episode_table(comparison: Comparison) -> str:
    reference = comparison.reference
    if not reference.seeds and not any(reference.weather_names):
        return ""
    rows = "".join(
        f'<tr><th scope="row">{place + 1}</th><td>{_at(reference.seeds, place)}</td>'
        f"<td>{_at(reference.weather_names, place)}</td></tr>"
        for place in range(len(reference.results))
    )
    return (
        '<table class="versions"><thead><tr><th scope="col">Episode</th><th scope="col">Seed</th>'
        f'<th scope="col">Weather</th></tr></thead><tbody>{rows}</tbody></table>'
    )


def _at(values: Sequence[Any], place: int) -> str:
    return escape(str(values[place])) if place < len(values) and values[place] is not None else NONE


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
