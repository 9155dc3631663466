"""Tables that fit the terminal without truncation; in a pipe, one line per row."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import typer
from rich import box
from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from zenostat.cli.console import out
from zenostat.topics.json_numbers import finite
from zenostat.topics.printable import replace_controls, replace_controls_in_lines

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]

_MAX_RENDERED_ROWS = 2000
"""Longer tables take seconds to render."""

_GAP = 2
"""Spaces between two columns."""

_MAX_PAD = 44
"""Maximum column width in a pipe: one longer cell does not widen all other rows."""

_WORDS = re.compile(r"\S+\s*")
_PARTS = re.compile(r"[^\s_./:-]*[_./:-]*\s*")


def show_json(data: Sequence[Any] | dict[str, Any]) -> None:
    """Print data as JSON; what is not a finite number is null."""
    json.dump(finite(data), sys.stdout, indent=1)
    sys.stdout.write("\n")


def show(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    right: Sequence[str] = (),
    wrap: Sequence[str] = (),
) -> None:
    """Print a table; in a pipe, or if it is very long, as one line per row of any width.

    Args:
        title: printed above the table.
        columns: headings, which may have several lines.
        rows: one cell for each column.
        right: right-aligned columns.
        wrap: columns whose cells may be wrapped to several lines.
    """
    if not out.is_terminal or len(rows) > _MAX_RENDERED_ROWS:
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
    """Return a table that is at most `width` wide, with no cell truncated.

    If it does not fit, the `wrap` columns are wrapped: between words, then also after `_`, `.`, `/`, `:` and `-`. If
    that is not enough, each row becomes a paragraph: the cell of the first `wrap` column, and the others below it with
    their headings.
    """
    for pattern in (_WORDS, _PARTS):
        widths = _widths(columns, rows, width, [name in wrap for name in columns], pattern)
        if widths is not None:
            return _table(columns, rows, widths, pattern, title, right)
    return _paragraphs(columns, rows, title, wrap)


def _widths(
    columns: Sequence[str], rows: Sequence[Sequence[str]], width: int, wraps: Sequence[bool], pattern: re.Pattern[str]
) -> list[int] | None:
    """Return the width of each column; None if they do not fit."""
    cells = list(zip(columns, *rows, strict=True))
    natural = [max(cell_len(line) for cell in column for line in cell.split("\n")) for column in cells]
    widths = [
        max(cell_len(part.rstrip()) for cell in column for part in _pieces(cell, pattern)) if wrap else full
        for column, full, wrap in zip(cells, natural, wraps, strict=True)
    ]
    spare = width - sum(widths) - _GAP * (len(columns) - 1)
    if spare < 0:
        return None
    while spare > 0 and widths != natural:  # widen the wrapped columns in turn
        for i, full in enumerate(natural):
            if widths[i] < full and spare > 0:
                widths[i], spare = widths[i] + 1, spare - 1
    return widths


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
        title=_plain(title) if title else None,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        show_edge=False,
    )
    table.padding = (0, _GAP - 1, 0, 0)  # the box style adds 1
    for name, width in zip(columns, widths, strict=True):
        heading = _wrapped(name, width, pattern)
        table.add_column(_plain(heading), justify="right" if name in right else "left", width=width, no_wrap=True)
    for row in rows:
        table.add_row(*(_plain(_wrapped(cell, width, pattern)) for cell, width in zip(row, widths, strict=True)))
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
    parts: list[RenderableType] = [Text(title, style="italic")] if title else []
    headings = [column.replace("\n", " ") for column in columns]
    lead = next((index for index, column in enumerate(columns) if column in wrap), 0)
    for row in rows:
        rest = list(zip(headings, row, strict=True))
        parts.append(_plain(rest.pop(lead)[1], style="bold"))
        text = Text(overflow="fold")
        for name, cell in rest:
            if cell:
                text.append("; " if text else "").append(f"{name}: ", style="dim").append(
                    replace_controls(cell.replace("\n", " "))
                )
        parts.append(Padding(text, (0, 0, 0, 2)))
    return Group(*parts)


def _show_lines(columns: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool]) -> None:
    widths = [min(max(map(len, cells)), _MAX_PAD) for cells in zip(columns, *rows, strict=True)]
    for row in (columns, *rows):
        cells = zip(map(_one_line, row), widths, right, strict=True)
        line = "  ".join(cell.rjust(width) if is_right else cell.ljust(width) for cell, width, is_right in cells)
        sys.stdout.write(line.rstrip() + "\n")


def _plain(cell: str, style: str = "") -> Text:
    return Text(replace_controls_in_lines(cell), style=style, overflow="fold")


def _one_line(cell: str) -> str:
    return replace_controls(cell.replace("\n", " "))
