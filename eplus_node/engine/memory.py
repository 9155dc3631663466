"""An engine's memory: pages joined for forks, and EnergyPlus's cache of saturation pressures folded.

Nothing here changes a result, and where the system or EnergyPlus is laid out otherwise nothing is done.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
from collections.abc import Iterator

_PAGE = mmap.PAGESIZE
_HUGE_PAGE = 1 << 21
_MADV_COLLAPSE = 25
_MAP_FIXED = 0x10
_MAP_FAILED = ctypes.c_void_p(-1).value

_LIBC = ctypes.PyDLL(None, use_errno=True)
_mmap, _madvise, _free, _malloc_usable_size = _LIBC.mmap, _LIBC.madvise, _LIBC.free, _LIBC.malloc_usable_size
_mmap.restype = ctypes.c_void_p
_mmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long)
_madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
_free.restype, _free.argtypes = None, (ctypes.c_void_p,)
_memcmp = _LIBC.memcmp
_memcmp.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
_malloc_usable_size.restype, _malloc_usable_size.argtypes = ctypes.c_size_t, (ctypes.c_void_p,)

_SLOTS = 1 << 20
"""Entries of each of EnergyPlus's psychrometric caches."""
_HEAD = 8
"""The pointer of its class."""
_WET_BULB = _SLOTS * 32
_SATURATION = _SLOTS * 16
_BY_PRESSURE = _SLOTS * 24
_PRECISION = 8
"""A setting of the cache before it."""
_BY_ENTHALPY = _SLOTS * 24
_BLOCK = _HEAD + _WET_BULB + _SATURATION + _BY_PRESSURE + _PRECISION + _BY_ENTHALPY
_PRECISION_AT = _HEAD + _WET_BULB + _SATURATION + _BY_PRESSURE
_MALLOC_HEAD, _MMAPPED = 16, 2
_NOTHING_YET = -1000
"""The key of an entry that has never been used."""
_WINDOW = 1 << 17


