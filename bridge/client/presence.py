"""Presence of a node on the bus, and undeclaring Zenoh's objects while another thread uses them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import zenoh
from zenoh.handlers import Callback

from zenostat.topics import keys
from zenostat.topics.errors import NodeLost
from zenostat.topics.messages import Manifest

_DISCOVERY_TIMEOUT_S = 10.0
_UNDECLARE_TIMEOUT_S = 2.0


class NodeWatch:
    """Watches the liveliness of one instance of a node.

    Args:
        session: A session on the node's bus.
        node: The node's name.
        on_loss: Called in a thread of Zenoh's when the node, or the connection to it, is lost.

    Attributes:
        lost: Whether it was lost since this was last set to False.
    """

    def __init__(self, session: zenoh.Session, node: str, on_loss: Callable[[], None]) -> None:
        self.lost = False
        self._session, self._node, self._on_loss = session, node, on_loss
        self._present = threading.Event()
        self._close = ExitStack()

    def watch(self, instance: str) -> None:
        """Watch this instance from now on, instead of any other."""
        self._close.close()
        self._present.clear()
        token, callback = keys.NODE_TOKEN.at(self._node, name=instance), Callback(self._on_token, indirect=False)
        subscriber: Any = self._session.liveliness().declare_subscriber(token, callback, history=True)
        self._close.callback(subscriber.undeclare)

    def _on_token(self, token: zenoh.Sample) -> None:
        if token.kind == zenoh.SampleKind.DELETE:
            self.lost = True
            self._present.clear()
            self._on_loss()
        else:
            self._present.set()

    def wait(self) -> bool:
        """Wait until the node is present; return whether it is, and was not lost meanwhile.

        Zenoh reports the loss of a token only to subscribers that have received it, and Zenoh 1.10 answers liveliness
        queries with nothing while a history is being delivered.
        """
        return self._present.wait(_DISCOVERY_TIMEOUT_S) and not self.lost

    def close(self) -> None:
        """Stop watching."""
        self._close.close()


def undeclare(declared: Any) -> None:
    """Undeclare a subscriber or publisher as soon as no other thread is using it."""
    deadline = time.monotonic() + _UNDECLARE_TIMEOUT_S
    while True:
        try:
            declared.undeclare()
        except RuntimeError:  # "Already borrowed": pyo3 lends an object to one thread at a time
            if time.monotonic() > deadline:
                return  # the caller is a signal handler in that same thread; closing the session undeclares it
            time.sleep(0.001)
        else:
            return


def check_interface(manifest: Manifest, previous: Manifest) -> None:
    """Raise `NodeLost` if a restarted node has another interface than before."""
    if _interface(manifest) != _interface(previous):
        raise NodeLost(
            f"node {manifest.node!r} was restarted with other points, slots or actions; "
            "connect another controller, or make another environment"
        )


def _interface(manifest: Manifest) -> tuple[Any, ...]:
    """Return the parts of a manifest that a controller relies on; weather and run period may differ after a restart."""
    return manifest.slots, manifest.sensors, manifest.meters, manifest.actuators, manifest.task, manifest.step_s
