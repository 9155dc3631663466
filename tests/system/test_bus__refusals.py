"""Refusals reach the one who asked: by the source of a write, by the reply of a query."""

import math

import msgpack
import pytest
import zenoh
from support.nodes import until
from zenoh.handlers import RingChannel

import zenostat
from zenostat.topics import codec, keys
from zenostat.topics.keys import Topic
from zenostat.topics.messages import ErrorReply, Event, EventKind, Write

POINT = "core_zn_cooling_setpoint"
OWN = codec.encoding(Write)

BAD_WRITES = {
    "not a number": ({"value": math.nan}, OWN, "value"),
    "text": ({"value": "26"}, OWN, "value"),
    "priority 17": ({"value": 26.0, "priority": 17}, OWN, "priority"),
    "negative duration": ({"value": 26.0, "duration_s": -1.0}, OWN, "duration_s"),
    "extra field": ({"value": 26.0, "colour": "red"}, OWN, "colour: there is no such field"),
    "foreign version": ({"value": 26.0}, "application/msgpack;zenostat/9.Write", "expected encoding"),
    "plain text": ({"value": 26.0}, "text/plain", "expected encoding"),
}


def test_bus__node_answers_each_malformed_write_to_its_source(episode_bus: zenostat.Bus) -> None:
    bus = episode_bus
    with bus.session.declare_subscriber(keys.EVENT.at("office"), RingChannel(1000)) as events:
        bus.status("office")  # an answer shows that the node has heard of the subscription

        def next_rejection() -> Event:
            def rejection() -> Event | None:
                message = events.try_recv()
                event = codec.decode(Event, message.payload.to_bytes()) if message else None
                return event if event and event.kind is EventKind.REJECTED else None

            return until(rejection, "the write is rejected")

        for name, (fields, encoding, words) in BAD_WRITES.items():
            payload = msgpack.packb({**fields, "source": f"panel {name}"})
            bus.session.put(keys.ACTUATOR.at("office", name=POINT), payload, encoding=zenoh.Encoding(encoding))
            event = next_rejection()
            assert event.source == f"panel {name}"
            assert words in event.text
        for payload in (b"\xc1", msgpack.packb([1]), msgpack.packb({"value": "x", "source": 5})):
            bus.session.put(keys.ACTUATOR.at("office", name=POINT), payload)
            assert next_rejection().source == "anonymous"
        bus.session.put(keys.ACTUATOR.at("office", name=POINT), msgpack.packb({"value": "x", "source": "p" * 999}))
        assert next_rejection().source == "p" * 128


BIG = msgpack.packb({"memory": b"\0" * (codec.MAX_BYTES + 1)})


@pytest.mark.parametrize("topic", [keys.STATUS, keys.SCENARIO, keys.MANIFEST, keys.SAMPLE], ids=lambda t: t.key)
def test_bus__queries_are_checked_like_any_other_request(episode_bus: zenostat.Bus, topic: Topic) -> None:
    bus = episode_bus

    def ask(payload: bytes | None, encoding: str = "zenoh/bytes") -> tuple[str, dict[str, object]]:
        zenoh_encoding = zenoh.Encoding(encoding) if payload is not None else None
        (reply,) = bus.session.get(topic.at("office"), payload=payload, encoding=zenoh_encoding, timeout=60)
        return str(reply.ok.encoding), msgpack.unpackb(reply.ok.payload.to_bytes())

    assert topic.reply is not None
    assert ask(None)[0] == codec.encoding(topic.reply)
    for payload in (b"rubbish", msgpack.packb({"colour": "red"}), msgpack.packb([]), BIG):
        encoding, denied = ask(payload)
        assert (encoding, denied["error"]) == (codec.encoding(ErrorReply), "BadMessage")
    if topic.message is not None and topic.delivery is keys.Delivery.QUERY:
        assert ask(msgpack.packb({"memory": True}))[0] == codec.encoding(topic.reply)
        assert ask(msgpack.packb({}), "text/plain")[1]["error"] == "BadMessage"