class SaturationCache:
    """EnergyPlus's cache of saturation pressures on 128 kB in place of 16 MB.

    EnergyPlus keeps 2**20 saturation pressures, each at the place that the low bits of its key (the temperature, cut
    to 36 bits) say. A timestep of a small building uses some 240 that it has not used before, all over the 16 MB:
    each costs a page in a forked engine, and a visit to main memory in any.

    Here 128 stretches of these addresses show the same memory. An entry carries its whole key, and EnergyPlus
    computes its pressure from the key and from nothing else: what another entry has displaced is computed anew, to
    the same bits. Only EnergyPlus's count of temperatures outside -100 to 200 degC may come out higher. The same does
    not hold for the other three caches, which stay as they are: saturation temperatures are computed from what was
    asked for first, and wet-bulb temperatures with their help.

    EnergyPlus has the four in one block that does not begin at a page's boundary, so another block takes its place,
    before anything is simulated: then there is nothing to copy. EnergyPlus could not give that one back; an engine
    leaves without that.
    """

    def __init__(self, begin: int) -> None:
        self.begin = begin

    @classmethod
    def shrink(cls, state: int) -> SaturationCache | None:
        """Folds that of a simulation that has not begun, by its state; None if it is not there as expected."""
        found = list(_blocks(state)) if sys.platform.startswith("linux") else []
        if len(found) != 1 or not _is_unused(found[0][1]):
            return None
        place, old = found[0]
        try:
            room = _map(None, _BLOCK + 2 * _HUGE_PAGE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, -1)
            first = (room // _HUGE_PAGE + 1) * _HUGE_PAGE  # of the first cache: a page is before it, for the head
            _advise(first, first - _HEAD + _BLOCK, mmap.MADV_HUGEPAGE)
            cache = cls(first + _WET_BULB)
            cache.reset()
        except OSError:
            return None  # no room: it stays where it is
        new = first - _HEAD
        for at, length in ((0, _HEAD), (_PRECISION_AT, _PRECISION)):  # the rest is nought
            ctypes.memmove(new + at, old + at, length)
        ctypes.c_void_p.from_address(place).value = new
        _free(old)
        return cache

    def reset(self) -> None:
        """Empties it into memory of its own: a forked engine must, which would share its parent's otherwise.

        Raises OSError if there is no room.
        """
        descriptor = os.memfd_create("saturation")
        try:
            os.truncate(descriptor, _WINDOW)
            for address in range(self.begin, self.begin + _SATURATION, _WINDOW):
                _map(address, _WINDOW, mmap.MAP_SHARED | _MAP_FIXED, descriptor)
        finally:
            os.close(descriptor)
        # Memory begins as zeros: no key of a temperature is 0 but that of 0 degC, whose place is the first.
        ctypes.c_int64.from_address(self.begin).value = _NOTHING_YET


def _blocks(state: int) -> Iterator[tuple[int, int]]:
    """Places in EnergyPlus's state that point to a block of the caches' size, and that block."""
    chunk = -(-(_BLOCK + _MALLOC_HEAD) // _PAGE) * _PAGE
    regions = list(_anonymous())
    for place in range(state, state + _malloc_usable_size(state), 8):
        block = ctypes.c_uint64.from_address(place).value
        begin = block - _MALLOC_HEAD
        if begin % _PAGE or not any(low <= begin and begin + chunk <= high for low, high in regions):
            continue
        if ctypes.c_uint64.from_address(block - 8).value == chunk | _MMAPPED:
            yield place, block


def _is_unused(block: int) -> bool:
    """Whether the block is as EnergyPlus makes it, to the byte: nought but for head, setting and unused keys."""
    saturation = block + _HEAD + _WET_BULB
    behind, setting = saturation + _SATURATION, block + _PRECISION_AT
    end = block + _malloc_usable_size(block)
    return (
        _repeats(block + _HEAD, saturation, (0,))
        and _repeats(saturation, behind, (_NOTHING_YET, 0))
        and _repeats(behind, setting, (0,))
        and _repeats(setting + _PRECISION, end, (0,))
    )


def _repeats(begin: int, end: int, words: tuple[int, ...]) -> bool:
    """Whether some memory is these 64-bit words again and again."""
    length = 8 * len(words)
    first = (ctypes.c_int64 * len(words)).from_address(begin)
    return tuple(first) == words and _memcmp(begin, begin + length, end - begin - length) == 0


def collapse_huge_pages() -> None:
    """Puts the heap's small pages into huge ones, so that there are fewer entries for a fork to copy.

    A forked process copies what it writes to in small pages, and its memory stays in them. This takes some 50 ms, and
    a fork half the time from then on; where the pages are joined already it takes next to nothing. Linux before 6.1
    does not know it, which makes no difference but that.
    """
    for begin, end in _anonymous():
        _advise(begin, end, _MADV_COLLAPSE)


def _anonymous() -> Iterator[tuple[int, int]]:
    """Begin and end of the process's writable private memory that is no file's."""
    with open("/proc/self/maps") as maps:
        for span, access, _, _, inode, *_ in map(str.split, maps):
            if access == "rw-p" and inode == "0":
                begin, end = (int(address, 16) for address in span.split("-"))
                yield begin, end


def _map(address: int | None, length: int, flags: int, descriptor: int) -> int:
    begin = _mmap(address, length, mmap.PROT_READ | mmap.PROT_WRITE, flags, descriptor, 0)
    if begin == _MAP_FAILED:
        raise OSError(ctypes.get_errno(), "the engine's memory cannot be mapped")
    return int(begin)


def _advise(begin: int, end: int, advice: int) -> None:
    """Tells the kernel of the huge pages that lie within; it may not know the advice."""
    first, last = -(-begin // _HUGE_PAGE) * _HUGE_PAGE, end // _HUGE_PAGE * _HUGE_PAGE
    if first < last:
        _madvise(first, last - first, advice)
