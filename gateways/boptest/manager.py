"""The tests of a service, by id: selected, used, ended by their clients or after some time without a request."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from time import monotonic
from typing import Any
from uuid import uuid4

from zenostat.gateways.boptest.cases import TestCase, TestCases
from zenostat.gateways.boptest.extensions import ExtendedTest
from zenostat.gateways.boptest.parsing import BadRequest
from zenostat.gateways.boptest.prices import Rates
from zenostat.gateways.boptest.simulation import Interruption
from zenostat.gateways.boptest.test_periods import simulate_test_periods
from zenostat.topics.errors import ZenostatError

CHECK_S = 1.0


class UnknownTest(BadRequest):
    """No test with this id."""


class TooManyTests(BadRequest):
    """The service runs as many tests as it may."""


@dataclass(slots=True, eq=False)
class _Entry:
    """A test: being started, running, or failed to start."""

    case: TestCase
    client: str = ""
    started: threading.Event = field(default_factory=threading.Event)
    test: ExtendedTest | None = None
    error: ZenostatError | None = None
    used_s: float = field(default_factory=monotonic)
    parent: str = ""
    interruption: Interruption = field(default_factory=Interruption)
    is_kept: bool = False


class TestManager:
    """The running tests.

    Args:
        cases: the test cases.
        rates: prices and emission factors.
        timeout_s: a test ends after this time without a request.
        max_tests: maximum number of tests at a time.
        notify: called with a line for the operator.

    Attributes:
        cases, max_tests, notify: as above.
    """

    __test__ = False  # for pytest, which takes it for a test

    def __init__(
        self,
        cases: TestCases,
        rates: Rates,
        *,
        timeout_s: float = 900.0,
        max_tests: int = 16,
        notify: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.cases, self._rates = cases, rates
        self._timeout_s, self.max_tests, self.notify = timeout_s, max_tests, notify
        self._lock = threading.Lock()
        self._entries: dict[str, _Entry] = {}
        self._ending: dict[ExtendedTest, threading.Thread] = {}
        self._days_lock = threading.Lock()
        self._days: dict[str, dict[str, int]] = {}
        self._year = Interruption()
        self._closing = threading.Event()
        self._sweeper = threading.Thread(target=self._sweep, name="boptest-idle", daemon=True)
        self._sweeper.start()

    # Selection

    def select(self, name: str, client: str = "", *, keep: bool = False) -> str:
        """Start a test, and return its id when it runs.

        Args:
            name: the test case.
            client: name of the client that starts it; empty if it has none.
            keep: do not end it for want of requests.

        Raises:
            UnknownName: no such test case.
            TooManyTests: as many tests run as may.
            ZenostatError: the building cannot be started.
        """
        testid, entry = self._reserve(self.cases.find(name), client)
        entry.is_kept = keep
        self._start(testid, entry)
        if entry.error is not None:
            raise entry.error
        return testid

    def select_async(self, name: str, client: str = "") -> str:
        """Start a test in the background, and return its id at once; see `select` for the errors."""
        testid, entry = self._reserve(self.cases.find(name), client)
        threading.Thread(target=self._start, args=(testid, entry), name=f"boptest-{testid}", daemon=True).start()
        return testid

    def _reserve(self, case: TestCase, client: str) -> tuple[str, _Entry]:
        with self._lock:
            if self._closing.is_set():
                raise TooManyTests("the service is ending, and starts no more tests")
            if len(self._entries) >= self.max_tests:
                raise TooManyTests(f"{self.max_tests} tests are running, the maximum of this service; stop one first")
            testid, entry = str(uuid4()), _Entry(case, client)
            self._entries[testid] = entry
            return testid, entry

    def _start(self, testid: str, entry: _Entry) -> None:
        try:
            entry.test = ExtendedTest(
                entry.case,
                self._rates,
                lambda: self.days_of(entry.case),
                interruption=entry.interruption,
                client=entry.client,
            )
        except ZenostatError as error:
            entry.error = error
            if not entry.interruption.is_set:
                self.notify(f"{entry.case.name} cannot be started: {error}")
        except BaseException as error:
            entry.error = ZenostatError(f"{type(error).__name__}: {error}")
            raise
        finally:
            entry.used_s = monotonic()
            entry.started.set()
            with self._lock:
                if entry.error is not None or self._entries.get(testid) is not entry:
                    self._entries.pop(testid, None)
                    stopped = entry.test
                else:
                    stopped = None
            if stopped is not None:
                stopped.close()

    # Use

    def get(self, testid: str) -> ExtendedTest:
        """Return a test, when it runs.

        Raises:
            UnknownTest: there is none with this id.
        """
        entry = self._entry(testid)
        entry.started.wait()
        if entry.test is None:
            raise UnknownTest(testid)
        self._mark_used(entry)
        return entry.test

    def _mark_used(self, entry: _Entry | None) -> None:
        """Count a test as used now, and those of which it is a branch."""
        while entry is not None:
            entry.used_s = monotonic()
            entry = self._entries.get(entry.parent)

    @contextmanager
    def use(self, testid: str) -> Iterator[ExtendedTest]:
        """Hold a test for a request, alone; while it lasts and when it ends, the test counts as used.

        Raises:
            UnknownTest: there is none with this id, or it was stopped while this request waited for another one.
        """
        test, entry = self.get(testid), self._entry(testid)
        with test.lock:
            if test.is_stopped:
                raise UnknownTest(testid)
            try:
                yield test
            finally:
                self._mark_used(entry)
                self._end_branches(testid)

    def _end_branches(self, testid: str) -> None:
        """End the branches of a test that has replaced their node."""
        with self._lock:
            ended = [
                name
                for name, entry in self._entries.items()
                if entry.parent == testid and entry.test is not None and entry.test.is_stopped
            ]
            tests = [self._entries.pop(name).test for name in ended]
        for test in tests:
            if test is not None:
                self._end(test)

    def client_of(self, testid: str) -> str:
        """Return the name of the client that started a test, empty without one; `UnknownTest` if there is none."""
        return self._entry(testid).client

    def status(self, testid: str) -> str:
        """Return `Queued` or `Running`; `UnknownTest` if there is no such test."""
        return "Running" if self._entry(testid).started.is_set() else "Queued"

    def _entry(self, testid: str) -> _Entry:
        with self._lock:
            if testid not in self._entries:
                raise UnknownTest(testid)
            return self._entries[testid]

    def branch(self, testid: str, fields: Mapping[str, Any]) -> str:
        """Branch a test, and return the branch's id."""
        with self.use(testid) as test:
            branchid, entry = self._reserve(test.case, test.client)
            entry.parent = testid
            try:
                entry.test = test.branch(fields)
            except BaseException:
                with self._lock:
                    self._entries.pop(branchid, None)
                raise
            finally:
                entry.used_s = monotonic()
                entry.started.set()
            return branchid

    def stop(self, testid: str) -> None:
        """End a test and its branches; `UnknownTest` if there is none with this id.

        If a request of the test is in progress, it ends in the background, and the caller does not wait for it.
        """
        with self._lock:
            if testid not in self._entries:
                raise UnknownTest(testid)
            branches = [name for name, entry in self._entries.items() if entry.parent == testid]
            ended = [self._entries.pop(name) for name in (*branches, testid)]
        for entry in ended:
            if entry.test is not None:
                self._end(entry.test)
            else:  # it is starting
                entry.interruption.interrupt()

    def _end(self, test: ExtendedTest) -> None:
        if test.lock.acquire(blocking=False):
            try:
                test.close()
            finally:
                test.lock.release()
            return

        def close() -> None:
            with test.lock:
                test.close()
            with self._lock:
                del self._ending[test]

        test.interrupt()
        thread = threading.Thread(target=close, name="boptest-stop", daemon=True)
        with self._lock:
            self._ending[test] = thread
        thread.start()

    def days_of(self, case: TestCase) -> dict[str, int]:
        """Return the days of a test case's periods; simulate a year if they are not known."""
        if case.days is not None:
            return dict(case.days)
        with self._days_lock:
            if case.name not in self._days:
                self.notify(f"{case.name}: simulating a year to find its test periods, once")
                self._days[case.name] = simulate_test_periods(case.arguments, self._year)
                self.cases.save_days(case, self._days[case.name])
            return self._days[case.name]

    def tests(self) -> list[str]:
        """Return the ids of all tests."""
        with self._lock:
            return list(self._entries)

    def _sweep(self) -> None:
        while not self._closing.wait(min(CHECK_S, self._timeout_s / 4)):
            limit_s = monotonic() - self._timeout_s
            with self._lock:
                parents = {entry.parent for entry in self._entries.values()}
                idle = [
                    testid
                    for testid, entry in self._entries.items()
                    if entry.started.is_set() and not entry.is_kept and entry.used_s < limit_s and testid not in parents
                ]
            for testid in idle:
                self._end_idle(testid)

    def _end_idle(self, testid: str) -> None:
        with self._lock:
            entry = self._entries.get(testid)
        if entry is None or entry.test is None or not entry.test.lock.acquire(blocking=False):
            return  # it has ended, or a request is in progress
        is_idle = entry.used_s < monotonic() - self._timeout_s  # a request may have ended since the sweep began
        entry.test.lock.release()
        if not is_idle:
            return
        with suppress(UnknownTest):
            self.stop(testid)
            self.notify(f"test {testid} of {entry.case.name} ended after {self._timeout_s:g} s without a request")

    def interrupt(self) -> None:
        """End all simulations, so that the requests that wait for them are answered with an error."""
        self._closing.set()
        with self._lock:
            interruptions = [self._year, *(entry.interruption for entry in self._entries.values())]
            interruptions += [test.episodes.interruption for test in self._ending]
        for interruption in interruptions:
            interruption.interrupt()

    def close(self) -> None:
        """End all tests; idempotent."""
        self._closing.set()
        self._sweeper.join()
        for testid in self.tests():
            with suppress(UnknownTest):
                self.stop(testid)
        with self._lock:
            ending = list(self._ending.values())
        for thread in ending:
            thread.join()
