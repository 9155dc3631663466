"""Numbers of the benchmark in docs, from its results; `python tests/support/benchmark_page.py` writes them."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from zenostat.lab.benchmark import VERSION, Results, gap_table, load_bounds, load_results, score_rows
from zenostat.lab.benchmark.definition import BUILDINGS
from zenostat.lab.benchmark.figures import write_figures
from zenostat.lab.benchmark.merge import with_controllers
from zenostat.lab.benchmark.run import same_controller
from zenostat.lab.benchmark.scores import Interval, Scores, differences
from zenostat.lab.benchmark.tables import Table, interval_text, saved_shares, tables
from zenostat.views.report.figures.base import draw
from zenostat.views.report.svg import save
from zenostat.views.report.theme import LIGHT

_FINE = 4
"""Digits after the point of differences of scores."""
_PANELS = 3
"""Learning curves beside each other."""
_COMPARED = ("tuned", "ppo", "sac", "oracle")
PAGE = Path(__file__).parents[2] / "docs" / "benchmark.md"
PLANNING = PAGE.with_name("mpc.md")
FOLDER = PAGE.with_suffix("")
PUBLISHED = {name: FOLDER / f"{name}-{VERSION}.json" for name in ("full", "quick", "smoke")}
BOUNDS = FOLDER / f"bounds-{VERSION}"
_MISSING = "There are no published rows of version {version} yet."
_FIGURES = ("![Scores of each controller](benchmark/scores.svg)", "![Scores by building](benchmark/buildings.svg)")
_CURVES = "![Evaluations of each training on the training weather; points: before the first step](benchmark/curves.svg)"


def published(name: str) -> Results | None:
    """Return the published results of a set; None if there are none."""
    return load_results(PUBLISHED[name]) if PUBLISHED[name].is_file() else None


def add_times(results: Results, others: Results) -> None:
    """Add the processor times of trainings and tunings that were made for another set and used again."""
    for key, record in results.trainings.items():
        other = others.trainings.get(key)
        if record.get("processor_s") is None and other is not None and same_controller(record, other):
            record["processor_s"] = other.get("processor_s")


def complete(results: Results) -> Results:
    """Return the results without the rows of controllers that do not have all episodes of the set."""
    return with_controllers(results, [name for name in results.names() if not results.missing([name])], results.set)


def page(text: str) -> str:
    """Return a page with its results replaced."""
    full, quick, smoke = (published(name) for name in PUBLISHED)
    text = _replace(text, "results", _results(full))
    text = _replace(text, "quick", _results(quick, figures=full is None))
    text = _replace(text, "savings", _or_missing(quick, _savings))
    return _replace(text, "smoke", _or_missing(smoke, lambda results: tables(complete(results))[0].markdown()))


def _or_missing(results: Results | None, content: object) -> str:
    assert callable(content)
    return _MISSING.format(version=VERSION) if results is None else str(content(results))


def _results(results: Results | None, *, figures: bool = True) -> str:
    if results is None:
        return _MISSING.format(version=VERSION)
    shown = complete(results)
    scores = score_rows(shown.rows.values())
    parts = [_claims(scores)]
    for table, figure in zip(tables(shown), (*_FIGURES, "", ""), strict=True):
        parts += [f"**{table.title}**", table.markdown(), figure if figures else ""]
    if bounds := load_bounds(BOUNDS, results.set) if BOUNDS.is_dir() else {}:
        gap = gap_table(shown.rows.values(), bounds)
        parts += [f"**{gap.title}**", gap.markdown()]
    if (learned := _learned(scores)) is not None:
        parts += [f"**{learned.title}**", learned.markdown()]
    if (kept := _kept_steps(results)) is not None:
        parts.append(kept)
    if figures and any(record.get("curve") for record in results.trainings.values()):
        parts.append(_CURVES)
    if (unfinished := _unfinished(results)) is not None:
        parts += [f"**{unfinished.title}**", unfinished.markdown()]
    for name in results.names():
        if absent := results.missing([name]):
            count = len([row for row in results.rows.values() if row.controller == name])
            parts.append(f"`{name}` has {count:,} of {count + len(absent):,} rows so far and is not in the tables.")
    parts.append("Made with " + ", ".join(f"{name} {version}" for name, version in results.versions.items()) + ".")
    return "\n\n".join(filter(None, parts))


def _unfinished(results: Results) -> Table | None:
    """Return the scores by building of controllers that have all episodes of some buildings only; None without any."""
    cells: dict[str, dict[str, str]] = {}
    for name in results.names():
        absent = {episode.task.building for episode in results.missing([name])}
        for building in BUILDINGS.keys() - absent if absent else ():
            rows = [row for row in results.rows.values() if row.building == building]
            scores = score_rows(row for row in rows if row.controller in {name, "baseline"})
            by_name = {of.controller: of.overall for of in scores}
            cells.setdefault(name, {})[building] = interval_text(by_name[name])
    if {"tuned", "ppo"} <= cells.keys():
        for building in cells["tuned"].keys() & cells["ppo"]:
            rows = [row for row in results.rows.values() if row.building == building]
            scores = score_rows(row for row in rows if row.controller in {"baseline", "tuned", "ppo"})
            of_name = {of.controller: of for of in scores}
            difference, _ = differences(of_name["ppo"], of_name["tuned"])
            cells.setdefault("ppo minus tuned", {})[building] = interval_text(difference, _FINE)
    lines = [(name, *(of.get(building, "") for building in BUILDINGS)) for name, of in cells.items()]
    title = "Scores of controllers that have all episodes of some buildings only"
    return Table(title, ("controller", *BUILDINGS.values()), tuple(lines)) if lines else None


def _claims(scores: Sequence[Scores]) -> str:
    """Return what the intervals say about each controller."""
    if math.isnan(scores[0].overall.low):
        return "There are no intervals: they need at least three weather files and three seeds."
    groups: dict[str, list[str]] = {"above": [], "below": [], "open": []}
    for of in scores:
        if of.controller != "baseline":
            groups[_side(of.overall)].append(f"`{of.controller}` ({of.overall.value:.3f})")
    sentences = [
        f"{title}: {', '.join(groups[side])}."
        for side, title in (
            ("above", "Better than the baseline control, with the whole interval"),
            ("below", "Worse, with the whole interval"),
            ("open", "Neither, since the interval contains 0"),
        )
        if groups[side]
    ]
    return " ".join(sentences)


def _kept_steps(results: Results) -> str | None:
    """Return at which steps the best evaluations of the trainings are, whose policies are kept; None without any."""
    curves = [record["evaluations"] for record in results.trainings.values() if record.get("evaluations")]
    if not curves:
        return None
    best = [curve["steps"][curve["rewards"].index(max(curve["rewards"]))] for curve in curves]
    counts = ", ".join(f"{best.count(step)} at {step:,}" for step in sorted(set(best)))
    return (
        f"Steps at which the policies of the {len(best)} trainings are kept, those of the best evaluation: {counts}. A "
        "policy of step 0 has learnt nothing: it is the tuned rule with the small offsets of an untrained network."
    )


def _side(interval: Interval) -> str:
    return "above" if interval.low > 0.0 else "below" if interval.high < 0.0 else "open"


def _learned(scores: Sequence[Scores]) -> Table | None:
    """Return how much better learned controllers and planning are than the tuned rule, by building; None without."""
    by_name = {of.controller: of for of in scores}
    names = [name for name in ("ppo", "sac", "oracle") if name in by_name]
    if not names or "tuned" not in by_name:
        return None
    rows, buildings = [], list(by_name["tuned"].buildings)
    has_intervals = not math.isnan(by_name["tuned"].overall.low)
    for name in names:
        overall, of_building = differences(by_name[name], by_name["tuned"])
        sides = [_side(of_building[building]) for building in buildings]
        cells = [interval_text(of_building[building], _FINE) for building in buildings]
        counts = (f"{sides.count('above')} and {sides.count('below')} of {len(buildings)}",)
        rows.append((name, interval_text(overall, _FINE), *cells, *(counts if has_intervals else ())))
    counted = ("buildings above and below 0, with the whole interval",) if has_intervals else ()
    columns = ("controller", "all", *(BUILDINGS.get(name, name) for name in buildings), *counted)
    return Table("Scores minus those of `tuned` in the same episodes", columns, tuple(rows))


def has_oracle(results: Results) -> bool:
    """Return whether results have all rows of the oracle and of the rule that it is compared with."""
    return {"oracle", "rbc"} <= set(complete(results).names())


def planning_page(text: str) -> str:
    """Return the page about planning with what the oracle is worth in the largest set that has its rows."""
    results = next((of for of in map(published, PUBLISHED) if of is not None and has_oracle(of)), None)
    if results is None:
        return _replace(text, "planning", "The [benchmark](benchmark.md) has a table with the oracle's scores.")
    saved = saved_shares(complete(results).rows.values())
    sentence = (
        f"In the set {results.set} of the [benchmark](benchmark.md), whose reward has a tariff, a demand charge and "
        f"occupied comfort, the oracle costs {_more_or_less(saved['oracle'])} than the baseline control, and `rbc` "
        f"{_more_or_less(saved['rbc'])}."
    )
    return _replace(text, "planning", sentence)


def _more_or_less(saved: float) -> str:
    return f"{100.0 * abs(saved):.0f} % {'less' if saved >= 0.0 else 'more'}"


def _savings(results: Results) -> str:
    """Return a table of what some controllers save by building, in EUR a week."""
    names = [name for name in _COMPARED if name in complete(results).names()]
    columns = ["building", *(f"{name}, {what}" for name in names for what in ("energy", "comfort"))]
    lines = [columns, ["---", *("---:" for _ in columns[1:])]]
    for building, title in BUILDINGS.items():
        cells = [title]
        for name in names:
            cells += [
                f"{_saved(results, name, building, terms):.0f}" for terms in (("cost", "gas", "peak"), ("comfort",))
            ]
        lines.append(cells)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _saved(results: Results, name: str, building: str, terms: Sequence[str]) -> float:
    rows = [row for row in results.rows.values() if (row.controller, row.building) == (name, building)]
    before = [results.rows["baseline", row.building, row.season, row.weather, row.seed, -1] for row in rows]
    saved = fmean(
        sum(now.terms.get(term, 0.0) - then.terms.get(term, 0.0) for term in terms)
        for now, then in zip(rows, before, strict=True)
    )
    return round(saved) + 0.0


def _replace(text: str, part: str, content: str) -> str:
    begin, end = f"<!-- made: {part} -->", f"<!-- end: {part} -->"
    before, _, rest = text.partition(begin)
    return f"{before}{begin}\n\n{content}\n\n{end}{rest.partition(end)[2]}"


def write_curves(results: Results, folder: Path) -> Path | None:
    """Write the learning curves as `curves` (SVG and PNG); return the PNG file, or None without trainings."""
    records = {tuple(name.split("/")): record for name, record in results.trainings.items()}
    panels = sorted({key[1:3] for key, record in records.items() if record.get("curve")})
    if not panels:
        return None
    rows = math.ceil(len(panels) / _PANELS)
    folder.mkdir(parents=True, exist_ok=True)
    return save(
        draw("curves", 0.3 + 1.5 * rows, lambda figure: _fill_curves(figure, panels, records)), folder, "curves"
    )[1]


def curve_of(record: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the learning curve of a training: its evaluations, or without any the rewards of its training episodes."""
    return record.get("evaluations") or record.get("curve") or {"steps": [], "rewards": []}


