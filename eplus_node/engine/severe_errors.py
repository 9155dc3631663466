"""The severe errors that EnergyPlus reports in a run that goes on."""

from __future__ import annotations

import re

from zenostat.topics.plurals import counted

_CONTINUED, _INFORMATION, _SEVERE = 0, 1, 3
"""Levels of EnergyPlus's messages."""

_MARKS = re.compile(r"^\s*\*\*\s*(Severe|~~~)\s*\*\*")
_TIMES = re.compile(r"This error occurred (\d+) total times")
_TOTAL = re.compile(r"EnergyPlus Completed Successfully.*; (\d+) Severe Errors")

_MOST_TEXTS = 20
_MOST_LINES = 8


class SevereErrors:
    """Collects the texts of severe errors, each distinct one once.

    EnergyPlus sums up errors that recur in each timestep at the end of a run, with their number.

    Attributes:
        lines: of the errors since the last `drain`.
        total: EnergyPlus's count of them at the end of the run; empty before it, and if there are none.
    """

    def __init__(self) -> None:
        self.lines: list[list[str]] = []
        self.total = ""
        self._texts: dict[str, None] = {}
        self._is_open = False
        self._times = ""

    def add(self, level: int, message: bytes) -> None:
        """Take a message of EnergyPlus: a line, or the first line of a message whose others are `_CONTINUED`."""
        if level == _CONTINUED:
            if self._is_open:
                self.lines[-1].append(_plain(message))
            return
        if level == _SEVERE:
            self._is_open = True
            self.lines.append([_plain(message) + self._times])
            self._times = ""
            return
        text = message.decode(errors="replace")
        if level == _INFORMATION and "~~~" in text:  # of the summary, which has most of its lines twice
            if times := _TIMES.search(text):
                self._times = f" ({int(times[1]):,} times)"
            return
        self._is_open = False
        if level == _INFORMATION and (total := _TOTAL.search(text)) and int(total[1]):
            self.total = f"EnergyPlus counts {counted(int(total[1]), 'severe error', ',')} in this run"

    def drain(self) -> list[str]:
        """Return the distinct texts of the errors since the last call, and their total; of many, the first ones."""
        texts = []
        for first, *others in self.lines:
            lines = [first, *filter(None, others[:_MOST_LINES])]
            text = f"EnergyPlus reports a severe error: {'; '.join(lines)}"
            if text not in self._texts and len(self._texts) < _MOST_TEXTS:
                self._texts[text] = None
                texts.append(text)
        self.lines.clear()
        self._is_open = False
        return [*texts, self.total] if self.total else texts

    def repeat(self) -> list[str]:
        """Return all texts so far."""
        return [*self._texts]


def _plain(message: bytes) -> str:
    return " ".join(_MARKS.sub("", message.decode(errors="replace")).split())
