"""Check the file of a `Schedule:File` as EnergyPlus 25.2 reads it: each rule was tried with EnergyPlus itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from zenostat.models.building.findings import FieldFinding
from zenostat.models.building.schedule_fields import number
from zenostat.topics.errors import did_you_mean
from zenostat.topics.plurals import counted

_SEPARATORS = {"Comma": ",", "Semicolon": ";", "Space": " ", "Tab": "\t"}
_SHOWN = 40
_HOUR_MIN = 60


def file_findings(fields: Mapping[str, Any]) -> Iterator[FieldFinding]:
    """Yield the finding on a `Schedule:File` and on the file that it names: the first that is fatal, or a warning."""
    minutes = int(fields.get("minutes_per_item") or _HOUR_MIN)
    if _HOUR_MIN % minutes:
        text = f": minutes_per_item is {minutes}, which does not divide the hour; 15, 30 or 60 do"
        yield FieldFinding("minutes_per_item", text)
        return
    path = Path(str(fields.get("file_name", "")))
    try:
        text = path.read_bytes().decode("utf-8", errors="replace")
    except OSError as error:
        yield FieldFinding("file_name", f": file_name is {str(path)!r}, {_reason(path, error)}")
        return
    yield from _table_findings(fields, path, text, minutes)


def file_values(fields: Mapping[str, Any]) -> list[float]:
    """Return the values of a `Schedule:File`, without those that `file_findings` reports."""
    skipped, column = int(fields.get("rows_to_skip_at_top", 0)), int(fields.get("column_number", 1))
    try:
        text = Path(str(fields.get("file_name", ""))).read_bytes().decode("utf-8", errors="replace")
    except OSError:
        return []
    rows = (_cells(row, str(fields.get("column_separator") or "Comma")) for row in text.split("\n")[skipped:])
    values = (number(cells[column - 1].strip()) for cells in rows if len(cells) >= column and cells[column - 1].strip())
    return [value for value in values if value is not None]


def _reason(path: Path, error: OSError) -> str:
    if path.is_dir():
        return "which is a folder; expected a CSV file"
    if path.exists():
        return f"which cannot be read: {error.strerror}"
    if not path.parent.is_dir():
        return f"but there is no folder {str(path.parent)!r}"
    names = [each.name for each in path.parent.iterdir() if each.suffix.casefold() in (".csv", ".txt", ".tsv")]
    return f"but there is no such file; {did_you_mean(path.name, names)}"


def _table_findings(fields: Mapping[str, Any], path: Path, text: str, minutes: int) -> Iterator[FieldFinding]:
    separator = str(fields.get("column_separator") or "Comma")
    lines = text.split("\n")
    if lines and not lines[-1].strip():
        lines.pop()
    skipped, column = int(fields.get("rows_to_skip_at_top", 0)), int(fields.get("column_number", 1))
    rows = lines[skipped:]
    if not rows:
        why = f"the file has {len(lines)} lines" if lines else "the file is empty"
        yield FieldFinding("file_name", f": {path} has no values: {why} and rows_to_skip_at_top is {skipped}")
        return
    first = _cells(rows[0], separator)
    width = len(first)
    if column > width:
        hint = _other_separator(rows[0], separator, column)
        text = (
            f": column_number is {column}, but {path} has {width} column{'s' * (width > 1)} in line {skipped + 1}{hint}"
        )
        yield FieldFinding("column_number", text)
        return
    for line, row in enumerate(rows, skipped + 1):
        cells = _cells(row, separator)
        if len(cells) != width:
            text = f": {path}, line {line}, has {counted(len(cells), 'column')}, but line {skipped + 1} has {width}"
            yield FieldFinding("file_name", text)
            return
        if not cells[column - 1].strip() or number(cells[column - 1].strip()) is None:
            shown = cells[column - 1].strip()[:_SHOWN]
            hint = _header(line, skipped) or _other_separator(rows[0], separator, column)
            text = f": {path}, line {line}, has {shown!r} in column {column}, which is no number{hint}"
            yield FieldFinding("file_name", text)
            return
    hours = int(fields.get("number_of_hours_of_data", 8760))
    needed = hours * _HOUR_MIN // minutes
    if len(rows) < needed:
        text = (
            f": {path} has {len(rows)} values, but {hours} hours need {needed}; those that are missing are "
            "undefined in EnergyPlus: 0, or any number, at which it may end"
        )
        yield FieldFinding("file_name", text, is_fatal=False)


def _cells(row: str, separator: str) -> list[str]:
    return row.rstrip("\r").split(_SEPARATORS.get(separator, ","))


def _header(line: int, skipped: int) -> str:
    """Return a hint if the value is in the first line that is read."""
    return f"; is it a heading? rows_to_skip_at_top is {skipped}" if line == skipped + 1 else ""


def _other_separator(row: str, separator: str, column: int) -> str:
    """Return a hint if another separator gives the column."""
    others = [name for name in _SEPARATORS if name != separator and len(_cells(row, name)) > max(column - 1, 1)]
    return f"; its columns seem to be separated by {others[0]}: set column_separator" if others else ""
