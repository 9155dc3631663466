"""The lines of `eplusout.err` that matter."""

from __future__ import annotations

from pathlib import Path

_GRAVE = ("** Severe  **", "**  Fatal  **")
_MORE = "**   ~~~   **"


def severe_lines(folder: Path, *, most: int = 20) -> list[str]:
    """The severe and fatal messages of a run with their continuation lines, the last `most` lines.

    The fatal error's reason stands in the severe messages before it, so both are wanted.
    """
    try:
        text = (folder / "eplusout.err").read_text(errors="replace")
    except OSError:
        return []
    kept: list[str] = []
    within = False
    for line in text.splitlines():
        if any(mark in line for mark in _GRAVE):
            within = True
        elif _MORE not in line:
            within = False
        if within:
            kept.append(" ".join(line.split()))
    return kept[-most:]


def explain(folder: Path, fallback: str) -> str:
    """Those lines as the end of an error text, or `fallback` where there are none."""
    lines = severe_lines(folder)
    return "\n  ".join(["EnergyPlus says:", *lines]) if lines else fallback
