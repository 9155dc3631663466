"""Read the severe and fatal messages of `eplusout.err`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

_SEVERE = ("** Severe  **", "**  Fatal  **")
_CONTINUATION = "**   ~~~   **"

_FIRST, _LAST = 7, 3
"""Numbers of messages that an explanation has."""

_MAX_LINES = 8
"""Lines of a message that an explanation has."""


def severe_messages(folder: Path) -> list[list[str]]:
    """Return the severe and fatal messages of a run in their order, each with its continuation lines."""
    try:
        text = (folder / "eplusout.err").read_text(errors="replace")
    except OSError:
        return []
    messages: list[list[str]] = []
    within = False
    for line in text.splitlines():
        if any(mark in line for mark in _SEVERE):
            within = True
            messages.append([])
        elif _CONTINUATION not in line:
            within = False
        if within:
            messages[-1].append(" ".join(line.split()))
    return messages


def explain(folder: Path, fallback: str, *, locate: Callable[[str], str | None] | None = None) -> str:
    """Return the messages as the end of an error text, or `fallback` if there are none.

    The first messages are the reason of an invalid model, and the others follow from them; the last ones are the reason
    where a simulation fails later.

    Args:
        folder: EnergyPlus's output folder.
        fallback: the text if there are no messages.
        locate: returns the place in the user's file that a message is about, or None; it is added to the message.
    """
    messages = severe_messages(folder)
    if not messages:
        return fallback
    blocks = []
    for message in messages if len(messages) <= _FIRST + _LAST else [*messages[:_FIRST], *messages[-_LAST:]]:
        place = locate(" ".join(message)) if locate is not None else None
        blocks.append([*message[:_MAX_LINES], *([f"({place})"] if place else [])])
    if len(blocks) < len(messages):
        blocks.insert(_FIRST, [f"… {len(messages) - len(blocks)} more messages …"])
    return "\n  ".join(["EnergyPlus reports:", *(line for block in blocks for line in block)])
