"""Disown buses in a forked process: they stay with the parent, because Zenoh's threads do not survive a fork."""

from __future__ import annotations

import os
from typing import Any, Protocol
from weakref import WeakSet

from zenostat.bridge.transport.session import FORKED
from zenostat.topics.errors import BusError


class Disownable(Protocol):
    """An object that cannot be used in a forked process."""

    def forked(self) -> None:
        """Disown it; called in the forked process before anything else runs there."""


class ForkedSession:
    """Replacement for a session, because using one would wait for threads that do not exist."""

    def __getattr__(self, name: str) -> Any:
        raise BusError(FORKED)


open_buses: WeakSet[Disownable] = WeakSet()
"""The buses of this process."""

_parent_objects: list[object] = []


def keep(*objects: object) -> None:
    """Keep the parent's Zenoh objects until this process ends: freeing them would wait for threads of the parent."""
    _parent_objects.extend(objects)


def _disown() -> None:
    for bus in [*open_buses]:
        bus.forked()
    open_buses.clear()


os.register_at_fork(after_in_child=_disown)
