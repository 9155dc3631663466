"""Refusals reach the one who asked: by the source of a write, by the reply of a query."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import msgpack
import pytest
import zenoh
from support.nodes import until
from zenoh.handlers import FifoChannel, RingChannel

import zenostat
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, NodeNotFound, RequestRejected
from zenostat.topics.keys import Topic
from zenostat.topics.messages import (
    Acknowledge,
    Claim,
    ErrorReply,
    Event,
    EventKind,
    Message,
    Reset,
    SetPace,
    Stop,
    TakeSnapshot,
    Write,
)

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


def test_bus__wildcards_and_other_invalid_names_are_no_nodes(episode_bus: zenostat.Bus) -> None:
    requests: tuple[Callable[[str], object], ...] = (
        lambda name: episode_bus.pause(name, source="ada"),
        episode_bus.read,
        episode_bus.controller,
        lambda name: episode_bus.listen(name).__enter__(),
    )
    for name in ("*", "**", "offic*", "office/rpc", "off#ce", "$*", "a b", ""):
        for request in requests:
            with pytest.raises(InvalidConfig, match=re.escape(f"the node's name {name!r} is not valid")):
                request(name)
    assert not episode_bus.status("office").paused


def test_bus__requests_for_what_a_node_does_not_have_are_rejected(episode_bus: zenostat.Bus, tmp_path: Path) -> None:
    requests: dict[str, Callable[[], object]] = {
        "no slot 1 ": lambda: episode_bus.alarms("office", slot=1),
        "no slot 2 ": lambda: episode_bus.remove_from_service("office", "*", slot=2),
        "2 seeds for 1 slot;": lambda: episode_bus.reset("office", Reset(seed=[1, 2])),
        "no actuator 'cooling'": lambda: episode_bus.controller("office", actuators=["cooling"]),
        "no folder ": lambda: episode_bus.record("office", tmp_path / "runs" / "run.mcap"),
    }
    for text, request in requests.items():
        with pytest.raises(RequestRejected, match=text):
            request()


def test_bus__names_of_strangers_that_are_not_valid_are_not_listed(episode_bus: zenostat.Bus) -> None:
    with episode_bus.session.declare_queryable(keys.MANIFEST.at("a b"), lambda query: query.reply(query.key_expr, b"")):
        assert episode_bus.nodes() == ["office"]


def test_bus__node_that_has_a_manifest_but_no_reply_is_not_called_missing(episode_bus: zenostat.Bus) -> None:
    """A starting node declares its manifest before some requests."""
    key = keys.MANIFEST.at("starting")
    with (
        episode_bus.session.declare_queryable(key, lambda query: query.reply(key, b"")),
        pytest.raises(NodeNotFound, match=r"the node 'starting' on .* did not take the request"),
    ):
        episode_bus.status("starting")


def test_bus__listener_without_a_node_may_be_one_that_starts(scratch: Path) -> None:
    endpoint = f"unixsock-stream/{scratch}/bus"
    with (
        open_session(listen=[endpoint]),
        zenostat.connect(endpoint) as bus,
        pytest.raises(NodeNotFound, match=r"no node 'office' on .*; there are none \(one may be starting\)$"),
    ):
        bus.status("office")


@pytest.mark.slow
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
            sender = keys.safe_name(f"panel {name}")
            payload, key = msgpack.packb(fields), keys.ACTUATOR.at("office", name=POINT, sender=sender)
            bus.session.put(key, payload, encoding=zenoh.Encoding(encoding))
            event = next_rejection()
            assert event.source == sender
            assert words in event.text
        for payload in (b"\xc1", msgpack.packb([1]), msgpack.packb({"value": "x", "source": 5})):
            bus.session.put(keys.ACTUATOR.at("office", name=POINT, sender="panel"), payload)
            assert next_rejection().source == "panel"
        key = keys.ACTUATOR.at("office", name=POINT, sender="p" * 999)
        bus.session.put(key, msgpack.packb({"value": None}))
        event = next_rejection()
        assert event.source == "p" * 127 + "…"
        assert "is not a sender's name" in event.text
        bus.session.put(keys.ACTUATOR.at("office", name=POINT, sender="-x"), msgpack.packb({"value": None}))
        assert "'-x' is not a sender's name" in (text := next_rejection().text)
        assert "of which the first is no '.' or '-'" in text


SETS = Write(value=26.0, source="panel")


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        (keys.WRITE_REQUEST, SETS),
        (keys.CLAIM, Claim(controller="panel", required=False)),
        (keys.RESET, Reset(controller="panel")),
        (keys.STOP, Stop(source="panel")),
        (keys.PACE, SetPace(source="panel", mode="free")),
        (keys.SNAPSHOT, TakeSnapshot(controller="panel")),
        (keys.ACKNOWLEDGE, Acknowledge(source="panel", alarm="*")),
    ],
    ids=lambda part: getattr(part, "key", ""),
)
def test_bus__message_under_two_names_is_denied_counted_and_reported(
    episode_bus: zenostat.Bus, topic: Topic, message: Message
) -> None:
    bus = episode_bus
    before, manifest, priorities = bus.status("office"), bus.manifest("office"), bus.priorities("office")
    with bus.session.declare_subscriber(keys.EVENT.at("office"), RingChannel(1000)) as events:
        key = topic.at("office", name=POINT, sender="thief")
        replies = list(bus.session.get(key, payload=codec.encode(message), timeout=30))
        reply = codec.decode(ErrorReply, replies[0].ok.payload.to_bytes())
        assert reply.error == "AccessDenied"
        assert "its key names 'thief' as the sender, and the message 'panel'" in reply.message
        sent = until(events.try_recv, "it is reported")
        event = codec.decode(Event, sent.payload.to_bytes())
    assert (event.kind, event.source) == (EventKind.REJECTED, "thief")
    assert event.text == f"{topic.key}: {reply.message}"
    after = bus.status("office")
    assert (after.rejected, after.controllers) == (before.rejected + 1, before.controllers)
    assert (after.episode, after.step, after.mode) == (before.episode, before.step, before.mode)
    assert bus.manifest("office").mode == manifest.mode
    assert bus.priorities("office") == priorities


def test_bus__put_for_all_nodes_is_under_the_name_of_its_sender(episode_bus: zenostat.Bus) -> None:
    """The node's name in a key may be a wildcard, which is shorter: the sender's name must not be cut for that."""
    bus = episode_bus
    with bus.controller("office", name="victim", required=False) as link:
        link.current()
        spoofed = "x" * (len("office") - len("*")) + link.name
        before = bus.status("office")
        with bus.session.declare_subscriber(keys.EVENT.at("office"), RingChannel(1000)) as events:
            bus.session.put(keys.COMMAND.at("*", sender=spoofed), b"\x80")
            sent = until(events.try_recv, "it is reported")
        assert codec.decode(Event, sent.payload.to_bytes()).source == spoofed
        assert bus.status("office").controllers[0].rejected == before.controllers[0].rejected


@pytest.mark.parametrize(
    ("topic", "expected"),
    [
        (keys.PRIORITIES, ""),
        (keys.ALARMS, ""),
        (keys.RESET, ""),
        (keys.FAULTS, ""),
        (keys.STOP_RECORDING, "the node is not recording"),
        (keys.CLAIM, ""),
        (keys.COMMAND_REQUEST, "there is no payload; a Command expected"),
        (keys.WRITE_REQUEST, "there is no payload; a Write expected"),
    ],
    ids=lambda part: getattr(part, "key", ""),
)
def test_bus__request_without_a_payload_has_no_fields(episode_bus: zenostat.Bus, topic: Topic, expected: str) -> None:
    key = topic.at("office", name=POINT, sender="panel")
    (reply,) = episode_bus.session.get(key, timeout=60)
    if not expected:
        assert topic.reply is not None
        codec.decode(topic.reply, reply.ok.payload.to_bytes(), str(reply.ok.encoding))
    else:
        assert expected in codec.decode(ErrorReply, reply.ok.payload.to_bytes()).message


def test_bus__query_of_all_keys_is_no_message_of_a_sender(episode_bus: zenostat.Bus) -> None:
    """Programs that show what is on a bus read all keys of a node; nothing of that is an event or counts."""
    bus = episode_bus
    before = bus.status("office").rejected
    with bus.session.declare_subscriber(keys.EVENT.at("office"), FifoChannel(1000)) as events:
        replies = [*bus.session.get(f"{keys.root('office')}/**", target=zenoh.QueryTarget.ALL, timeout=60)]
        assert keys.MANIFEST.at("office") in {str(reply.ok.key_expr) for reply in replies if reply.ok}
        (refused,) = bus.session.get(keys.WRITE_REQUEST.at("office", sender="*", name=POINT), timeout=60)
        assert "wildcard" in codec.decode(ErrorReply, refused.ok.payload.to_bytes()).message
        assert bus.status("office").rejected == before
        bus.write("office", POINT, None, source="panel")
        sent = until(events.try_recv, "the event of the write")
        assert codec.decode(Event, sent.payload.to_bytes()).source == "panel"


@pytest.mark.parametrize("key", ["rpc/*/panel", "*/*/panel", "**/panel", "rpc/**/panel", "rpc/pau$*/panel"])
def test_bus__wildcard_in_place_of_a_request_carries_none_out(episode_bus: zenostat.Bus, key: str) -> None:
    bus = episode_bus
    before = bus.status("office")
    replies = [*bus.session.get(f"{keys.root('office')}/{key}", target=zenoh.QueryTarget.ALL, timeout=60)]
    texts = [codec.decode(ErrorReply, reply.ok.payload.to_bytes()).message for reply in replies if reply.ok]
    assert texts
    assert all("wildcard in place of a name or of the request" in text for text in texts), texts
    after = bus.status("office")
    assert (after.episode, after.paused, after.snapshots) == (before.episode, False, before.snapshots)


def test_bus__wildcard_in_place_of_the_node_is_permitted(episode_bus: zenostat.Bus) -> None:
    bus = episode_bus
    (reply,) = bus.session.get(keys.WRITE_REQUEST.at("*", sender="panel", name=POINT), timeout=60, payload=b"\x80")
    assert "wildcard" not in codec.decode(ErrorReply, reply.ok.payload.to_bytes()).message


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
