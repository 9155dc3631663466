"""The tests of a BOPTEST service, without a building."""

from threading import RLock
from time import monotonic

import pytest

from zenostat.gateways.boptest.cases import TestCase
from zenostat.gateways.boptest.manager import TestManager, UnknownTest, _Entry
from zenostat.gateways.boptest.prices import read_rates

TIMEOUT_S = 3600.0


class Building:
    """A test without a building, as far as the manager uses it."""

    def __init__(self) -> None:
        self.lock, self.is_stopped = RLock(), False

    def close(self) -> None:
        self.is_stopped = True


def test_boptest_manager__test_is_not_idle_after_a_request_longer_than_the_timeout() -> None:
    manager = TestManager(None, read_rates(), timeout_s=TIMEOUT_S)
    try:
        entry = manager._entries["a"] = _Entry(TestCase("small"))
        entry.test = Building()
        entry.started.set()
        with manager.use("a") as test:
            assert test is entry.test
            entry.used_s = monotonic() - 2 * TIMEOUT_S  # when the request began
        manager._end_idle("a")
        assert manager.tests() == ["a"]
        entry.used_s = monotonic() - 2 * TIMEOUT_S
        manager._end_idle("a")
        assert (manager.tests(), entry.test.is_stopped) == ([], True)
        with pytest.raises(UnknownTest), manager.use("a"):
            pass
    finally:
        manager.close()


def test_boptest_manager__test_is_not_idle_while_its_branch_is_used() -> None:
    manager = TestManager(None, read_rates(), timeout_s=TIMEOUT_S)
    try:
        for testid, parent in (("a", ""), ("b", "a"), ("c", "b")):
            entry = manager._entries[testid] = _Entry(TestCase("small"), parent=parent)
            entry.test, entry.used_s = Building(), monotonic() - 2 * TIMEOUT_S
            entry.started.set()
        with manager.use("c"):
            pass
        manager.stop("c")
        for testid in ("a", "b"):
            manager._end_idle(testid)
        assert manager.tests() == ["a", "b"]
    finally:
        manager.close()
