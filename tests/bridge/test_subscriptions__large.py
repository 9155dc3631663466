"""Large messages and requests that a node receives while it is busy: few of them may wait."""

from pathlib import Path

import pytest
import zenoh
from support.nodes import until

from zenostat.bridge.node.subscriptions import Subscriptions
from zenostat.bridge.node.waiting import LARGE_BYTES, MAX_LARGE
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec, keys
from zenostat.topics.messages import Ack, ErrorReply, Stop

FURTHER = 3


@pytest.mark.process
def test_subscriptions__few_large_messages_wait(folder: Path) -> None:
    endpoint, sizes = f"unixsock-stream/{folder}/bus", list[int]()
    key = keys.ACTUATOR.at("office", name="valve", sender="panel")
    with (
        open_session(listen=[endpoint]) as node,
        open_session(connect=[endpoint]) as client,
        Subscriptions(node, "office") as subscriptions,
    ):
        subscriptions.listen(keys.ACTUATOR, lambda _sender, _name, payload, _encoding: sizes.append(len(payload)))

        def send(count: int, size: int) -> None:
            for _ in range(count):
                client.put(key, bytes(size), congestion_control=zenoh.CongestionControl.BLOCK)

        publisher = client.declare_publisher(key)
        until(lambda: publisher.matching_status.matching, "the client knows of the subscriber")
        for dropped in (FURTHER, 2 * FURTHER):  # those that were handled make room
            send(MAX_LARGE + FURTHER, LARGE_BYTES)
            until(lambda dropped=dropped: subscriptions.rate_limited == dropped, "the further ones are dropped")
            send(1, LARGE_BYTES - 1)
            sizes.clear()
            until(lambda: subscriptions.run_pending() or len(sizes) == MAX_LARGE + 1, "all others are handled")
            assert sizes == [*[LARGE_BYTES] * MAX_LARGE, LARGE_BYTES - 1]


@pytest.mark.process
def test_subscriptions__further_large_requests_are_rejected(folder: Path) -> None:
    endpoint, handled = f"unixsock-stream/{folder}/bus", list[Stop]()
    key, large = keys.STOP.at("office", sender="panel"), bytes(LARGE_BYTES)
    with (
        open_session(listen=[endpoint]) as node,
        open_session(connect=[endpoint]) as client,
        Subscriptions(node, "office") as subscriptions,
    ):

        def handle(request: Stop) -> Ack:
            handled.append(request)
            return Ack(episode=[0])

        subscriptions.request(keys.STOP, Stop, handle)
        querier = client.declare_querier(key)
        until(lambda: querier.matching_status.matching, "the client knows of the queryable")
        waiting = [querier.get(payload=large) for _ in range(MAX_LARGE)]
        rejected = codec.decode(ErrorReply, next(iter(querier.get(payload=large))).ok.payload.to_bytes())
        assert (rejected.error, "large ones" in rejected.message) == ("RequestRejected", True)
        assert subscriptions.rate_limited == 1
        subscriptions.run_pending()
        errors = [codec.decode(ErrorReply, next(iter(replies)).ok.payload.to_bytes()) for replies in waiting]
        assert {error.error for error in errors} == {"BadMessage"}
        assert handled == []
