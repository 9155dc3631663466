"""Polling before sleeping, on clocks that advance only as a test determines."""

import random
from collections.abc import Iterable
from types import SimpleNamespace

import pytest

from zenostat.bridge.runtime import polling
from zenostat.bridge.runtime.polling import Polling

LIMIT_S = Polling.LIMIT_S
SHORT_S = LIMIT_S / 4
LONG_S = 50 * LIMIT_S


class Machine:
    """A machine with clocks of its own, and one thread that waits on it."""

    def __init__(self, patch: pytest.MonkeyPatch, *, cores: int | None = 4, enabled: bool = True) -> None:
        self.wall_s = self.cpu_s = 0.0
        self.attempts = self.sleeps = 0
        self.share = 1.0  # of the core, while the thread polls
        self.attempt_s = LIMIT_S / 1024
        clocks = SimpleNamespace(perf_counter=lambda: self.wall_s, thread_time=lambda: self.cpu_s)
        patch.setattr(polling, "time", clocks)
        patch.setattr(polling, "os", SimpleNamespace(cpu_count=lambda: cores))
        self.polling = Polling(enabled=enabled)

    def work(self, duration_s: float) -> None:
        """Let the thread compute between two waits."""
        self.wall_s += duration_s
        self.cpu_s += duration_s

    def wait(self, after_s: float, got: object = "message") -> object:
        """Wait for what comes after that time."""
        self.attempts = self.sleeps = 0
        due_s = self.wall_s + after_s

        def attempt() -> object:
            self.attempts += 1
            self.wall_s += self.attempt_s
            self.cpu_s += self.attempt_s * self.share
            return got if self.wall_s >= due_s else None

        def block() -> object:
            self.sleeps += 1
            self.wall_s = max(self.wall_s, due_s)
            return got

        return self.polling.wait(attempt, block)

    @property
    def polled_s(self) -> float:
        """Time for which the latest wait polled."""
        return self.attempts * self.attempt_s

    def waits_until(self, *, polls: bool, after_s: float) -> int:
        """Return how many such waits it takes until a wait polls, or no longer does; at most a thousand."""
        for count in range(1000):
            self.wait(after_s)
            if (self.attempts > 0) is polls:
                return count
        raise AssertionError(f"a thousand waits of {after_s} s do not change the polling")

    def settle(self, after_s: float = SHORT_S) -> None:
        """Wait so often that only such waits count, and that no judgment of the core is due soon."""
        for _ in range(2 * Polling.WINDOW):
            self.wait(after_s)


@pytest.mark.parametrize(("cores", "enabled"), [(1, True), (None, True), (4, False)])
def test_polling__it_never_polls_when_disabled_or_without_a_second_core(
    monkeypatch: pytest.MonkeyPatch, cores: int | None, enabled: bool
) -> None:
    machine = Machine(monkeypatch, cores=cores, enabled=enabled)
    for _ in range(3000):
        assert machine.wait(SHORT_S) == "message"
        assert (machine.attempts, machine.sleeps) == (0, 1)


@pytest.mark.parametrize("got", [0, b"", False, "", "message"])
def test_polling__only_none_means_nothing_yet(monkeypatch: pytest.MonkeyPatch, got: object) -> None:
    machine = Machine(monkeypatch)
    machine.settle()
    assert machine.wait(0.0, got) is got
    assert (machine.attempts, machine.sleeps) == (1, 0)


def test_polling__it_polls_only_once_it_has_measured_short_cycles(monkeypatch: pytest.MonkeyPatch) -> None:
    # The average starts at twice the limit: 2 * 0.9**n + 0.25 * (1 - 0.9**n) <= 1 from n = 9 on. The first cycle has
    # no beginning, and counts as a long one.
    machine = Machine(monkeypatch)
    assert machine.waits_until(polls=True, after_s=SHORT_S) == 1 + 9


