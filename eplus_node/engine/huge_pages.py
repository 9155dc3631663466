"""Memory mappings of the engine's own process: list them, and advise the kernel on huge pages."""

from __future__ import annotations

import ctypes
import mmap
from collections.abc import Iterator

HUGE_PAGE = 1 << 21

_MADV_COLLAPSE = 25
_madvise = ctypes.PyDLL(None).madvise
_madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)


def collapse_huge_pages() -> None:
    """Collapse the heap's small pages into huge ones, so that a fork has fewer page-table entries to copy.

    A forked process copies the memory that it writes to in small pages, and keeps them. Collapsing takes some 50 ms and
    halves the time of later forks; where pages are collapsed already it takes almost no time. Linux before 6.1 ignores
    it.
    """
    for begin, end in anonymous_regions():
        _advise(begin, end, _MADV_COLLAPSE)


def use_huge_pages(begin: int, end: int) -> None:
    """Let the kernel back a range of addresses with huge pages."""
    _advise(begin, end, mmap.MADV_HUGEPAGE)


def anonymous_regions() -> Iterator[tuple[int, int]]:
    """Begin and end of each writable private mapping without a file."""
    with open("/proc/self/maps") as maps:
        for span, access, _, _, inode, *_ in map(str.split, maps):
            if access == "rw-p" and inode == "0":
                begin, end = (int(address, 16) for address in span.split("-"))
                yield begin, end


def _advise(begin: int, end: int, advice: int) -> None:
    """Give advice on the huge pages within a range; kernels ignore advice that they do not support."""
    first, last = -(-begin // HUGE_PAGE) * HUGE_PAGE, end // HUGE_PAGE * HUGE_PAGE
    if first < last:
        _madvise(first, last - first, advice)
