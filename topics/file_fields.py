"""Fields that several kinds of files have."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field

from zenostat.topics.calendar import check_hours
from zenostat.topics.errors import repeated
from zenostat.topics.messages import Finite, Message


def as_tuple(value: Any) -> Any:
    """Return a text as a tuple of it; other values are unchanged."""
    return (value,) if isinstance(value, str) else value


Hours = Annotated[tuple[Finite, Finite], AfterValidator(check_hours)]
Pattern = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.\-*]{1,128}$")]
Names = Annotated[tuple[Pattern, ...], BeforeValidator(as_tuple, json_schema_input_type=str | list[str])]
"""One or several names; `*` matches any characters."""


class FilePart(Message):
    """A part of a file; its validator is built when it is first used, since most programs use none."""

    model_config = ConfigDict(defer_build=True)


def check_unique(names: Iterable[str], kind: str) -> None:
    """Raise a `ValueError` if parts of a file, such as each `rule`, share a name."""
    if twice := sorted(repeated(names)):
        raise ValueError(f"each {kind} needs a unique name; used more than once: {', '.join(map(repr, twice))}")