def _fill_curves(figure: Any, panels: Sequence[tuple[str, ...]], records: Mapping[tuple[str, ...], Any]) -> None:
    from matplotlib.lines import Line2D  # of an extra

    columns = min(len(panels), _PANELS)
    axes = figure.subplots(math.ceil(len(panels) / columns), columns, squeeze=False).ravel()
    algorithms = sorted({key[0] for key, record in records.items() if record.get("curve")})
    for axis, panel in zip(axes, panels, strict=False):
        for number, algorithm in enumerate(algorithms, 1):
            curves = [curve_of(of) for key, of in records.items() if key[:3] == (algorithm, *panel) and of.get("curve")]
            color = LIGHT[f"series-{number}"]
            for curve in curves:
                axis.plot(curve["steps"], curve["rewards"], color=color, linewidth=0.8)
                if curve["steps"][:1] == [0]:  # evaluations, in the same episodes
                    axis.plot([0], [curve["rewards"][0]], "o", color=color, markersize=2.5)
        axis.set_title(f"{BUILDINGS.get(panel[0], panel[0])}, {panel[1]}")
        axis.xaxis.set_major_formatter(lambda steps, _: f"{steps / 1000:g}k")
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    handles = [
        *(Line2D([], [], color=LIGHT[f"series-{n}"], label=algorithm) for n, algorithm in enumerate(algorithms, 1)),
        Line2D([], [], color=LIGHT["muted"], linestyle="", marker="o", markersize=2.5, label="before the first step"),
    ]
    figure.legend(handles=handles, fontsize=6, loc="outside upper right", ncols=len(handles))
    figure.supxlabel("training steps", fontsize=8.0, color=LIGHT["muted"])
    figure.supylabel("reward of an episode (EUR)", fontsize=8.0, color=LIGHT["muted"])


def write_curve_table(results: Results, path: Path) -> None:
    """Write the learning curves of all trainings as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["training", "step", "reward"])
        for name, record in sorted(results.trainings.items()):
            curve = curve_of(record)
            writer.writerows((name, *point) for point in zip(curve["steps"], curve["rewards"], strict=True))


def main() -> None:
    """Write the times of trainings that two sets share into the published rows, and pages, figures and curves."""
    full, quick = published("full"), published("quick")
    if full is not None and quick is not None:
        add_times(full, quick)
        full.save(PUBLISHED["full"])
    for path, renewed in ((PAGE, page), (PLANNING, planning_page)):
        path.write_text(renewed(path.read_text(encoding="utf-8")), encoding="utf-8")
    results = full or quick
    if results is None:
        return
    rasters = [*write_figures(complete(results), FOLDER), write_curves(results, FOLDER)]
    for raster in filter(None, rasters):
        raster.unlink()  # the page shows the SVG files
    write_curve_table(results, FOLDER / f"curves-{VERSION}.csv")


if __name__ == "__main__":
    main()
