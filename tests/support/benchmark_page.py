"""Tables and figures of docs/benchmark.md; `python tests/support/benchmark_page.py` makes them from the results."""

from __future__ import annotations

from pathlib import Path

from agent_sdk.benchmark import load_results
from agent_sdk.benchmark.figures import write_figures
from agent_sdk.benchmark.tables import tables

PAGE = Path(__file__).parents[2] / "docs" / "benchmark.md"
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
    return _replace(text, "smoke", tables(load_results(SMOKE))[0].markdown())


def _replace(text: str, part: str, content: str) -> str:
    begin, end = f"<!-- made: {part} -->", f"<!-- end: {part} -->"
    before, _, rest = text.partition(begin)
    return f"{before}{begin}\n\n{content}\n\n{end}{rest.partition(end)[2]}"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    for raster in write_figures(load_results(PUBLISHED), FOLDER):
        raster.unlink()  # the page shows the SVG files
