"""Headers of measured columns: the points that they are compared with, and their units."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from zenostat.lab.calibration.config import Calibration, Column
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.units import unit_name
from zenostat.topics.user_file import user_file

_HEADER = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])](?:\((?:Hourly|TimeStep)\))?\s*")


@dataclass(frozen=True)
class Heading:
    """A column of the file: its header, the unit in it, and its settings."""

    header: str
    name: str
    unit: str | None
    settings: Column

    @property
    def place(self) -> str:
        """The column's place, for errors."""
        return f"column {self.header!r} (line 1)"

    @property
    def target(self) -> str | dict[str, str | None]:
        """The point, as of `TargetFinder.find`."""
        named = self.settings.model_dump(include={"point", "meter", "variable", "key"}, exclude_none=True)
        return named or self.name


def read_headings(path: Path, config: Calibration) -> tuple[str, list[Heading]]:
    """Return the header of the timestamps, and the columns to compare.

    Raises:
        InvalidConfig: there is no such column, or none is left to compare.
    """
    rows = read_rows(path, config.delimiter)
    header = [cell.strip() for cell in rows[0][1]] if rows else []
    if len(header) < 2:
        raise InvalidConfig(
            f"{path}, line 1: a header with a column of timestamps and measured columns expected, with "
            f"{config.delimiter!r} between them; got {config.delimiter.join(header)[:60]!r}"
        )
    time = config.time_column or header[0]
    for name, count in Counter(header).items():
        if count > 1:
            raise InvalidConfig(f"{path}, line 1: the header {name!r} occurs {count} times; rename all but one")
    if time not in header:
        raise InvalidConfig(f"{path}, line 1: there is no column {time!r}; {did_you_mean(time, header)}")
    settings = {_header(name, header, time, path): column for name, column in config.columns.items()}
    headings = []
    for cell in header:
        column = settings.get(cell, Column())
        if cell != time and isinstance(column, Column):
            name, unit = _split(cell)
            headings.append(Heading(cell, name, column.unit or unit, column))
    if not headings:
        raise InvalidConfig(f"{path}, line 1: no column is left to compare with; set one of `columns` to its point")
    return time, headings


def _header(name: str, header: Sequence[str], time: str, path: Path) -> str:
    """Return the header that `columns` names, perhaps without its unit."""
    named = [name] if name in header else [cell for cell in header if _split(cell)[0] == name]
    if len(named) > 1:
        several = " and ".join(map(repr, named))
        raise InvalidConfig(f"columns: {name!r} stands for {several} in line 1 of {path.name}; write one with its unit")
    if not named:
        hint = did_you_mean(name, [cell for cell in header if cell != time])
        raise InvalidConfig(f"columns: {path.name} has no header {name!r} in line 1; {hint}")
    return named[0]


def _split(header: str) -> tuple[str, str | None]:
    """Return name and unit of a header such as `electricity_facility [kWh]`."""
    match = _HEADER.fullmatch(header)
    return (match["name"], unit_name(match["unit"])) if match else (header, None)


def read_rows(path: Path, delimiter: str) -> list[tuple[int, list[str]]]:
    """Return the rows of a CSV file that are not empty, with their line numbers."""
    with user_file(path), path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file, delimiter=delimiter)
        return [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
