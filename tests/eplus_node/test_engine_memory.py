"""The folded cache of saturation pressures: where it is expected, nowhere else, and each engine's own.

That it changes no result is shown by `test_fidelity.py`: years to the bit as EnergyPlus alone.
"""

from __future__ import annotations

import ctypes
import mmap
import sys
from collections.abc import Callable, Iterator

import psutil
import pytest
from support.engine_forks import SMALL, engines, make

from eplus_node.engine.memory import SaturationCache

SLOTS, HEAD, WET_BULB, SATURATION, BY_PRESSURE, SETTING, BY_ENTHALPY = 1 << 20, 8, 1 << 25, 1 << 24, 3 << 23, 8, 3 << 23
SETTING_AT = HEAD + WET_BULB + SATURATION + BY_PRESSURE
BLOCK = SETTING_AT + SETTING + BY_ENTHALPY
NOTHING_YET = -1000

libc = ctypes.CDLL(None)
libc.calloc.restype, libc.calloc.argtypes = ctypes.c_void_p, (ctypes.c_size_t, ctypes.c_size_t)
libc.free.argtypes = (ctypes.c_void_p,)
libc.munmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t)

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the engine folds on Linux alone")


def _words(begin: int, length: int) -> ctypes.Array[ctypes.c_int64]:
    return (ctypes.c_int64 * (length // 8)).from_address(begin)


class Laid:
    """EnergyPlus's state and its caches as it lays them out before a run: the pointer of a class, wet-bulb, saturation,
    by pressure, a setting of that one, by enthalpy."""

    def __init__(self) -> None:
        self.state = libc.calloc(1, 4096)
        self.block = libc.calloc(1, BLOCK)
        self.pointers = _words(self.state, 4096)
        self.pointers[:] = [0, self.state, 1 << 62, *range(509)]
        self.pointers[77] = self.block
        _words(self.block, HEAD)[0] = 4711
        _words(self.block + SETTING_AT, SETTING)[0] = 24
        self.saturation = self.block + HEAD + WET_BULB
        _words(self.saturation, SATURATION)[::2] = [NOTHING_YET] * SLOTS

    def close(self) -> None:
        libc.free(self.block)
        libc.free(self.state)


@pytest.fixture
def laid() -> Iterator[Laid]:
    made = Laid()
    yield made
    made.close()


def test_another_block_takes_its_place_with_one_cache_folded(laid: Laid) -> None:
    before = list(laid.pointers)
    cache = SaturationCache.shrink(laid.state)
    assert cache is not None
    laid.block, new = 0, laid.pointers[77]  # the old one was given back
    assert [place for place, word in enumerate(before) if laid.pointers[place] != word] == [77]
    assert cache.begin == new + HEAD + WET_BULB
    assert cache.begin % mmap.PAGESIZE == 0, "no entry lies across the boundary of what is folded"
    try:
        assert _words(new, HEAD)[0] == 4711
        assert _words(new + SETTING_AT, SETTING)[0] == 24
        assert not any(_words(new + HEAD, WET_BULB))
        assert not any(_words(cache.begin + SATURATION, BY_PRESSURE))
        assert not any(_words(new + SETTING_AT + SETTING, BY_ENTHALPY))
        keys = _words(cache.begin, SATURATION)[::2]
        assert NOTHING_YET in keys[:1]
        assert set(keys) == {NOTHING_YET, 0}, "empty, and at the place of 0 degC no key of 0"
        _words(cache.begin, SATURATION)[100] = 99
        shown = [place for place, word in enumerate(_words(cache.begin, SATURATION)) if word == 99]
        assert len(shown) == 128
        assert {place % (SATURATION // 8 // 128) for place in shown} == {100}
        cache.reset()
        assert set(_words(cache.begin, SATURATION)[::2]) == {NOTHING_YET, 0}
        _words(new + SETTING_AT + SETTING, BY_ENTHALPY)[-1] = 60  # there is room for all of it
    finally:
        libc.munmap(new + HEAD - mmap.PAGESIZE, mmap.PAGESIZE + BLOCK)


def _no_pointer(laid: Laid) -> None:
    laid.pointers[77] = 0


def _two_pointers(laid: Laid) -> None:
    laid.pointers[78] = laid.block


def _used(at: int) -> Callable[[Laid], None]:
    def use(laid: Laid) -> None:
        _words(laid.block + at, 8)[0] = 1

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
def test_what_is_laid_out_otherwise_or_used_is_left_alone(laid: Laid, other: str) -> None:
    OTHERS[other](laid)
    before, words = list(laid.pointers), bytes(_words(laid.block, BLOCK))
    assert SaturationCache.shrink(laid.state) is None
    assert list(laid.pointers) == before
    assert bytes(_words(laid.block, BLOCK)) == words


def test_a_block_of_another_size_is_left_alone(laid: Laid) -> None:
    other = libc.calloc(1, BLOCK + 2 * mmap.PAGESIZE)
    laid.pointers[77] = other
    assert SaturationCache.shrink(laid.state) is None
    libc.free(other)


def _folded(process: psutil.Process) -> tuple[int, set[str]]:
    """How much of a process's addresses shows a folded cache, and of which memory."""
    with open(f"/proc/{process.pid}/maps") as maps:
        lines = [line.split() for line in maps if "memfd:saturation" in line]
    spans = [[int(end, 16) for end in line[0].split("-")] for line in lines]
    return sum(end - begin for begin, end in spans), {line[4] for line in lines}


def test_each_engine_has_a_folded_cache_of_its_own() -> None:
    with make(SMALL) as env:
        env.reset(seed=0)
        env.step(env.action_space.sample())
        with env.branch() as branch:
            branch.step(env.action_space.sample())
            found = [_folded(process) for process in engines(env)]
            assert len(found) == 3, "at sample 0, of the episode, of the branch"
            assert {length for length, _ in found} == {SATURATION}
            assert all(len(of) == 1 for _, of in found)
            assert len(set.union(*(of for _, of in found))) == 3
