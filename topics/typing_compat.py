"""Typing features that Python 3.11 does not have."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

_Method = TypeVar("_Method")

if TYPE_CHECKING:
    from typing_extensions import override
else:

    def override(method: _Method) -> _Method:
        """Mark a method that overrides one of a base class; without effect at run time."""
        return method


__all__ = ["override"]
