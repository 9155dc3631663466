"""The folded cache of saturation pressures: where it is expected, nowhere else, and each engine's own.

That it changes no result is shown by `test_fidelity.py`: years to the bit as EnergyPlus alone.
"""

from __future__ import annotations

import ctypes
import mmap
import sys
from collections.abc import Iterator

import psutil
import pytest
from forking import SMALL, engines, make

from eplus_node.memory import SaturationCache

SLOTS, WET_BULB, SATURATION, OTHERS = 1 << 20, 1 << 25, 1 << 24, 3 << 24
NOTHING_YET = -1000

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, (ctypes.c_size_t,)
libc.free.argtypes = (ctypes.c_void_p,)
libc.munmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t)

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the engine folds on Linux alone")


def _words(begin: int, length: int) -> ctypes.Array[ctypes.c_int64]:
    return (ctypes.c_int64 * (length // 8)).from_address(begin)


class Laid:
    """EnergyPlus's state and its caches as it lays them out: a pointer of a class, wet-bulb, saturation, two others.

    Entries of saturation pressures are of the temperatures 20.0 to 20.9 degC: key, then pressure.
    """

    def __init__(self) -> None:
        self.state = libc.malloc(4096)
        self.block = libc.malloc(8 + WET_BULB + SATURATION + OTHERS)
        self.pointers = _words(self.state, 4096)
        self.pointers[:] = [0, self.state, 1 << 62, *range(509)]
        self.pointers[77] = self.block
        _words(self.block, 8)[0] = 4711
        self.saturation = self.block + 8 + WET_BULB
        words = _words(self.saturation, SATURATION)
        words[::2] = [NOTHING_YET] * SLOTS
        for number in range(1000):
            key = self.key(20.0 + number / 1000)
            words[2 * (key % SLOTS) : 2 * (key % SLOTS) + 2] = [key, number]

    @staticmethod
    def key(celsius: float) -> int:
        """The upper 36 bits of the number."""
        return ctypes.c_int64.from_buffer(ctypes.c_double(celsius)).value >> 28

    def close(self) -> None:
        libc.free(self.block)
        libc.free(self.state)


@pytest.fixture
def laid() -> Iterator[Laid]:
    made = Laid()
    yield made
    made.close()


def test_the_block_is_moved_and_one_cache_of_it_folded(laid: Laid) -> None:
    _words(laid.block + 8, WET_BULB)[5] = 50
    _words(laid.saturation + SATURATION, OTHERS)[-1] = 60
    before = list(laid.pointers)
    cache = SaturationCache.fold(laid.state)
    assert cache is not None
    laid.block, moved = 0, laid.pointers[77]  # the old one was given back
    assert [place for place, word in enumerate(before) if laid.pointers[place] != word] == [77]
    assert cache.begin == moved + 8 + WET_BULB
    assert cache.begin % mmap.PAGESIZE == 0, "no entry lies across the boundary of what is folded"
    try:
        assert _words(moved, 8)[0] == 4711
        assert _words(moved + 8, WET_BULB)[5] == 50
        assert _words(cache.begin + SATURATION, OTHERS)[-1] == 60
        keys = _words(cache.begin, SATURATION)[::2]
        assert NOTHING_YET in keys[:1]
        assert set(keys) == {NOTHING_YET, 0}, "empty, and at the place of 0 degC no key of 0"
        _words(cache.begin, SATURATION)[100] = 99
        shown = [place for place, word in enumerate(_words(cache.begin, SATURATION)) if word == 99]
        assert len(shown) == 128
        assert {place % (SATURATION // 8 // 128) for place in shown} == {100}
        cache.renew()
        assert set(_words(cache.begin, SATURATION)[::2]) == {NOTHING_YET, 0}
    finally:
        libc.munmap(moved + 8 - mmap.PAGESIZE, mmap.PAGESIZE + WET_BULB + SATURATION + OTHERS)


def _no_pointer(laid: Laid) -> None:
    laid.pointers[77] = 0


def _two_pointers(laid: Laid) -> None:
    laid.pointers[78] = laid.block


def _never_used(laid: Laid) -> None:
    _words(laid.saturation, SATURATION)[::2] = [NOTHING_YET] * SLOTS


def _other_places(laid: Laid) -> None:
    words = _words(laid.saturation, SATURATION)
    words[::2] = [key + 1 if key != NOTHING_YET else key for key in words[::2]]


@pytest.mark.parametrize("other", [_no_pointer, _two_pointers, _never_used, _other_places])
def test_what_is_laid_out_otherwise_is_left_alone(laid: Laid, other: object) -> None:
    other(laid)  # type: ignore[operator]
    before, words = list(laid.pointers), _words(laid.saturation, SATURATION)[::2]
    assert SaturationCache.fold(laid.state) is None
    assert list(laid.pointers) == before
    assert _words(laid.saturation, SATURATION)[::2] == words


def test_a_block_of_another_size_is_left_alone(laid: Laid) -> None:
    other = libc.malloc(8 + WET_BULB + SATURATION + OTHERS + 2 * mmap.PAGESIZE)
    laid.pointers[77] = other
    assert SaturationCache.fold(laid.state) is None
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
