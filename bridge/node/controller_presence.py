"""The liveliness tokens of controllers, and what follows when one appears or is lost."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

import zenoh
from zenoh.handlers import Callback

from zenostat.bridge.runtime.timer import Timer
from zenostat.topics import keys

_TOKEN_S = 10.0
"""Wall time within which the liveliness token of a controller with a claim or a copy has to be there, in s."""


class ControllerPresence:
    """Follows the liveliness tokens of controllers.

    Args:
        session: an open session.
        node: the node's name.
        post: runs a task in the server's thread.
        on_disconnect: called in that thread with the name of each controller whose token is lost.
        on_reconnect: called in that thread with the name of each controller whose token appears, for the first time or
            again.
    """

    def __init__(
        self,
        session: zenoh.Session,
        node: str,
        post: Callable[[Callable[[], None]], None],
        on_disconnect: Callable[[str], None],
        on_reconnect: Callable[[str], None],
    ) -> None:
        self._post, self._on_disconnect, self._on_reconnect = post, on_disconnect, on_reconnect
        self._present, self._expected = set[str](), set[str]()
        tokens, callback = keys.CONTROLLER_TOKEN.everywhere(node), Callback(self._on_token, indirect=False)
        self._subscriber = session.liveliness().declare_subscriber(tokens, callback, history=True)

    def close(self) -> None:
        """Follow them no longer."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def expect(self, name: str, timer: Timer) -> None:
        """Take a controller for disconnected if it has no token within 10 s: nothing would tell when it ends."""
        if name not in self._present and name not in self._expected:
            self._expected.add(name)
            timer.at(monotonic() + _TOKEN_S, lambda: self._post(lambda: self._check(name)))

    def _check(self, name: str) -> None:
        self._expected.discard(name)
        if name not in self._present:
            self._on_disconnect(name)

    def _on_token(self, token: zenoh.Sample) -> None:
        name = keys.last_chunk(str(token.key_expr))
        if token.kind != zenoh.SampleKind.DELETE:
            self._present.add(name)
            self._post(lambda: self._on_reconnect(name))
        else:
            self._present.discard(name)
            self._post(lambda: self._on_disconnect(name))