def test_polling__short_wait_is_polled_for(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(monkeypatch)
    machine.settle()
    assert machine.wait(SHORT_S) == "message"
    assert machine.sleeps == 0
    assert machine.polled_s == pytest.approx(SHORT_S, abs=machine.attempt_s)


def test_polling__it_polls_for_up_to_twice_its_typical_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(monkeypatch)
    machine.settle(LIMIT_S / 8)
    machine.wait(1.0)
    assert machine.sleeps == 1
    assert machine.polled_s == pytest.approx(LIMIT_S / 4, rel=0.03)  # a few attempts


@pytest.mark.parametrize("seed", range(20))
def test_polling__it_never_polls_for_longer_than_the_limit(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    # Short cycles are the most likely, so that it polls; each tenth wait is up to fifty times as long as the limit.
    rng, machine = random.Random(seed), Machine(monkeypatch)
    machine.attempt_s = LIMIT_S / 64
    polled = 0
    for _ in range(2000):
        machine.wait(rng.uniform(0.0, LONG_S if rng.random() < 0.1 else 1.2 * LIMIT_S))
        assert machine.polled_s <= LIMIT_S + machine.attempt_s
        polled += machine.attempts > 0
    assert polled > 0


def test_polling__it_stops_after_a_few_long_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    # The average of the cycle rises from 0.25 of the limit towards 2: 2 - 1.75 * 0.9**n > 1 from n = 6 on.
    machine = Machine(monkeypatch)
    machine.settle()
    assert machine.waits_until(polls=False, after_s=LONG_S) == 6
    for _ in range(3000):
        machine.wait(LONG_S)
        assert machine.attempts == 0


def test_polling__it_polls_again_after_a_few_short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    # From 2 down to 0.25 of the limit: 0.25 + 1.75 * 0.9**n <= 1 from n = 9 on. An hour counts as much as twice the
    # limit.
    machine = Machine(monkeypatch)
    machine.settle()
    machine.settle(3600.0)
    assert machine.waits_until(polls=True, after_s=SHORT_S) == 9


def test_polling__long_pause_does_not_stop_it(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(monkeypatch)
    machine.settle()
    for _ in range(10):
        machine.wait(3600.0)
        assert machine.attempts > 0
        for _ in range(30):
            machine.wait(SHORT_S)
            assert machine.sleeps == 0


def test_polling__long_pause_hardly_lengthens_the_polling(monkeypatch: pytest.MonkeyPatch) -> None:
    # An hour counts as no more than the limit: 0.9**22 of it is less than a tenth.
    machine = Machine(monkeypatch)
    usual_s = LIMIT_S / 8
    machine.settle(usual_s)
    machine.wait(3600.0)
    for _ in range(22):
        machine.wait(usual_s)
    machine.wait(1.0)
    assert machine.polled_s <= 2 * (usual_s + 0.1 * 0.1 * LIMIT_S) + 2 * machine.attempt_s


@pytest.mark.parametrize(("work_s", "polls"), [(0.6 * LIMIT_S, True), (0.9 * LIMIT_S, False), (LONG_S, False)])
def test_polling__length_of_the_cycle_decides(monkeypatch: pytest.MonkeyPatch, work_s: float, polls: bool) -> None:
    # The waits are equally short, but a saved wake-up matters less the longer the rest of the cycle.
    machine = Machine(monkeypatch)
    for _ in range(2 * Polling.WINDOW):
        machine.work(work_s)
        machine.wait(SHORT_S)
    assert (machine.attempts > 0) is polls


def _polled(machine: Machine, waits: Iterable[float]) -> list[bool]:
    polled = []
    for after_s in waits:
        assert machine.wait(after_s) == "message"
        polled.append(machine.attempts > 0)
    return polled


def test_polling__shared_core_is_not_polled_on_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    # The rest of a window at half a core -> 1024 waits that sleep at once -> polls again
    machine = Machine(monkeypatch)
    machine.settle()
    machine.share = 0.5
    window, pause = Polling.WINDOW, Polling.PAUSE
    assert _polled(machine, [SHORT_S] * (window + pause + 1)) == [True] * window + [False] * pause + [True]


@pytest.mark.parametrize(("share", "goes_on"), [(1.0, True), (0.65, True), (0.55, False)])
def test_polling__share_of_the_core_decides(monkeypatch: pytest.MonkeyPatch, share: float, goes_on: bool) -> None:
    machine = Machine(monkeypatch)
    machine.settle()
    machine.share = share
    machine.settle()
    machine.wait(SHORT_S)
    assert (machine.attempts > 0) is goes_on


def test_polling__sleeping_is_not_taken_for_a_lost_core(monkeypatch: pytest.MonkeyPatch) -> None:
    # The thread uses no core while it sleeps; only the time that it polled shows whose the core is. One wait in four
    # outlasts the polling, and the average of the cycle, at most 0.76 of the limit, stays below it.
    machine = Machine(monkeypatch)
    machine.settle()
    assert all(_polled(machine, [SHORT_S, SHORT_S, SHORT_S, LONG_S] * Polling.WINDOW))


def test_polling__each_window_is_judged_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    # Ten windows with a core to itself do not make up for one without.
    machine = Machine(monkeypatch)
    for _ in range(5):
        machine.settle()
    machine.share = 0.3
    assert _polled(machine, [SHORT_S] * (Polling.WINDOW + 1)) == [True] * Polling.WINDOW + [False]
