"""Write reports and figures to files."""

from __future__ import annotations

import csv
from itertools import zip_longest
from pathlib import Path

from zenostat.topics.atomic_file import atomic_file, check_writable
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import import_extra
from zenostat.views.report.figures.base import Figure
from zenostat.views.report.page import page
from zenostat.views.report.runs import Comparison
from zenostat.views.report.sections import sections
from zenostat.views.report.svg import save


def write_report(comparison: Comparison, path: str | Path) -> None:
    """Write a report as one HTML file, atomically. It is self-contained: a browser loads nothing else for it.

    Raises:
        InvalidConfig: see `check_report_file`.
    """
    target = check_report_file(path)
    with atomic_file(target) as temporary:
        temporary.write_text(page(comparison), encoding="utf-8")


def write_figures(comparison: Comparison, folder: str | Path) -> list[Path]:
    """Write each figure of a report as `NAME.svg` and `NAME.png` (300 dpi), and its data as `NAME.csv`.

    Returns:
        The files.

    Raises:
        InvalidConfig: see `check_figures_folder`.
    """
    target = check_figures_folder(folder)
    target.mkdir(exist_ok=True)
    files: list[Path] = []
    for figure in (figure for section in sections(comparison) for figure in section.figures):
        if figure.drawing is not None:
            files += save(figure.drawing, target, figure.name)
        files.append(_write_data(figure, target))
    return files


def _write_data(figure: Figure, folder: Path) -> Path:
    path = folder / f"{figure.name}.csv"
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(figure.data)
        writer.writerows(zip_longest(*figure.data.values(), fillvalue=""))
    return path


def check_report_file(path: str | Path, option: str = "report") -> Path:
    """Return the path of a report if it can be written there.

    Raises:
        InvalidConfig: it is no .html file, its folder is missing or cannot be written to, it is a folder, or Matplotlib
            is missing.
    """
    file = Path(path)
    if file.suffix.casefold() not in (".html", ".htm"):
        raise InvalidConfig(f"{option} {file}: expected an .html file")
    check_writable(file, f"{option} {file}")
    import_extra("matplotlib.figure", "plots", "a report")
    return file


def check_figures_folder(folder: str | Path, option: str = "figures") -> Path:
    """Return the path of a folder for figures if it is there or can be created.

    Raises:
        InvalidConfig: it is a file, it cannot be written to, the folder above is missing, or Matplotlib is missing.
    """
    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise InvalidConfig(f"{option} {path}: expected a folder, but this is a file")
    check_writable(path / "end-uses.csv" if path.is_dir() else path, f"{option} {path}")
    import_extra("matplotlib.figure", "plots", "figures")
    return path
