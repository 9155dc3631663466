"""Run conformance checks, and report their results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

from zenostat.topics.errors import InvalidConfig, did_you_mean

T = TypeVar("T")


@dataclass(frozen=True)
class Result:
    """Result of one check.

    Attributes:
        name: name of the check: the condition that it tests.
        errors: one sentence for each violation.
        skipped: reason why it was skipped; empty if it ran.
    """

    name: str
    errors: tuple[str, ...] = ()
    skipped: str = ""

    @property
    def passed(self) -> bool:
        """Whether it ran without errors."""
        return not self.errors and not self.skipped

    def __str__(self) -> str:
        sign = "skipped" if self.skipped else "passed" if self.passed else "FAILED"
        notes = [self.skipped] if self.skipped else self.errors
        return "\n".join([f"{sign:7}  {self.name}", *(f"{'':9}{note}" for note in notes)])


@dataclass(frozen=True)
class Report:
    """Results of all checks, in order. As text: one line for each check, with its errors below.

    Attributes:
        subject: name of the checked object.
        results: result of each check.
    """

    subject: str
    results: tuple[Result, ...]

    @property
    def passed(self) -> tuple[str, ...]:
        """Names of the checks that passed."""
        return tuple(r.name for r in self.results if r.passed)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that failed."""
        return tuple(r.name for r in self.results if r.errors)

    @property
    def skipped(self) -> tuple[str, ...]:
        """Names of the skipped checks."""
        return tuple(r.name for r in self.results if r.skipped)

    def __str__(self) -> str:
        return "\n".join(
            [f"{self.subject}: {len(self.passed)} of {len(self.results)} checks passed", *map(str, self.results)]
        )

    def require(self) -> Report:
        """Return the report if no check failed.

        Raises:
            ConformanceError: a check failed.
        """
        if self.failed:
            raise ConformanceError(self)
        return self


class ConformanceError(AssertionError):
    """An object violates its contract. The text names each failed check with its errors.

    Attributes:
        report: results of all checks.
    """

    def __init__(self, report: Report) -> None:
        super().__init__(report)
        self.report = report

    def __str__(self) -> str:
        failed = [r for r in self.report.results if r.errors]
        heading = f"{self.report.subject} fails {len(failed)} of {len(self.report.results)} checks"
        return "\n".join([heading, *map(str, failed)])


Check = Callable[[T], Iterable[str]]
"""Function that yields one sentence for each violation; an exception counts as one more, except `NotApplicable`."""


class NotApplicable(Exception):
    """A check that cannot judge its object. The text is the reason."""


def run(subject: str, checks: Mapping[str, Check[T]], context: T, skip: Iterable[str]) -> Report:
    """Run checks in order; if the first one fails, skip the others, since they depend on it.

    Raises:
        InvalidConfig: `skip` names an unknown check.
    """
    skipped = [skip] if isinstance(skip, str) else list(skip)
    for name in skipped:
        if name not in checks:
            raise InvalidConfig(f"skip: there is no check {name!r}; {did_you_mean(name, checks)}")
    results: list[Result] = []
    for name, check in checks.items():
        if name in skipped:
            results.append(Result(name, skipped="on request"))
        elif results and results[0].errors:
            results.append(Result(name, skipped=f"the first check failed: {results[0].name}"))
        else:
            results.append(_result(name, check, context))
    return Report(subject, tuple(results))


def _result(name: str, check: Check[T], context: T) -> Result:
    try:
        return Result(name, tuple(dict.fromkeys(_errors(check, context))))
    except NotApplicable as reason:
        return Result(name, skipped=str(reason))


def _errors(check: Check[T], context: T) -> Iterator[str]:
    try:
        yield from check(context)
    except NotApplicable:
        raise
    except (Exception, SystemExit) as error:
        yield raised(error)


def raised(error: BaseException, subject: str = "it") -> str:
    """Describe an exception in a sentence: `act raised ValueError: ...`."""
    try:
        text = str(error)
    except Exception:  # of the user's class
        text = ""
    return f"{subject} raised {type(error).__name__}: {text}".rstrip(": ")


def name_of(subject: object) -> str:
    """Return the name of a class or function, or the class name of an object."""
    return str(getattr(subject, "__name__", None) or type(subject).__name__)
