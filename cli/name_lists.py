"""Names and numbers separated by commas, and failures of several jobs, as of `zenostat benchmark` and `bounds`."""

from __future__ import annotations

from collections.abc import Sequence

import typer

from zenostat.cli.console import err
from zenostat.topics.errors import InvalidConfig


def names_in(text: str, option: str) -> list[str]:
    """Return the names in the text of an option, which commas separate.

    Raises:
        InvalidConfig: there are none.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise InvalidConfig(f"{option} {text!r}: names separated by commas expected")
    return names


def numbers_in(text: str, option: str) -> list[int]:
    """Return the whole numbers in the text of an option, which commas separate.

    Raises:
        InvalidConfig: it has something else.
    """
    try:
        return [int(name) for name in names_in(text, option)]
    except ValueError:
        raise InvalidConfig(f"{option} {text}: numbers separated by commas expected") from None


def end_with_failures(texts: Sequence[str], prefix: str = "") -> None:
    """Print errors and end the command with exit code 1; if there are none, do nothing."""
    for text in texts:
        err.print(f"{prefix}{text}")
    if texts:
        raise typer.Exit(1)
