"""Read the severe and fatal messages of `eplusout.err`."""

from __future__ import annotations

from pathlib import Path

_SEVERE = ("** Severe  **", "**  Fatal  **")
_CONTINUATION = "**   ~~~   **"


def severe_lines(folder: Path, *, limit: int = 20) -> list[str]:
    """Return the severe and fatal messages of a run with their continuation lines, at most the last `limit` lines.

    The reason for a fatal error is in the severe messages before it, so both are included.
    """
    try:
        text = (folder / "eplusout.err").read_text(errors="replace")
    except OSError:
        return []
    kept: list[str] = []
    within = False
    for line in text.splitlines():
        if any(mark in line for mark in _SEVERE):
            within = True
        elif _CONTINUATION not in line:
            within = False
        if within:
            kept.append(" ".join(line.split()))
    return kept[-limit:]


def explain(folder: Path, fallback: str) -> str:
    """Return those messages as the end of an error text, or `fallback` if there are none."""
    lines = severe_lines(folder)
    return "\n  ".join(["EnergyPlus reports:", *lines]) if lines else fallback
