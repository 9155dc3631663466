"""Numbers of the benchmark in docs, from its results; `python tests/support/benchmark_page.py` writes them."""

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from zenostat.lab.benchmark import Results, load_results, score_rows
from zenostat.lab.benchmark.definition import BUILDINGS
from zenostat.lab.benchmark.figures import write_figures
from zenostat.lab.benchmark.tables import tables

_COMPARED = ("rbc", "oracle")
PAGE = Path(__file__).parents[2] / "docs" / "benchmark.md"
PLANNING = PAGE.with_name("mpc.md")
FOLDER = PAGE.with_suffix("")
PUBLISHED, SMOKE = FOLDER / "quick-1.json", FOLDER / "smoke-1.json"
_FIGURES = ("![Scores of each controller](benchmark/scores.svg)", "![Scores by building](benchmark/buildings.svg)", "")


def page(text: str) -> str:
    """Return a page with its results replaced."""
    results = load_results(PUBLISHED)
    parts = []
    for table, figure in zip(tables(results), _FIGURES, strict=True):
        parts += [f"**{table.title}**", table.markdown(), figure]
    parts.append("Made with " + ", ".join(f"{name} {version}" for name, version in results.versions.items()) + ".")
    text = _replace(text, "results", "\n\n".join(filter(None, parts)))
    text = _replace(text, "savings", _savings(results))
    return _replace(text, "smoke", tables(load_results(SMOKE))[0].markdown())


def planning_page(text: str) -> str:
    """Return the page about planning with what the oracle is worth in the benchmark."""
    scores = {of.controller: of.overall.value for of in score_rows(load_results(PUBLISHED).rows.values())}
    oracle, rule = scores["oracle"], scores["rbc"]
    return _replace(
        text,
        "planning",
        f"In the [benchmark](benchmark.md), whose reward has a tariff, a demand charge and occupied comfort, the score "
        f"of the oracle is {oracle:.3f} and that of `rbc`, from which it starts, {rule:.3f}: the difference is "
        f"{100 * (oracle - rule):.0f} % of the cost of the baseline control.",
    )


def _savings(results: Results) -> str:
    """Return a table of what `rbc` and the oracle save by building, in EUR a week."""
    columns = ["building", *(f"{name}, {what}" for name in _COMPARED for what in ("energy", "comfort"))]
    lines = [columns, ["---", *("---:" for _ in columns[1:])]]
    for building, title in BUILDINGS.items():
        cells = [title]
        for name in _COMPARED:
            cells += [
                f"{_saved(results, name, building, terms):.0f}" for terms in (("cost", "gas", "peak"), ("comfort",))
            ]
        lines.append(cells)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _saved(results: Results, name: str, building: str, terms: Sequence[str]) -> float:
    rows = [row for row in results.rows.values() if (row.controller, row.building) == (name, building)]
    before = [results.rows["baseline", *row.key[1:]] for row in rows]
    saved = fmean(
        sum(now.terms.get(term, 0.0) - then.terms.get(term, 0.0) for term in terms)
        for now, then in zip(rows, before, strict=True)
    )
    return round(saved) + 0.0


def _replace(text: str, part: str, content: str) -> str:
    begin, end = f"<!-- made: {part} -->", f"<!-- end: {part} -->"
    before, _, rest = text.partition(begin)
    return f"{before}{begin}\n\n{content}\n\n{end}{rest.partition(end)[2]}"


if __name__ == "__main__":
    for path, renewed in ((PAGE, page), (PLANNING, planning_page)):
        path.write_text(renewed(path.read_text(encoding="utf-8")), encoding="utf-8")
    for raster in write_figures(load_results(PUBLISHED), FOLDER):
        raster.unlink()  # the page shows the SVG files
