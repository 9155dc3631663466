"""The wrappers around an environment, which the environment does not keep alive."""

from __future__ import annotations

import copy
from typing import Any
from weakref import WeakSet


class WrapperSet(WeakSet[Any]):
    """Weak references to wrappers; a deep copy of them with their environment refers to their copies."""

    def __deepcopy__(self, memo: dict[int, Any]) -> WrapperSet:
        """Return a set of the copies, of which those that are no part of what is copied end with the copying."""
        copied = memo[id(self)] = WrapperSet()
        copied.update(copy.deepcopy(list(self), memo))
        return copied
