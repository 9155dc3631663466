"""Delayed calls: their order, cancellation, and the thread that makes them."""

import math
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.clock import Clock
from support.nodes import until

from zenostat.bridge.runtime.timer import Timer


def nothing() -> None:
    """Wake the thread, which then looks at the clock."""


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def timer(clock: Clock) -> Iterator[Timer]:
    with Timer(clock) as running:
        yield running
    assert not [thread for thread in threading.enumerate() if thread.name == "timer"]


times = st.floats(0, 100)


@given(st.lists(times, max_size=30), st.sets(st.integers(0, 30)), times)
def test_timer__due_calls_run_in_order_and_the_rest_wait(dues: list[float], removed: set[int], now_s: float) -> None:
    clock, calls, ended = Clock(), list[int](), threading.Event()
    clock.now_s = -1.0  # nothing is due before all are there
    with Timer(clock) as timer:
        events = [timer.at(due, lambda i=i: calls.append(i)) for i, due in enumerate(dues)]
        for index in removed:
            if index < len(events):
                assert timer.cancel(events[index])
                assert not timer.cancel(events[index])
        clock.now_s = now_s
        timer.at(now_s, ended.set)
        timer._wakeup.set()
        assert ended.wait(30.0)
        kept = [i for i in range(len(dues)) if i not in removed]
        assert calls == sorted((i for i in kept if dues[i] <= now_s), key=lambda i: (dues[i], i))
        later = [dues[i] for i in kept if dues[i] > now_s]
        assert [event.time for event in timer._scheduler.queue] == sorted(later)


def test_timer__deadlines_that_were_met_do_not_pile_up(clock: Clock, timer: Timer) -> None:
    kept = timer.at(1e9, nothing)
    for step in range(10_000):
        timer.cancel(timer.at(step + 10.0, nothing))
    assert timer._scheduler.queue == [kept]


def test_timer__alarm_that_is_set_anew_each_step_does_not_wake_the_thread(clock: Clock, timer: Timer) -> None:
    alarm = timer.at(1000.0, nothing)
    until(lambda: timer._wakes_at_s == 1000.0, "the thread's waiting")
    for step in range(100):
        assert timer.cancel(alarm)
        alarm = timer.at(1001.0 + step, nothing)
        assert not timer._wakeup.is_set()


def test_timer__no_thread_before_it_is_used() -> None:
    with Timer():
        assert not [thread for thread in threading.enumerate() if thread.name == "timer"]


def test_timer__calls_are_due_by_the_clock_and_in_order(clock: Clock, timer: Timer) -> None:
    # due at 3000, 1000, 2000 s; the clock goes 0 → 2000 → 3000
    calls: list[int] = []
    for due in (3000, 1000, 2000):
        timer.at(float(due), lambda due=due: calls.append(due))
    timer.at(0.0, lambda: calls.append(0))
    until(lambda: calls == [0], "what is due at once")
    clock.now_s = 2000.0
    timer.at(0.0, nothing)
    until(lambda: calls == [0, 1000, 2000], "what is due at 2000")
    clock.now_s = 3000.0
    timer.at(0.0, nothing)
    until(lambda: calls == [0, 1000, 2000, 3000], "what is due at 3000")


def test_timer__earlier_call_is_not_kept_waiting_by_a_later_one() -> None:
    called = threading.Event()
    with Timer() as timer:
        timer.at(timer.clock() + 1e6, nothing)
        until(lambda: timer._wakes_at_s < math.inf, "the thread's waiting for the later call")
        timer.at(timer.clock() + 0.01, called.set)
        until(called.is_set, "the earlier call")


def test_timer__what_was_cancelled_does_not_come(clock: Clock, timer: Timer) -> None:
    calls: list[str] = []
    first = timer.at(1000.0, lambda: calls.append("cancelled"))
    second = timer.at(1000.0, lambda: calls.append("kept"))
    assert timer.cancel(first)
    clock.now_s = 1000.0
    timer.at(0.0, nothing)
    until(lambda: calls, "the one that was kept")
    assert calls == ["kept"]
    assert not timer.cancel(second)


def test_timer__call_may_ask_for_another(clock: Clock, timer: Timer) -> None:
    calls: list[str] = []
    timer.at(0.0, lambda: timer.at(0.0, lambda: calls.append("second")))
    until(lambda: calls == ["second"], "the call of a call")


def test_timer__reports_what_a_call_raises_and_makes_the_next_one(
    clock: Clock, timer: Timer, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages: list[str] = []
    monkeypatch.setattr(threading, "excepthook", lambda error: messages.append(str(error.exc_value)))
    called = threading.Event()

    def wrong() -> None:
        raise RuntimeError("a mistake")

    timer.at(0.0, wrong)
    timer.at(0.0, called.set)
    until(called.is_set, "the next call")
    assert messages == ["a mistake"]


def test_timer__close_ends_the_thread_and_nothing_follows(clock: Clock) -> None:
    timer, calls = Timer(clock), []
    timer.at(5.0, lambda: calls.append("late"))
    (thread,) = [thread for thread in threading.enumerate() if thread.name == "timer"]
    timer.close()
    timer.close()
    assert not thread.is_alive()
    clock.now_s = 9.0
    timer.at(0.0, lambda: calls.append("after"))
    assert not [thread for thread in threading.enumerate() if thread.name == "timer"]
    assert calls == []


def test_timer__timer_that_was_closed_starts_no_thread(clock: Clock) -> None:
    timer = Timer(clock)
    timer.close()
    timer.at(0.0, nothing)
    assert timer._thread is None


def test_timer__call_may_close_the_timer(clock: Clock) -> None:
    timer = Timer(clock)
    timer.at(0.0, timer.close)
    until(lambda: not [t for t in threading.enumerate() if t.name == "timer"], "the end of the thread")
    timer.close()


def test_timer__call_in_a_million_years_holds_up_nobody() -> None:
    """A slow pace has its next timestep then; waiting so long at once is more than a thread can."""
    timer, called = Timer(), threading.Event()
    timer.at(timer.clock() + 3e13, nothing)
    timer.at(timer.clock() + 0.05, called.set)
    assert called.wait(30.0)
    timer.close()
