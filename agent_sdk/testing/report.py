"""What a list of checks found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

from topics.errors import InvalidConfig, did_you_mean

T = TypeVar("T")


@dataclass(frozen=True)
class Result:
    """One check.

    Attributes:
        name: what holds if it passes.
        faults: a sentence for each thing that does not hold.
        skipped: why it was not run; empty if it was.
    """

    name: str
    faults: tuple[str, ...] = ()
    skipped: str = ""

    @property
    def passed(self) -> bool:
        """Whether it was run and found nothing."""
        return not self.faults and not self.skipped

    def __str__(self) -> str:
        sign = "skipped" if self.skipped else "passed" if self.passed else "FAILED"
        notes = [self.skipped] if self.skipped else self.faults
        return "\n".join([f"{sign:7}  {self.name}", *(f"{'':9}{note}" for note in notes)])


@dataclass(frozen=True)
class Report:
    """All checks of one thing, in the order in which they ran. As text: a line for each, with its faults below.

    Attributes:
        subject: what was checked.
        results: of each check.
    """

    subject: str
    results: tuple[Result, ...]

    @property
    def passed(self) -> tuple[str, ...]:
        """Names of the checks that passed."""
        return tuple(r.name for r in self.results if r.passed)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of those that did not."""
        return tuple(r.name for r in self.results if r.faults)

    @property
    def skipped(self) -> tuple[str, ...]:
        """Names of those that were not run."""
        return tuple(r.name for r in self.results if r.skipped)

    def __str__(self) -> str:
        return "\n".join(
            [f"{self.subject}: {len(self.passed)} of {len(self.results)} checks passed", *map(str, self.results)]
        )

    def require(self) -> Report:
        """Itself.

        Raises:
            ConformanceError: a check failed.
        """
        if self.failed:
            raise ConformanceError(self)
        return self


class ConformanceError(AssertionError):
    """Something does not keep its contract. The text names each check that failed, with its faults.

    Attributes:
        report: all checks, also those that passed.
    """

    def __init__(self, report: Report) -> None:
        super().__init__(report)
        self.report = report

    def __str__(self) -> str:
        failed = [r for r in self.report.results if r.faults]
        head = f"{self.report.subject} fails {len(failed)} of {len(self.report.results)} checks"
        return "\n".join([head, *map(str, failed)])


Check = Callable[[T], Iterable[str]]
"""A check gives a sentence for each fault; an exception that it raises is one more."""


def run(subject: str, checks: Mapping[str, Check[T]], about: T, skip: Iterable[str]) -> Report:
    """Runs checks in order; if the first one fails, nothing else can be said and the others are skipped.

    Raises:
        InvalidConfig: `skip` names a check that is not there.
    """
    left_out = [skip] if isinstance(skip, str) else list(skip)
    for name in left_out:
        if name not in checks:
            raise InvalidConfig(f"skip: there is no check {name!r}; {did_you_mean(name, checks)}")
    results: list[Result] = []
    for name, check in checks.items():
        if name in left_out:
            results.append(Result(name, skipped="as asked"))
        elif results and results[0].faults:
            results.append(Result(name, skipped=f"the first check failed: {results[0].name}"))
        else:
            results.append(Result(name, tuple(dict.fromkeys(_faults(check, about)))))
    return Report(subject, tuple(results))


def _faults(check: Check[T], about: T) -> Iterator[str]:
    try:
        yield from check(about)
    except Exception as error:
        yield raised(error)


def raised(error: BaseException, what: str = "it") -> str:
    """An exception as a sentence: `act raised ValueError: ...`."""
    return f"{what} raised {type(error).__name__}: {error}".rstrip(": ")


def name_of(thing: object) -> str:
    """What a class, a function or an object is called."""
    return str(getattr(thing, "__name__", None) or type(thing).__name__)
