"""What is said in a section of a file, checked; mistakes are gathered, so that all of them are said at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from topics.errors import InvalidConfig, UsageError, did_you_mean
from topics.keys import check_name, safe_name

T = TypeVar("T")


class SectionReader:
    """The content of a file while it is read; `faults` is what is wrong with it."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.given = given
        self.faults: list[str] = []

    def add_error(self, text: str) -> None:
        """Remembers what is wrong."""
        self.faults.append(text)

    def collect(self, do: Callable[[], T], where: str) -> T | None:
        """What `do` gives, or None and its mistake remembered."""
        try:
            return do()
        except UsageError as error:
            self.add_error(f"{where}: {error}")
            return None

    def known(self, given: Mapping[Any, Any], names: Iterable[str], where: str) -> None:
        """Settings with other names are faults."""
        names = list(names)
        for name in given:
            if name not in names:
                self.add_error(f"{where}unknown setting {name!r}; {did_you_mean(str(name), names)}")

    def mapping(self, name: str) -> Mapping[Any, Any]:
        """The section of that name; empty where it is left out."""
        given = self.given.get(name)
        if given is None:
            return {}
        if not isinstance(given, Mapping):
            self.add_error(f"{name}: names and values expected, got {given!r}")
            return {}
        return given

    def texts(self, given: Any, where: str) -> list[str]:
        """A list of texts; empty, and a fault, if it is none."""
        if isinstance(given, list) and all(isinstance(text, str) for text in given):
            return given
        self.add_error(f"{where}: a list of texts expected, got {given!r}")
        return []

    def number(self, given: Any, where: str) -> float:
        """A number; 0, and a fault, if it is none."""
        if isinstance(given, int | float) and not isinstance(given, bool):
            return float(given)
        self.add_error(f"{where}: a number expected, got {given!r}")
        return 0.0

    def name(self, text: Any, where: str) -> str | None:
        """The name under which `text` can stand in a topic; it is kept where it can itself."""
        if not isinstance(text, str) or not text:
            self.add_error(f"{where}: a name expected, got {text!r}")
            return None
        try:
            return check_name(text, where)
        except InvalidConfig:
            return safe_name(text)

    def pair(self, given: Any, where: str) -> tuple[float, float]:
        """Two numbers; 0 and 1, and a fault, if there are others."""
        if not isinstance(given, list) or len(given) != 2:
            self.add_error(f"{where}: two numbers expected, got {given!r}")
            return 0.0, 1.0
        low, high = (self.number(number, where) for number in given)
        return low, high
