"""`shrink_caches`: only where the memory is laid out as expected, one cache per engine, and nothing when it is off.

`test_fidelity.py` shows that it changes no result: years equal EnergyPlus alone to the bit.
"""

import ctypes
import mmap
from collections.abc import Callable, Iterator
from typing import Any

import psutil
import pytest
from support.engine_forks import FOUR, SMALL, Row, engines, episode, go, make, plan, same

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.eplus_node.engine.memory import SaturationCache

SLOTS, HEAD, WET_BULB, SATURATION, BY_PRESSURE, SETTING, BY_ENTHALPY = 1 << 20, 8, 1 << 25, 1 << 24, 3 << 23, 8, 3 << 23
SETTING_AT = HEAD + WET_BULB + SATURATION + BY_PRESSURE
BLOCK = SETTING_AT + SETTING + BY_ENTHALPY
UNUSED_KEY = -1000

libc = ctypes.CDLL(None)
libc.calloc.restype, libc.calloc.argtypes = ctypes.c_void_p, (ctypes.c_size_t, ctypes.c_size_t)
libc.free.argtypes = (ctypes.c_void_p,)
libc.munmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t)


def _words(begin: int, length: int) -> ctypes.Array[ctypes.c_int64]:
    return (ctypes.c_int64 * (length // 8)).from_address(begin)


class Layout:
    """EnergyPlus's state and its caches before a run: the pointer to a virtual table, wet-bulb, saturation, by pressure
    and its setting, by enthalpy."""

    def __init__(self) -> None:
        self.state = libc.calloc(1, 4096)
        self.block = libc.calloc(1, BLOCK)
        self.pointers = _words(self.state, 4096)
        self.pointers[:] = [0, self.state, 1 << 62, *range(509)]
        self.pointers[77] = self.block
        _words(self.block, HEAD)[0] = 4711
        _words(self.block + SETTING_AT, SETTING)[0] = 24
        self.saturation = self.block + HEAD + WET_BULB
        _words(self.saturation, SATURATION)[::2] = [UNUSED_KEY] * SLOTS

    def close(self) -> None:
        libc.free(self.block)
        libc.free(self.state)


@pytest.fixture
def layout() -> Iterator[Layout]:
    layout = Layout()
    yield layout
    layout.close()


@pytest.mark.slow
def test_shrink__replaces_the_block(layout: Layout) -> None:
    before = list(layout.pointers)
    cache = SaturationCache.shrink(layout.state)
    assert cache is not None
    layout.block, new = 0, layout.pointers[77]  # the old one was freed
    assert [place for place, word in enumerate(before) if layout.pointers[place] != word] == [77]
    assert cache.begin == new + HEAD + WET_BULB
    assert cache.begin % mmap.PAGESIZE == 0, "no entry crosses the boundary of the shrunk cache"
    try:
        assert _words(new, HEAD)[0] == 4711
        assert _words(new + SETTING_AT, SETTING)[0] == 24
        assert not any(_words(new + HEAD, WET_BULB))
        assert not any(_words(cache.begin + SATURATION, BY_PRESSURE))
        assert not any(_words(new + SETTING_AT + SETTING, BY_ENTHALPY))
        keys = _words(cache.begin, SATURATION)[::2]
        assert UNUSED_KEY in keys[:1]
        assert set(keys) == {UNUSED_KEY, 0}, "empty, and no key 0 at the index of 0 degC"
        _words(cache.begin, SATURATION)[100] = 99
        shown = [place for place, word in enumerate(_words(cache.begin, SATURATION)) if word == 99]
        assert len(shown) == 128
        assert {place % (SATURATION // 8 // 128) for place in shown} == {100}
        cache.reset()
        assert set(_words(cache.begin, SATURATION)[::2]) == {UNUSED_KEY, 0}
        _words(new + SETTING_AT + SETTING, BY_ENTHALPY)[-1] = 60  # the whole block is writable
    finally:
        libc.munmap(new + HEAD - mmap.PAGESIZE, mmap.PAGESIZE + BLOCK)


def _no_pointer(layout: Layout) -> None:
    layout.pointers[77] = 0


def _two_pointers(layout: Layout) -> None:
    layout.pointers[78] = layout.block


def _used(at: int) -> Callable[[Layout], None]:
    def use(layout: Layout) -> None:
        _words(layout.block + at, 8)[0] = 1

    return use


OTHERS = {
    "no pointer": _no_pointer,
    "two pointers": _two_pointers,
    "first wet bulb": _used(HEAD),
    "last wet bulb": _used(HEAD + WET_BULB - 8),
    "first key": _used(HEAD + WET_BULB),
    "last pressure": _used(HEAD + WET_BULB + SATURATION - 8),
    "first by pressure": _used(HEAD + WET_BULB + SATURATION),
    "last by pressure": _used(SETTING_AT - 8),
    "first by enthalpy": _used(SETTING_AT + SETTING),
    "last by enthalpy": _used(BLOCK - 8),
    "behind them": _used(BLOCK),
}


@pytest.mark.parametrize("other", OTHERS)
def test_shrink__leaves_other_or_used_memory_alone(layout: Layout, other: str) -> None:
    OTHERS[other](layout)
    before, words = list(layout.pointers), bytes(_words(layout.block, BLOCK))
    assert SaturationCache.shrink(layout.state) is None
    assert list(layout.pointers) == before
    assert bytes(_words(layout.block, BLOCK)) == words


def test_shrink__leaves_a_block_of_another_size_alone(layout: Layout) -> None:
    other = libc.calloc(1, BLOCK + 2 * mmap.PAGESIZE)
    layout.pointers[77] = other
    assert SaturationCache.shrink(layout.state) is None
    libc.free(other)


def _mappings(process: psutil.Process) -> tuple[int, set[str]]:
    """Return the length of the addresses that map a shrunk cache, and the inodes of its memory."""
    with open(f"/proc/{process.pid}/maps") as maps:
        lines = [line.split() for line in maps if "memfd:saturation" in line]
    spans = [[int(end, 16) for end in line[0].split("-")] for line in lines]
    return sum(end - begin for begin, end in spans), {line[4] for line in lines}


@pytest.mark.slow
def test_shrink_caches__each_engine_has_a_cache_of_its_own() -> None:
    with make(SMALL) as env:
        env.reset(seed=0)
        env.step(env.action_space.sample())
        with env.branch() as branch:
            branch.step(env.action_space.sample())
            mappings = [_mappings(process) for process in engines(env)]
            assert len(mappings) == 3, "the template, the episode's engine, the branch's engine"
            assert {length for length, _ in mappings} == {SATURATION}
            assert all(len(inodes) == 1 for _, inodes in mappings)
            assert len(set.union(*(inodes for _, inodes in mappings))) == 3


def _play(env: BuildingEnv, actions: list[Any]) -> list[Row]:
    """Step through an episode, its last part in a branch, and return all samples."""
    rows = episode(env, actions[:40], seed=0)
    with env.branch() as branch:
        return [*rows, *go(branch, actions[40:])]


@pytest.mark.slow
def test_shrink_caches__off_leaves_the_memory_alone_with_equal_results() -> None:
    with make(SMALL, **FOUR) as env:
        actions = plan(env, seed=3)
        expected = _play(env, actions)
    with make(SMALL, **FOUR, shrink_caches=False) as env:
        same(_play(env, actions), expected)
        assert [_mappings(process) for process in engines(env)] == [(0, set())] * len(engines(env))
        assert engines(env)
