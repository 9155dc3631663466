"""The engines of a node, wherever they are: simulating, waiting, started ahead, or on their way."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from topics.errors import EngineDied

if TYPE_CHECKING:
    from eplus_node.engine.client import EngineClient

UNRESPONSIVE_S = 10.0
"""Default of the time after which an engine that neither answers nor uses processor time is given up."""
_HURRY_S = 1.0
"""The same for a node that ends."""


class EngineRegistry:
    """All engines of a node that have not been closed; any thread may call it.

    Args:
        unresponsive_s: time in which an engine that is waited for must answer or use processor time.

    Attributes:
        closing: the node ends; no engine starts any more.
    """

    def __init__(self, unresponsive_s: float = UNRESPONSIVE_S) -> None:
        self._unresponsive_s = unresponsive_s
        self._links: set[EngineClient] = set()
        self._lock = threading.Lock()
        self.closing = False

    @property
    def unresponsive_s(self) -> float:
        """Time in which an engine must answer or use processor time; short once the node ends."""
        return min(self._unresponsive_s, _HURRY_S) if self.closing else self._unresponsive_s

    def check_open(self) -> None:
        """Whether engines may start; `EngineDied` if the node ends."""
        if self.closing:
            raise EngineDied("the node ends, and starts no engine any more")

    def add(self, link: EngineClient) -> None:
        """Has it interrupted with all others."""
        with self._lock:
            self._links.add(link)

    def remove(self, link: EngineClient) -> None:
        """It has ended; twice is fine."""
        with self._lock:
            self._links.discard(link)

    def close(self) -> None:
        """Lets no engine start any more, and gives up soon those that do not answer."""
        self.closing = True

    def interrupt(self) -> None:
        """Kills all engines, so that whoever waits for one is told; none starts any more."""
        self.close()
        with self._lock:
            links = [*self._links]
        for link in links:
            link.interrupt()
