"""Numbers of examples that are tried of a property."""

from hypothesis import settings

FAST = 10
"""Examples of each property in `make test-fast`."""


def examples(count: int) -> int:
    """Return `count`, or what the fast profile allows."""
    return min(count, FAST) if settings.default.max_examples == FAST else count
