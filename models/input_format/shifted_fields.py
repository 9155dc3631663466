"""Find the line from which on the fields of an IDF object are shifted: a decimal comma, a comma or a value too many."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from zenostat.models.input_format.layout import TypeLayout
from zenostat.models.input_format.source_model import ShiftHint

_DECIMAL_COMMA = re.compile(r"(?<![\w.:])([+-]?\d+),(\d+)\s*[,;]\s*$")
_LABEL = re.compile(r"!-\s*([^{]*)")
_DOUBLED_COMMA = re.compile(r"\S\s*,\s*,\s*$")


def shift_hint(layout: TypeLayout, values: Sequence[tuple[int, str]], lines: Sequence[str]) -> ShiftHint | None:
    """Return the first line that has two values, in an object with one value in each of its other lines.

    Such a line is no error by itself: an IDF may have any number of values in a line. If there is none, it is the line
    from which on the fields' names in comments (`!- Name`) are those of the field before or after, in at least two
    lines.

    Args:
        layout: of the object's type.
        values: line and text of each of its values, without the type.
        lines: of the file.
    """
    counts = Counter(line for line, _ in values)
    single = sum(count == 1 for count in counts.values())
    if single < 3 or len(counts) - single > 1:
        return None
    if single == len(counts):
        return _shifted_labels(layout, values, lines)
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


def _shifted_labels(layout: TypeLayout, values: Sequence[tuple[int, str]], lines: Sequence[str]) -> ShiftHint | None:
    positions = {path.replace("_", ""): index for index, path in enumerate(layout.order)}
    shifts = list[tuple[int, int]]()  # index of a value whose comment names a field, and its distance from that field
    for index, (line, _) in enumerate(values[: len(layout.order) + 1]):
        label = _LABEL.search(lines[line - 1])
        position = positions.get(re.sub(r"\W|_", "", label[1].casefold())) if label else None
        if position is not None:
            shifts.append((index, index - position))
    for number, (index, shift) in enumerate(shifts):
        if shift:
            previous = shifts[number - 1][0] if number else -1
            if abs(shift) != 1 or any(other != shift for _, other in shifts[number:]) or len(shifts) - number < 2:
                return None
            line, text = values[min(previous + 1, index)]
            if shift > 0:
                what = f"is {text!r}, but the comments after it name the fields before: a value too many"
                return ShiftHint(line, layout.path(previous + 1), what)
            what = f"is {text!r}, but the comment names {layout.path(index + 1)}: a value is missing"
            return ShiftHint(line, layout.path(index), what)
    return None
