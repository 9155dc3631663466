"""Presence of a node on the bus, and leaving Zenoh's objects while another thread uses them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import zenoh
from zenoh.handlers import Callback

from topics import keys

_DISCOVERY_S = 10.0
_LEAVE_S = 2.0


class NodeWatch:
    """The liveliness of a node; `watch` says of which instance.

    Args:
        session: on the node's bus.
        node: its name.
        on_loss: called by a thread of Zenoh's when the node, or the way to it, is gone.

    Attributes:
        lost: whether that has happened since `lost` was last set to False.
    """

    def __init__(self, session: zenoh.Session, node: str, on_loss: Callable[[], None]) -> None:
        self.lost = False
        self._session, self._node, self._on_loss = session, node, on_loss
        self._there = threading.Event()
        self._close = ExitStack()

    def watch(self, instance: str) -> None:
        """Watch this instance from now on, in place of any other."""
        self._close.close()
        self._there.clear()
        token, heard = keys.NODE_TOKEN.at(self._node, name=instance), Callback(self._on_token, indirect=False)
        declared: Any = self._session.liveliness().declare_subscriber(token, heard, history=True)
        self._close.callback(declared.undeclare)

    def _on_token(self, token: zenoh.Sample) -> None:
        if token.kind == zenoh.SampleKind.DELETE:
            self.lost = True
            self._there.clear()
            self._on_loss()
        else:
            self._there.set()

    def wait(self) -> bool:
        """Wait until the node is there; whether it is, and was not lost meanwhile.

        A node's death is only told to who has heard of its life; and Zenoh 1.10 answers liveliness queries emptily
        while a history is on its way.
        """
        return self._there.wait(_DISCOVERY_S) and not self.lost

    def close(self) -> None:
        """Stop watching."""
        self._close.close()


def undeclare(declared: Any) -> None:
    """Undeclare a subscriber or publisher once the thread that is within it has left."""
    deadline = time.monotonic() + _LEAVE_S
    while True:
        try:
            declared.undeclare()
        except RuntimeError:  # "Already borrowed": pyo3 lends an object to one thread at a time
            if time.monotonic() > deadline:
                return  # the caller is a signal's handler in that very thread; the session's close undeclares it
            time.sleep(0.001)
        else:
            return
