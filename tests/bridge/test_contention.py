"""Cores of an engine and its node while other programs need them: real processes, real scheduling."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import psutil
import pytest
from support.nodes import until

from zenostat.bridge.runtime.contention import CorePlacement

CORES = sorted(os.sched_getaffinity(0))
pytestmark = pytest.mark.skipif(len(CORES) < 2, reason="there is one core")

Spin = Callable[[], int]


@pytest.fixture
def spin() -> Iterator[Spin]:
    """Start a process that computes without end on the first core; return its process id."""
    with ExitStack() as stack:

        def start() -> int:
            process = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(process.kill)
            os.sched_setaffinity(process.pid, CORES[:1])
            return process.pid

        yield start


def samples(placement: CorePlacement, engine: int) -> Callable[[], bool]:
    """Return a condition that counts samples and asks whether the operating system places the engine."""

    def released() -> bool:
        for _ in range(CorePlacement.SAMPLES):
            placement.count(engine)
        return placement.released

    return released


def test_engine_that_waits_for_its_core__is_released_and_later_pinned_again(spin: Spin) -> None:
    placement = CorePlacement(CORES[0], CORES[1], CORES)
    engine = spin()
    spin()
    released = samples(placement, engine)
    until(released, "the engine is released")
    assert os.sched_getaffinity(engine) == {*CORES}
    until(lambda: not released(), "it is pinned again")
    assert os.sched_getaffinity(engine) == {CORES[0]}


def test_next_engine__is_released_as_well(spin: Spin) -> None:
    placement = CorePlacement(CORES[0], CORES[1], CORES)
    engine = spin()
    spin()
    until(samples(placement, engine), "the engine is released")
    after = spin()
    placement.count(after)
    assert os.sched_getaffinity(after) == {*CORES}


def test_threads_of_the_node__follow_the_engine_and_others_stay(spin: Spin) -> None:
    placement = CorePlacement(CORES[0], CORES[1], CORES)
    engine = spin()
    spin()
    released = samples(placement, engine)
    ready, end = threading.Barrier(3), threading.Event()
    threads: dict[int, int] = {}

    def wait(core: int) -> None:
        os.sched_setaffinity(0, {core})
        threads[core] = threading.get_native_id()
        ready.wait()
        end.wait()

    workers = [threading.Thread(target=wait, args=(core,)) for core in CORES[:2]]
    for worker in workers:
        worker.start()
    try:
        ready.wait()
        until(released, "the engine is released")
        assert os.sched_getaffinity(threads[CORES[1]]) == {*CORES}
        assert os.sched_getaffinity(threads[CORES[0]]) == {CORES[0]}  # not one of the node's
        until(lambda: not released(), "all are pinned again")
        assert os.sched_getaffinity(threads[CORES[1]]) == {CORES[1]}
    finally:
        end.set()
        for worker in workers:
            worker.join()


def test_engine_that_sleeps__stays_on_its_core() -> None:
    placement = CorePlacement(CORES[0], CORES[1], CORES)
    code, pipe = "import sys; print(flush=True); sys.stdin.read()", subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe) as engine:
        assert engine.stdin is not None
        assert engine.stdout is not None
        os.sched_setaffinity(engine.pid, CORES[:1])
        engine.stdout.readline()  # its start needs the core
        until(lambda: psutil.Process(engine.pid).status() == psutil.STATUS_SLEEPING, "it sleeps")
        released = samples(placement, engine.pid)
        assert not any(released() for _ in range(2 * CorePlacement.WINDOW))
        assert os.sched_getaffinity(engine.pid) == {CORES[0]}
        engine.stdin.close()


def test_engine_that_has_ended__changes_nothing() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as engine:
        pass
    placement = CorePlacement(CORES[0], CORES[1], CORES)
    released = samples(placement, engine.pid)
    assert not any(released() for _ in range(2 * CorePlacement.WINDOW))
