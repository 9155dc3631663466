"""The data dictionary (`Energy+.idd`) of the installed engine, made from its schema.

The wheel has no dictionary, which `ExpandObjects` reads for ranges, choices and defaults.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from zenostat.models import energyplus
from zenostat.models.input_format.layout import Layout, Rules, TypeLayout, engine_layout
from zenostat.topics.cache import cached_bytes

_ENTRIES = 50
"""Entries of a list that the dictionary has; EnergyPlus's own has between 10 and 2,000."""

_FORMAT = "1"


def dictionary() -> bytes:
    """Return the dictionary of the installed engine, made once per version."""

    def make(target: Path) -> None:
        target.write_text(idd_text(engine_layout()), encoding="utf-8")

    return cached_bytes(f"schema/{energyplus.version()}-{_FORMAT}.idd", make)


def idd_text(layout: Layout) -> str:
    """Return the dictionary of a version, without notes."""
    lines = [f"!IDD_Version {layout.version}"]
    group = None
    for kind in layout.kinds:
        entry = layout.find(kind)
        if entry is None:
            continue
        if entry.group != group:
            group = entry.group
            lines += ["", f"\\group {group}"]
        lines += ["", *_type_lines(entry)]
    return "\n".join([*lines, ""])


def _type_lines(entry: TypeLayout) -> Iterator[str]:
    fields = [(name, entry.titles.get(name, name), entry.rules.get(name, {})) for name in entry.order]
    first_of_list = len(fields)
    for number in range(1, _ENTRIES + 1) if entry.list_name else ():
        titles = [(name, f"{entry.titles.get(name, name)} {number}") for name in entry.entry_order]
        fields += [(name, title, entry.entry_rules[name]) for name, title in titles]
    if not fields:
        yield f"{entry.kind};"
        return
    yield f"{entry.kind},"
    if entry.minimum_fields:
        yield f"  \\min-fields {entry.minimum_fields}"
    if entry.list_name:
        yield f"  \\extensible:{len(entry.entry_order)}"
    numbers = {"A": 0, "N": 0}
    for position, (name, title, rules) in enumerate(fields):
        letter = "N" if name in entry.numeric else "A"
        numbers[letter] += 1
        mark = ";" if position == len(fields) - 1 else ","
        yield f"  {letter}{numbers[letter]}{mark} \\field {title}"
        if position == first_of_list and entry.list_name:
            yield "  \\begin-extensible"
        yield from _field_lines(rules, is_required=name in entry.required)


def _field_lines(rules: Rules, *, is_required: bool) -> Iterator[str]:
    if is_required:
        yield "  \\required-field"
    choices: list[Rules] = [rules, *rules.get("anyOf", ())]
    words = [word for choice in choices for word in choice.get("enum", ()) if word != ""]
    folded = {str(word).casefold() for word in words}
    if any("type" in choice and choice["type"] in ("number", "integer") for choice in choices):
        yield f"  \\type {'integer' if rules.get('type') == 'integer' else 'real'}"
        yield from (f"  \\{word}" for word in _SIZED if _SIZED[word] in folded)
    elif words:
        yield "  \\type choice"
        yield from (f"  \\key {word}" for word in words)
    for choice in choices:
        yield from (f"  \\{word} {choice[name]:.15g}" for name, word in _LIMITS.items() if name in choice)
    if "default" in rules:
        yield f"  \\default {_plain(rules['default'])}"


def _plain(value: Any) -> str:
    return f"{value:.15g}" if isinstance(value, float) else str(value)


_LIMITS = {"minimum": "minimum", "exclusiveMinimum": "minimum>", "maximum": "maximum", "exclusiveMaximum": "maximum<"}
_SIZED = {"autosizable": "autosize", "autocalculatable": "autocalculate"}
