"""Read and check the sections of a settings file; errors are collected, so that all of them are reported at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from zenostat.topics.errors import InvalidConfig, UsageError, did_you_mean
from zenostat.topics.keys import check_name, safe_name

T = TypeVar("T")


class SectionReader:
    """The settings of a file while they are read; `errors` collects the errors in them."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.settings = settings
        self.errors: list[str] = []

    def add_error(self, text: str) -> None:
        """Add an error to `errors`."""
        self.errors.append(text)

    def collect(self, read: Callable[[], T], setting: str) -> T | None:
        """Return the result of `read`, or None if it raises an error, which is added to `errors`."""
        try:
            return read()
        except UsageError as error:
            self.add_error(f"{setting}: {error}")
            return None

    def check_names(self, section: Mapping[Any, Any], names: Iterable[str], prefix: str) -> None:
        """Add an error for each setting that is not in `names`."""
        names = list(names)
        for name in section:
            if name not in names:
                self.add_error(f"{prefix}unknown setting {name!r}; {did_you_mean(str(name), names)}")

    def mapping(self, name: str) -> Mapping[Any, Any]:
        """Return the section of that name; empty if it is left out."""
        value = self.settings.get(name)
        if value is None:
            return {}
        if not isinstance(value, Mapping):
            self.add_error(f"{name}: expected names and values, got {value!r}")
            return {}
        return value

    def texts(self, value: Any, setting: str) -> list[str]:
        """Return a list of strings; empty, with an error, if it is something else."""
        if isinstance(value, list) and all(isinstance(text, str) for text in value):
            return value
        self.add_error(f"{setting}: expected a list of strings, got {value!r}")
        return []

    def number(self, value: Any, setting: str) -> float:
        """Return a number; 0, with an error, if it is something else."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        self.add_error(f"{setting}: expected a number, got {value!r}")
        return 0.0

    def name(self, text: Any, setting: str) -> str | None:
        """Return `text`, or a similar name that is valid in a topic; None, with an error, if it is not a string."""
        if not isinstance(text, str) or not text:
            self.add_error(f"{setting}: expected a name, got {text!r}")
            return None
        try:
            return check_name(text, setting)
        except InvalidConfig:
            return safe_name(text)

    def pair(self, value: Any, setting: str) -> tuple[float, float]:
        """Return two numbers; 0 and 1, with an error, if it is something else."""
        if not isinstance(value, list) or len(value) != 2:
            self.add_error(f"{setting}: expected two numbers, got {value!r}")
            return 0.0, 1.0
        low, high = (self.number(number, setting) for number in value)
        return low, high
