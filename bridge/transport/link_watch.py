"""The links of a session that only connects: when the last one is gone, and when there is one again."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import zenoh
from zenoh.handlers import Callback


class LinkWatch:
    """Reports when a session without listeners has no link any more, and when it has one again.

    Zenoh goes on connecting by itself.

    Args:
        session: it listens on no endpoint.
        endpoints: to which it connects.
        report: called with a sentence, in a thread of Zenoh's.
    """

    def __init__(self, session: zenoh.Session, endpoints: Sequence[str], report: Callable[[str], None]) -> None:
        self._endpoints, self._report = " or ".join(endpoints), report
        self._links, self._is_lost = 0, False
        self._listener: zenoh.LinkEventsListener[None] | None = session.info.declare_link_events_listener(
            Callback(self._on_link, indirect=False), history=True
        )

    def close(self) -> None:
        """Report nothing more; idempotent."""
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.undeclare()  # type: ignore[no-untyped-call]

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        self._links += 1 if event.kind == zenoh.SampleKind.PUT else -1
        if self._links == 0:
            self._is_lost = True
            self._report(
                f"the connection to {self._endpoints} is lost, so no other program reaches this node; it goes on, and "
                "connects again as soon as it can"
            )
        elif self._links == 1 and self._is_lost:
            self._is_lost = False
            self._report(f"connected to {self._endpoints} again")
