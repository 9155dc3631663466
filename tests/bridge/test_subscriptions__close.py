"""Requests that a node has received and not handled when it leaves the bus."""

import threading
from pathlib import Path

import pytest
from support.nodes import PATIENCE_S, until

from zenostat.bridge.node.subscriptions import Subscriptions
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec, keys
from zenostat.topics.messages import Ack, ErrorReply, Message, Query, Stop, StopRecording


@pytest.mark.process
@pytest.mark.parametrize(
    ("topic", "request_sent", "reply"),
    [
        (keys.STOP, Stop(), Ack(episode=[0])),
        (keys.STOP_RECORDING, StopRecording(), ErrorReply(error="NodeLost", message="node 'office' is ending")),
    ],
)
def test_close__answers_requests_that_were_not_handled(
    folder: Path, topic: keys.Topic, request_sent: Message, reply: Message
) -> None:
    endpoint, handled, replies = f"unixsock-stream/{folder}/bus", list[Message](), list[Message]()

    def handle(request: Message) -> Message:
        handled.append(request)
        return Ack(episode=[0])

    with open_session(listen=[endpoint]) as node, open_session(connect=[endpoint]) as client:
        received = threading.Event()
        with Subscriptions(node, "office") as subscriptions:
            subscriptions.request(topic, type(request_sent), handle, on_receipt=lambda _: received.set())
            until(lambda: _has_queryable(client, topic), "the client knows of the queryable")

            def ask() -> None:
                payload = codec.encode(request_sent)
                for answer in client.get(topic.at("office", sender="panel"), payload=payload, timeout=1e6):
                    replies.append(codec.decode(type(reply), answer.ok.payload.to_bytes()))

            asking = threading.Thread(target=ask, daemon=True)
            asking.start()
            assert received.wait(PATIENCE_S)
        asking.join(PATIENCE_S)
        assert not asking.is_alive()
    assert replies == [reply]
    assert handled == ([Stop(source="panel")] if topic is keys.STOP else [])


def _has_queryable(client: object, topic: keys.Topic) -> bool:
    querier = client.declare_querier(topic.at("office", sender="panel" if topic.has_sender else ""))  # type: ignore[attr-defined]
    try:
        return bool(querier.matching_status.matching)
    finally:
        querier.undeclare()


@pytest.mark.process
def test_query__internal_error_is_replied_and_reported(folder: Path) -> None:
    endpoint, reported = f"unixsock-stream/{folder}/bus", list[str]()

    def answer(_: Query) -> bytes:
        raise KeyError("bug")

    with (
        open_session(listen=[endpoint]) as node,
        open_session(connect=[endpoint]) as client,
        Subscriptions(node, "office") as subscriptions,
    ):
        subscriptions.on_error = lambda topic, sender, error: reported.append(f"{topic.key} {sender}{error!r}")
        subscriptions.answer(keys.STATUS, answer)
        subscriptions.answer_in_background(keys.SEMANTIC, answer)
        for topic in (keys.STATUS, keys.SEMANTIC):
            until(lambda topic=topic: _has_queryable(client, topic), "the client knows of the queryable")
            (reply,) = client.get(topic.at("office"), timeout=PATIENCE_S)
            error = codec.decode(ErrorReply, reply.ok.payload.to_bytes())
            assert (error.error, error.message) == ("ZenostatError", "KeyError: 'bug'")
        subscriptions.run_pending()
    assert reported == ["rpc/status KeyError('bug')", "rpc/semantic KeyError('bug')"]
