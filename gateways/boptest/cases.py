"""Test cases: scenarios by the name under which clients select them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol


@dataclass(frozen=True, slots=True)
class TestCase:
    """A scenario that clients can select.

    Attributes:
        name: BOPTEST's `testcaseid`.
        arguments: arguments of the scenario, as of an environment.
        days: day of each test period, from 0; None if they are not known before a year is simulated.
    """

    __test__ = False  # for pytest, which takes it for a test

    name: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    days: Mapping[str, int] | None = None


class TestCases(Protocol):
    """The test cases that a service offers."""

    def names(self) -> Sequence[str]:
        """Return the names that are listed; others may be found as well."""

    def find(self, name: str) -> TestCase:
        """Return the test case of a name.

        Raises:
            UnknownName: there is none.
            InvalidConfig: it cannot be used.
        """

    def save_days(self, case: TestCase, days: Mapping[str, int]) -> None:
        """Keep the days of test periods that were found for a test case."""
