"""Cores of an engine and its node while other programs need them: real processes, real scheduling."""

import multiprocessing
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import Any

import gymnasium as gym
import psutil
import pytest
from support.nodes import until

from zenostat.bridge.runtime.contention import CorePlacement, FollowedPlacement, own_threads

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


def released_engine(spin: Spin) -> tuple[int, CorePlacement, Callable[[], bool]]:
    """Start an engine beside another program on its core and release it; return the condition of `samples` as well."""
    placement = CorePlacement(CORES[0], CORES[1], CORES)
    engine = spin()
    spin()
    released = samples(placement, engine)
    until(released, "the engine is released")
    return engine, placement, released


def test_engine_that_waits_for_its_core__is_released_and_later_pinned_again(spin: Spin) -> None:
    engine, _, released = released_engine(spin)
    assert os.sched_getaffinity(engine) == {*CORES}
    until(lambda: not released(), "it is pinned again")
    assert os.sched_getaffinity(engine) == {CORES[0]}


def test_next_engine__is_released_as_well(spin: Spin) -> None:
    _, placement, _ = released_engine(spin)
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


def test_engine_that_is_pinned_while_released__is_released_again(spin: Spin) -> None:
    engine, _, released = released_engine(spin)
    os.sched_setaffinity(engine, CORES[:1])  # as an engine that was prefetched, when its episode begins
    assert released()
    assert os.sched_getaffinity(engine) == {*CORES}


def test_threads_that_follow_a_node__leave_its_core_and_return_with_it(spin: Spin) -> None:
    node, end = spin(), threading.Event()
    thread = threading.Thread(target=end.wait)
    thread.start()
    try:
        assert thread.native_id is not None
        os.sched_setaffinity(thread.native_id, CORES[:1])
        before = os.sched_getaffinity(0)
        placement = FollowedPlacement(node, CORES[0], {thread.native_id})

        def cores_after(node_cores: list[int]) -> set[int]:
            os.sched_setaffinity(node, node_cores)
            for _ in range(FollowedPlacement.SAMPLES):
                placement.count()
            return os.sched_getaffinity(thread.native_id or 0)

        assert cores_after(CORES) == {*CORES}
        assert cores_after(CORES[:1]) == {CORES[0]}
        assert os.sched_getaffinity(0) == before
    finally:
        end.set()
        thread.join()


def test_threads_of_a_node_that_has_ended__stay() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as node:
        pass
    before = os.sched_getaffinity(0)
    placement = FollowedPlacement(node.pid, CORES[0], {threading.get_native_id()})
    for _ in range(2 * FollowedPlacement.SAMPLES):
        placement.count()
    assert os.sched_getaffinity(0) == before


@pytest.mark.process
def test_bus_threads_of_an_environment__follow_its_local_node() -> None:
    """Zenoh starts most threads with the first session of a process, and later ones share them."""
    process = multiprocessing.get_context("spawn").Process(target=follow_a_local_node)
    process.start()
    process.join(120)
    assert process.exitcode == 0


def follow_a_local_node() -> None:
    before = own_threads()
    arguments: dict[str, Any] = {"begin": "07-01", "end": "07-31", "steps_per_hour": 4, "affinity": "apart"}
    with closing(gym.make("zenostat/ref-small-office-USA_CO_Denver-continuous-v1", **arguments)) as env:
        env.reset(seed=0)
        (node,) = (child.pid for child in psutil.Process().children() if "zenostat.eplus_node" in child.cmdline())
        (core,) = os.sched_getaffinity(node)
        threads = own_threads() - before
        pinned = [thread for thread in threads if os.sched_getaffinity(thread) == {core}]
        assert pinned
        os.sched_setaffinity(node, CORES)
        for _ in range(FollowedPlacement.SAMPLES):
            env.step(env.action_space.sample())
        assert all(os.sched_getaffinity(thread) == {*CORES} for thread in pinned)
