"""Queries for the latest message of a topic."""

from pathlib import Path

import pytest
from support.nodes import until

from zenostat.bridge.node.subscriptions import Subscriptions
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec, keys
from zenostat.topics.messages import ErrorReply


@pytest.mark.process
def test_answer_latest__query_before_the_first_message_is_rejected(folder: Path) -> None:
    endpoint, latest = f"unixsock-stream/{folder}/bus", [b""]
    with (
        open_session(listen=[endpoint]) as node,
        open_session(connect=[endpoint]) as client,
        Subscriptions(node, "office") as subscriptions,
    ):
        subscriptions.answer_latest(keys.SAMPLE, lambda: latest[0])
        querier = client.declare_querier(keys.SAMPLE.at("office"))
        until(lambda: querier.matching_status.matching, "the client knows of the queryable")
        error = codec.decode(ErrorReply, next(iter(querier.get())).ok.payload.to_bytes())
        assert (error.error, error.message) == ("RequestRejected", "node 'office' has no sample yet")
        latest[0] = b"sample"
        assert next(iter(querier.get())).ok.payload.to_bytes() == b"sample"
