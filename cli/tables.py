"""Tables that fit the terminal without cutting anything; in a pipe, a line a row."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from rich import box
from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from cli.console import out

_LONG = 2000
"""Rows from which on a drawn table takes seconds."""

_GAP = 2
"""Cells between two columns."""

_MAX_PAD = 44
"""In a pipe a longer cell is not padded for: one long name would push all other rows apart."""

_WORDS = re.compile(r"\S+\s*")
_PARTS = re.compile(r"[^\s_./:-]*[_./:-]*\s*")


def show_json(found: Sequence[dict[str, Any]] | dict[str, Any]) -> None:
    """Print rows, or what holds them, as JSON."""
    json.dump(found, sys.stdout, indent=1)
    sys.stdout.write("\n")


def show(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    right: Sequence[str] = (),
    wrap: Sequence[str] = (),
) -> None:
    """Print a table; in a pipe, or where it is very long, a line a row, as wide as it needs.

    Args:
        title: stands above it.
        columns: headings; they may have several lines.
        rows: a cell for each column.
        right: columns of numbers.
        wrap: columns whose cells may take several lines of a table.
    """
    if not out.is_terminal or len(rows) > _LONG:
        _show_lines([column.replace("\n", " ") for column in columns], rows, [name in right for name in columns])
    else:
        out.print(fitted(columns, rows, out.width, title=title, right=right, wrap=wrap))


def fitted(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    width: int,
    *,
    title: str = "",
    right: Sequence[str] = (),
    wrap: Sequence[str] = (),
) -> RenderableType:
    """Return a table that is at most `width` wide, with every cell whole.

    Where it does not fit, the `wrap` columns take several lines: between words, then also after `_`, `.`, `/`, `:`
    and `-`. Where that is not enough, each row becomes a paragraph: the cell of its first `wrap` column, and
    below it the others with their headings.
    """
    for pattern in (_WORDS, _PARTS):
        widths = _widths(columns, rows, width, [name in wrap for name in columns], pattern)
        if widths is not None:
            return _table(columns, rows, widths, pattern, title, right)
    return _paragraphs(columns, rows, title, wrap)


def _widths(
    columns: Sequence[str], rows: Sequence[Sequence[str]], width: int, wraps: Sequence[bool], pattern: re.Pattern[str]
) -> list[int] | None:
    """The width of each column; None if they do not fit."""
    cells = list(zip(columns, *rows, strict=True))
    most = [max(cell_len(line) for cell in column for line in cell.split("\n")) for column in cells]
    found = [
        max(cell_len(part.rstrip()) for cell in column for part in _pieces(cell, pattern)) if may else natural
        for column, natural, may in zip(cells, most, wraps, strict=True)
    ]
    spare = width - sum(found) - _GAP * (len(columns) - 1)
    if spare < 0:
        return None
    while spare > 0 and found != most:  # a cell for each column that needs one, round by round
        for i, natural in enumerate(most):
            if found[i] < natural and spare > 0:
                found[i], spare = found[i] + 1, spare - 1
    return found


def _pieces(cell: str, pattern: re.Pattern[str]) -> list[str]:
    return [piece for line in cell.split("\n") for piece in pattern.findall(line) if piece] or [""]


def _table(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    widths: Sequence[int],
    pattern: re.Pattern[str],
    title: str,
    right: Sequence[str],
) -> Table:
    table = Table(
        title=escape(title) or None, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False
    )
    table.padding = (0, _GAP - 1, 0, 0)  # the box adds one
    for name, width in zip(columns, widths, strict=True):
        head = _wrapped(name, width, pattern)
        table.add_column(escape(head), justify="right" if name in right else "left", width=width, no_wrap=True)
    for row in rows:
        table.add_row(*(escape(_wrapped(cell, width, pattern)) for cell, width in zip(row, widths, strict=True)))
    return table


def _wrapped(cell: str, width: int, pattern: re.Pattern[str]) -> str:
    return "\n".join(line for text in cell.split("\n") for line in _lines(text, width, pattern))


def _lines(text: str, width: int, pattern: re.Pattern[str]) -> Iterator[str]:
    line = ""
    for piece in _pieces(text, pattern):
        if line and cell_len(line + piece.rstrip()) > width:
            yield line.rstrip()
            line = ""
        line += piece
    yield line.rstrip()


def _paragraphs(columns: Sequence[str], rows: Sequence[Sequence[str]], title: str, wrap: Sequence[str]) -> Group:
    shown: list[RenderableType] = [Text(title, style="italic")] if title else []
    heads = [column.replace("\n", " ") for column in columns]
    lead = next((place for place, column in enumerate(columns) if column in wrap), 0)
    for row in rows:
        rest = list(zip(heads, row, strict=True))
        shown.append(Text(rest.pop(lead)[1], style="bold", overflow="fold"))
        text = Text(overflow="fold")
        for name, cell in rest:
            if cell:
                text.append("; " if text else "").append(f"{name}: ", style="dim").append(cell.replace("\n", " "))
        shown.append(Padding(text, (0, 0, 0, 2)))
    return Group(*shown)


def _show_lines(columns: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool]) -> None:
    widths = [min(max(map(len, cells)), _MAX_PAD) for cells in zip(columns, *rows, strict=True)]
    for row in (columns, *rows):
        cells = zip(row, widths, right, strict=True)
        line = "  ".join(cell.rjust(width) if number else cell.ljust(width) for cell, width, number in cells)
        sys.stdout.write(line.rstrip() + "\n")
