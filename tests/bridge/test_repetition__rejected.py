"""Recorded messages that the node had rejected: the event of a message follows it, that of a request precedes it."""

import pytest

from zenostat.bridge.node.repetition import _is_rejected
from zenostat.bridge.recording.reader import RecordedItem
from zenostat.topics import codec
from zenostat.topics.messages import Ack, ErrorReply, Event, EventKind, Message
from zenostat.topics.recording import RecordedRequest


def event(kind: EventKind, source: str) -> RecordedItem:
    return RecordedItem("event", "Event", 0, codec.encode(Event(kind=kind, text="…", source=source)))


def request(sender: str, reply: Message) -> RecordedItem:
    record = RecordedRequest(
        payload=b"", encoding="", reply=codec.encode(reply), reply_encoding=codec.encoding(type(reply))
    )
    return RecordedItem(f"rpc/write/{sender}/damper", "RecordedRequest", 0, codec.encode(record))


ACCEPTED = Ack(episode=[1])
DENIED, UNKNOWN = (ErrorReply(error="RequestRejected", message=text) for text in ("…", "no point"))
ORDER = RecordedItem("orders", "RecordedOrder", 0, b"")


@pytest.mark.parametrize(
    ("following", "expected"),
    [
        ([], False),
        ([ORDER, event(EventKind.REJECTED, "mpc")], False),
        ([event(EventKind.REJECTED, "mpc")], True),
        ([event(EventKind.REJECTED, "mpc"), ORDER], True),
        ([event(EventKind.REJECTED, "mpc"), request("other", DENIED)], True),
        ([event(EventKind.REJECTED, "mpc"), request("mpc", DENIED)], False),  # of that request
        ([event(EventKind.REJECTED, "mpc"), request("mpc", ACCEPTED)], True),
        ([event(EventKind.REJECTED, "mpc"), request("mpc", UNKNOWN)], True),
        ([event(EventKind.REJECTED, "other"), ORDER], False),
        ([event(EventKind.LATE, "mpc"), ORDER], False),  # the exchange finds that itself
        ([event(EventKind.CONNECTED, "mpc"), ORDER], False),
    ],
)
def test_resumption__message_was_rejected_if_its_event_follows(following: list[RecordedItem], expected: bool) -> None:
    assert _is_rejected("mpc", following) is expected
