"""Lines for the operator of a gateway about what its clients cannot be told."""

from __future__ import annotations

from collections.abc import Callable

_MAX_TEXTS = 1000


class Notices:
    """Passes each text on once, however often a device repeats a request.

    Args:
        notify: called with each new text.
    """

    def __init__(self, notify: Callable[[str], None]) -> None:
        self._notify = notify
        self._texts: set[str] = set()

    def add(self, text: str) -> None:
        """Pass a text on unless it has been passed on before."""
        if text not in self._texts and len(self._texts) < _MAX_TEXTS:
            self._texts.add(text)
            self._notify(text)
