"""Requests that a node has received and not handled when it leaves the bus."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from support.nodes import PATIENCE_S, until

from bridge.node.subscriptions import Subscriptions
from bridge.transport.session import open_session
from topics import codec, keys
from topics.messages import Ack, Message, Stop


@pytest.mark.process
def test_close__ends_the_wait_for_requests_that_were_not_handled(folder: Path) -> None:
    endpoint, handled, replies = f"unixsock-stream/{folder}/bus", list[Stop](), list[object]()

    def handle(stop: Stop) -> Message:
        handled.append(stop)
        return Ack(episode=[0])

    with open_session(listen=[endpoint]) as node, open_session(connect=[endpoint]) as client:
        received = threading.Event()
        with Subscriptions(node, "office") as subscriptions:
            subscriptions.request(keys.STOP, Stop, handle, on_receipt=received.set)
            until(lambda: _has_queryable(client), "the client knows of the queryable")

            def ask() -> None:
                request = codec.encode(Stop())
                replies.extend(client.get(keys.STOP.at("office"), payload=request, timeout=1e6))

            asking = threading.Thread(target=ask, daemon=True)
            asking.start()
            assert received.wait(PATIENCE_S)
        asking.join(PATIENCE_S)
        assert not asking.is_alive()
    assert (handled, replies) == ([], [])


def _has_queryable(client: object) -> bool:
    querier = client.declare_querier(keys.STOP.at("office"))  # type: ignore[attr-defined]
    try:
        return bool(querier.matching_status.matching)
    finally:
        querier.undeclare()
