"""Find the line from which on the fields of an IDF object are shifted: a decimal comma, or a comma too many."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from zenostat.models.input_format.layout import TypeLayout
from zenostat.models.input_format.source_model import ShiftHint

_DECIMAL_COMMA = re.compile(r"(?<![\w.:])([+-]?\d+),(\d+)\s*[,;]\s*$")
_DOUBLED_COMMA = re.compile(r"\S\s*,\s*,\s*$")


def shift_hint(layout: TypeLayout, values: Sequence[tuple[int, str]], lines: Sequence[str]) -> ShiftHint | None:
    """Return the first line that has two values, in an object with one value in each of its other lines.

    Such a line is no error by itself: an IDF may have any number of values in a line.

    Args:
        layout: of the object's type.
        values: line and text of each of its values, without the type.
        lines: of the file.
    """
    counts = Counter(line for line, _ in values)
    single = sum(count == 1 for count in counts.values())
    if single < 3 or len(counts) - single > 1:
        return None
    for index, (line, text) in enumerate(values):
        if counts[line] != 2:
            continue
        code = lines[line - 1].partition("!")[0]
        path = layout.path(index)
        if match := _DECIMAL_COMMA.search(code):
            meant = f"if that is a decimal comma, write {match[1]}.{match[2]}"
            return ShiftHint(line, path, f"has '{match[1]},{match[2]}' in a line, which are two values; {meant}")
        if _DOUBLED_COMMA.search(code):
            return ShiftHint(
                line, path, f"has ',,' in a line after {text!r}, so that the field after it is empty; remove a ','"
            )
        return None
    return None
