"""Numbers of examples that are tried of a property."""

from hypothesis import settings

ALL, QUICK, FAST = 100, 40, 10
"""Examples of each property by default: in `make test-all`, in `make test` and in `make test-fast`."""


def examples(count: int) -> int:
    """Return `count`, or in a shorter run its share of it, which is at least `FAST`."""
    profile = settings.default.max_examples
    return min(count, FAST) if profile == FAST else min(count, max(FAST, count * profile // ALL))
