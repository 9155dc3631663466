"""A page of a benchmark's results as Markdown, with tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from zenostat.lab.benchmark.bound_file import Bound, Key
from zenostat.lab.benchmark.definition import VERSION
from zenostat.lab.benchmark.figures import write_figures
from zenostat.lab.benchmark.gap import tables_with_gap
from zenostat.lab.benchmark.results import Results
from zenostat.lab.benchmark.tables import escaped
from zenostat.topics.atomic_file import atomic_file


def write_page(results: Results, path: Path, bounds: Mapping[Key, Bound] | None = None) -> list[Path]:
    """Write a Markdown file, and its figures into a folder of the same name without suffix; return the PNG files.

    Args:
        results: the results.
        path: the file.
        bounds: bounds of the set, for the shares of the gap.
    """
    folder = path.with_suffix("")
    figures = write_figures(results, folder)
    versions = ", ".join(f"{name} {version}" for name, version in results.versions.items())
    parts = [f"# Zenostat benchmark {VERSION}, set {results.set}", f"Made with {escaped(versions)}."]
    parts += [f"## {escaped(table.title)}\n\n{table.markdown()}" for table in tables_with_gap(results, bounds)]
    parts += [f"![{figure.stem}]({quote(folder.name)}/{figure.stem}.svg)" for figure in figures]
    with atomic_file(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return figures
