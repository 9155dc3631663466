"""Buses in a forked process: they stay with the parent, since Zenoh's threads do not survive a fork."""

from __future__ import annotations

import os
from typing import Any, Protocol
from weakref import WeakSet

from bridge.transport.session import FORKED
from topics.errors import BusError


class Disownable(Protocol):
    """What cannot be used after a fork."""

    def forked(self) -> None:
        """Called in the forked process, before anything else runs there."""


class ForkedSession:
    """In place of a session, any use of which would wait for threads that are not there."""

    def __getattr__(self, name: str) -> Any:
        raise BusError(FORKED)


open_buses: WeakSet[Disownable] = WeakSet()
"""Those of this process."""

_of_parent: list[object] = []


def keep(*what: object) -> None:
    """Keep Zenoh's objects of the parent to the process's end: when they are freed they wait for its threads."""
    _of_parent.extend(what)


def _disown() -> None:
    for bus in [*open_buses]:
        bus.forked()
    open_buses.clear()


os.register_at_fork(after_in_child=_disown)
