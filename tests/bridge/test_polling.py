"""Polling before sleeping, on clocks that go only when they are told to."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from bridge.runtime import polling
from bridge.runtime.polling import Polling

LIMIT_S = Polling.LIMIT_S


class Bench:
    """A machine with clocks of its own, and one thread that waits on it."""

    def __init__(self, patch: pytest.MonkeyPatch, *, cores: int | None = 4, enabled: bool = True) -> None:
        self.wall_s = self.cpu_s = 0.0
        self.attempts = self.sleeps = 0
        self.share = 1.0  # of the core, while the thread polls
        self.attempt_s = LIMIT_S / 64
        clocks = SimpleNamespace(perf_counter=lambda: self.wall_s, thread_time=lambda: self.cpu_s)
        patch.setattr(polling, "time", clocks)
        patch.setattr(polling, "os", SimpleNamespace(cpu_count=lambda: cores))
        self.polling = Polling(enabled=enabled)

    def wait(self, after_s: float, got: object = "message") -> object:
        """Waits for what comes after that time."""
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


@pytest.mark.parametrize(("cores", "enabled"), [(1, True), (None, True), (4, False)])
def test_without_leave_or_a_second_core_it_sleeps_at_once(
    monkeypatch: pytest.MonkeyPatch, cores: int | None, enabled: bool
) -> None:
    bench = Bench(monkeypatch, cores=cores, enabled=enabled)
    for _ in range(3000):
        assert bench.wait(LIMIT_S / 4) == "message"
        assert (bench.attempts, bench.sleeps) == (0, 1)


def test_what_is_there_is_taken_without_a_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    assert bench.wait(0.0) == "message"
    assert (bench.attempts, bench.sleeps) == (1, 0)


@pytest.mark.parametrize("got", [0, b"", False, ""])
def test_only_none_means_nothing_yet(monkeypatch: pytest.MonkeyPatch, got: object) -> None:
    bench = Bench(monkeypatch)
    assert bench.wait(0.0, got) is got
    assert bench.attempts == 1


def test_what_comes_soon_is_polled_for(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    assert bench.wait(LIMIT_S / 2) == "message"
    assert bench.attempts == pytest.approx(32, abs=1)
    assert bench.sleeps == 0


def test_what_comes_late_is_slept_for(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    assert bench.wait(1.0) == "message"
    assert bench.sleeps == 1
    assert bench.attempts == pytest.approx(LIMIT_S / bench.attempt_s, abs=1)
    assert bench.wall_s == 1.0


def test_it_polls_twice_as_long_as_it_usually_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    bench.attempt_s = LIMIT_S / 1024
    usual_s = LIMIT_S / 8
    for _ in range(200):
        bench.wait(usual_s)
        assert bench.sleeps == 0
    bench.wait(1.0)
    assert bench.sleeps == 1
    assert bench.attempts * bench.attempt_s == pytest.approx(2 * usual_s, rel=0.03)  # a few attempts


def test_it_never_polls_longer_than_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    for _ in range(200):
        bench.wait(50 * LIMIT_S)
        assert bench.attempts * bench.attempt_s <= LIMIT_S + bench.attempt_s


def test_a_long_pause_is_soon_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    # An hour counts as no more than the limit: 0.9**22 of it is less than a tenth.
    bench = Bench(monkeypatch)
    usual_s = LIMIT_S / 8
    for _ in range(400):
        bench.wait(usual_s)
    bench.wait(3600.0)
    for _ in range(22):
        bench.wait(usual_s)
    bench.wait(1.0)
    assert bench.attempts * bench.attempt_s <= 2 * (usual_s + 0.1 * 0.1 * LIMIT_S) + bench.attempt_s


def test_a_shared_core_is_left_alone_for_a_while_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    # 64 waits at half a core -> 1024 waits that sleep at once -> polls again
    bench = Bench(monkeypatch)
    bench.share = 0.5
    polled = []
    for _ in range(Polling.WINDOW + Polling.PAUSE + 1):
        assert bench.wait(LIMIT_S / 4) == "message"
        polled.append(bench.attempts > 0)
    assert polled == [True] * Polling.WINDOW + [False] * Polling.PAUSE + [True]


@pytest.mark.parametrize(("share", "goes_on"), [(1.0, True), (0.65, True), (0.55, False)])
def test_the_share_of_the_core_decides(monkeypatch: pytest.MonkeyPatch, share: float, goes_on: bool) -> None:
    bench = Bench(monkeypatch)
    bench.share = share
    for _ in range(Polling.WINDOW):
        bench.wait(LIMIT_S / 4)
    bench.wait(LIMIT_S / 4)
    assert (bench.attempts > 0) is goes_on


def test_sleeping_is_not_taken_for_a_lost_core(monkeypatch: pytest.MonkeyPatch) -> None:
    # The thread uses no core while it sleeps; only the time that it polled says whose the core is.
    bench = Bench(monkeypatch)
    for _ in range(2 * Polling.WINDOW + 1):
        bench.wait(1.0)
        assert bench.attempts > 0
        assert bench.sleeps == 1


def test_each_window_is_judged_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    # Ten windows with a core to itself do not make up for one without.
    bench = Bench(monkeypatch)
    for _ in range(10 * Polling.WINDOW):
        bench.wait(LIMIT_S / 4)
    bench.share = 0.3
    for _ in range(Polling.WINDOW):
        bench.wait(LIMIT_S / 4)
    bench.wait(LIMIT_S / 4)
    assert bench.attempts == 0
