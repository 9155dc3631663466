"""Bytes to messages and back: what was sent arrives, and everything else is `BadMessage` and nothing else."""

import contextlib
import math
import struct
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pydantic import ValidationError
from support.builders import actuator, manifest, meter, sensor

from zenostat.bridge.node.settings import NodeSettings
from zenostat.topics import codec
from zenostat.topics.errors import BadMessage, InvalidAction
from zenostat.topics.messages import (
    Ack,
    Claim,
    Command,
    ControllerState,
    ControllerStatus,
    CreateBranch,
    EngineStart,
    EpisodeStart,
    ErrorReply,
    Event,
    EventKind,
    Manifest,
    Message,
    Mode,
    PointValue,
    Query,
    Reset,
    Sample,
    SnapshotTaken,
    State,
    Status,
    Stop,
    Write,
)

TRAVELLING = (
    Ack, Query, Claim, Command, ErrorReply, Event, CreateBranch, Manifest, PointValue, Reset, Sample, SnapshotTaken,
    Status, Stop, Write,
)  # fmt: skip
NUMBERS = {
    "value of a Write": (Write, {"value": 1.0}, "value"),
    "for_s of a Write": (Write, {"value": 1.0, "duration_s": 1.0}, "duration_s"),
    "value of a PointValue": (PointValue, {"value": 1.0, "unit": "W", "episode": 0, "step": 0, "time": ""}, "value"),
}

counts = st.integers(0, 2**63)
lists = st.lists(counts, max_size=3)
finite = st.floats(allow_nan=False, allow_infinity=False)
names = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,20}", fullmatch=True)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
priorities = st.integers(1, 16)
senders = st.just("") | names

whatever = st.one_of(
    st.builds(
        Ack,
        episode=lists,
        episode_starts=st.lists(
            st.builds(
                EpisodeStart,
                engine_start=st.sampled_from(EngineStart),
                weather=texts,
                noise_parameters=st.dictionaries(texts, finite),
                output_dir=texts,
            )
        ),
    ),
    st.builds(CreateBranch, controller=senders, snapshot=texts, relinquished=st.booleans(), slot=counts),
    st.builds(SnapshotTaken, snapshot=texts, episode=lists, step=lists),
    st.builds(Query),
    st.builds(
        Claim, controller=names, priority=priorities, actuators=st.none() | st.lists(texts), required=st.booleans()
    ),
    st.builds(Command, episode=lists, step=lists, operations=st.none() | st.binary(), values=st.binary()),
    st.builds(ErrorReply, error=texts, message=texts),
    st.builds(Event, kind=st.sampled_from(EventKind), text=texts, source=texts, error=texts, episode=counts),
    st.builds(PointValue, value=finite, unit=texts, episode=counts, step=counts, time=texts),
    st.builds(Reset, controller=senders, seed=st.none() | counts | st.lists(st.none() | counts), snapshot=texts),
    st.builds(
        Sample, episode=lists, step=lists, time=st.lists(texts, max_size=2), elapsed_s=st.lists(finite, max_size=2),
        flags=st.just([0]), values=st.binary(), effective=st.binary(), source_index=st.binary(),
        sources=st.lists(texts, max_size=3), late=counts, rejected=counts,
    ),
    st.builds(
        Status, node=names, state=st.sampled_from(State), building=texts, weather=texts, mode=st.sampled_from(Mode),
        episode=lists, step=lists, steps=counts, time=st.lists(texts, max_size=2),
        controllers=st.lists(
            st.builds(
                ControllerStatus, controller=texts, priority=priorities, actuators=counts, required=st.booleans(),
                state=st.sampled_from(ControllerState), accepted=counts,
            ),
            max_size=2,
        ),
        accepted=counts, rejected=counts, late=counts, duplicate=counts, failure=texts,
    ),
    st.builds(Stop, source=senders),
    st.builds(
        Write, value=st.none() | finite, priority=priorities,
        duration_s=st.none() | st.floats(0, exclude_min=True, allow_infinity=False), source=senders,
    ),
)  # fmt: skip

anything = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=5) | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=10,
)


def refused(message: type[Message], payload: bytes, encoding: str = "") -> str:
    with pytest.raises(BadMessage) as raised:
        codec.decode(message, payload, encoding)
    return str(raised.value)


@given(whatever)
def test_codec__what_is_sent_arrives(message: Message) -> None:
    kind = type(message)
    assert codec.decode(kind, codec.encode(message), codec.encoding(kind)) == message


def test_codec__manifest_arrives_with_its_points() -> None:
    sent = manifest(sensors=[sensor("t")], meters=[meter("e")], actuators=[actuator("heat", 15.0, 22.5)], slots=2)
    arrived = codec.decode(Manifest, codec.encode(sent), codec.encoding(Manifest))
    assert arrived == sent
    assert arrived.actuators[0].low == 15.0


@given(st.lists(st.floats(), max_size=6))
def test_codec__arrays_arrive_to_the_last_bit(values: list[float]) -> None:
    raw = struct.pack(f"<{len(values)}d", *values)
    sent = Command(episode=[0], step=[0], values=raw)
    array = codec.floats(codec.decode(Command, codec.encode(sent)).values, (1, len(values)), "values")
    assert array.shape == (1, len(values))
    assert array.astype("<f8").tobytes() == raw


@given(whatever)
def test_codec__hot_path_packs_what_encode_packs(message: Message) -> None:
    assume(not isinstance(message, Ack | Status))  # the hot path has no messages within messages
    assert codec.pack(**message.__dict__) == codec.encode(message)


@given(lists, lists, st.binary(max_size=300))
def test_codec__command_is_its_head_and_its_values(episode: list[int], step: list[int], values: bytes) -> None:
    whole = codec.encode(Command(episode=episode, step=step, values=values))
    assert codec.CommandHead(episode, len(values)).at(step) + values == whole


def test_codec__values_stand_in_the_payload_as_little_endian_float64() -> None:
    assert codec.encode(Command(episode=[0], step=[0], values=struct.pack("<d", 26.0))).endswith(
        b"\x00\x00\x00\x00\x00\x00\x3a\x40"  # 26 = 1.625 * 2**4: sign 0, exponent 1027 = 0x403, fraction 0xA…
    )


# What does not come in


@given(st.sampled_from(TRAVELLING), st.binary(max_size=200))
def test_codec__garbage_is_a_bad_message_and_nothing_else(kind: type[Message], payload: bytes) -> None:
    with contextlib.suppress(BadMessage):
        assert isinstance(codec.decode(kind, payload), kind)


@given(st.sampled_from(TRAVELLING), anything)
def test_codec__any_other_value_is_a_bad_message_and_nothing_else(kind: type[Message], value: Any) -> None:
    with contextlib.suppress(BadMessage):
        assert isinstance(codec.decode(kind, msgpack.packb(value)), kind)


@given(whatever, anything, st.data())
def test_codec__field_with_any_other_value_is_a_bad_message_and_nothing_else(
    message: Message, value: Any, data: st.DataObject
) -> None:
    fields = dict(message.__dict__)
    if fields:
        fields[data.draw(st.sampled_from(sorted(fields)))] = value
    with contextlib.suppress(BadMessage):
        assert isinstance(codec.decode(type(message), msgpack.packb(fields, default=vars)), type(message))


@given(whatever, st.data())
def test_codec__truncated_message_is_refused(message: Message, data: st.DataObject) -> None:
    payload = codec.encode(message)
    refused(type(message), payload[: data.draw(st.integers(0, len(payload) - 1))])


@given(whatever, st.binary(min_size=1, max_size=4))
def test_codec__message_with_a_tail_is_refused(message: Message, tail: bytes) -> None:
    refused(type(message), codec.encode(message) + tail)


@pytest.mark.parametrize("depth", [100, 500, 600, 5000, 500_000])
@pytest.mark.parametrize("opening", [b"\x91", b"\x81\xa1a"], ids=["lists", "maps"])
def test_codec__nested_bomb_is_refused(opening: bytes, depth: int) -> None:
    bomb = opening * depth + b"\xc0"
    refused(Write, bomb)
    refused(Write, b"\x81\xa5value" + bomb)
    refused(Sample, b"\x81\xa7episode" + bomb)


@pytest.mark.parametrize("head", [b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff"])
def test_codec__length_that_lies_is_refused(head: bytes) -> None:
    refused(Write, head)
    refused(Write, b"\x81\xa5value" + head)


def test_codec__oversized_payload_is_refused_unread() -> None:
    blank = bytes(codec.MAX_BYTES)
    message = refused(Command, codec.encode(Command(episode=[0], step=[0], values=blank)))
    assert str(codec.MAX_BYTES) in message
    assert "Command" in message


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("where", NUMBERS)
def test_codec__number_that_is_not_finite_is_refused_by_its_path(where: str, bad: float) -> None:
    kind, fields, name = NUMBERS[where]
    codec.decode(kind, msgpack.packb(fields))
    message = refused(kind, msgpack.packb(fields | {name: bad}))
    assert f"{kind.__name__}: {name}: " in message
    assert str(bad) in message


@pytest.mark.parametrize("bad", [-1, 1.5, True, "1", [0, -1], [[0]], {}])
def test_codec__wrong_seed_is_one_error_without_names_of_types(bad: object) -> None:
    message = refused(Reset, msgpack.packb({"seed": bad}))
    expected = "an integer from 0 to 2**64 - 1 expected, or a list with one or None for each slot"
    assert message == f"Reset: seed: {expected}, got {bad!r}"


def test_codec__bytes_are_named_so() -> None:
    fields = {"episode": [0], "step": [0], "values": "text"}
    assert refused(Command, msgpack.packb(fields)) == "Command: values: bytes expected, got 'text'"


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_codec__number_that_is_not_finite_is_refused_in_free_options_too(bad: float) -> None:
    refused(Reset, msgpack.packb({"seed": bad}))
    refused(EpisodeStart, msgpack.packb({"engine_start": "reused", "weather": "", "noise_parameters": {"sigma": bad}}))


def test_codec__wrong_type_deep_within_is_refused_by_its_path() -> None:
    fields = msgpack.unpackb(codec.encode(manifest(actuators=[actuator("heat"), actuator("cool")])))
    fields["actuators"][1]["low"] = [1.0]
    assert "actuators.1.low" in refused(Manifest, msgpack.packb(fields))


def test_codec__all_faults_are_named_at_once() -> None:
    message = refused(Write, msgpack.packb({"value": "warm", "priority": 17, "duration_s": 0, "colour": "red"}))
    assert all(f"{name}: " in message for name in ("value", "priority", "duration_s", "colour"))
    assert "'warm'" in message
    assert "17" in message


def test_codec__rule_on_several_fields_is_named_without_a_path_or_their_values() -> None:
    with pytest.raises(ValidationError) as caught:
        NodeSettings(listen=[], connect=[])
    assert codec.describe_validation_errors(caught.value) == "name an endpoint to listen on, or one to connect to"


def test_codec__fault_quotes_no_more_than_a_line() -> None:
    assert len(refused(Write, msgpack.packb({"value": "x" * 100_000}))) < 300


@pytest.mark.parametrize("value", [None, 3, "text", [], [1.0]], ids=["nothing", "number", "text", "empty list", "list"])
def test_codec__message_is_a_map_of_its_fields(value: object) -> None:
    assert "map of its fields" in refused(Write, msgpack.packb(value))


@pytest.mark.parametrize("key", [1, b"value", None], ids=["number", "bytes", "nothing"])
def test_codec__field_names_are_text(key: object) -> None:
    refused(Write, msgpack.packb({key: 1.0}))


def test_codec__another_version_is_refused_by_name() -> None:
    payload = codec.encode(Write(value=1.0))
    message = refused(Write, payload, "application/msgpack;zenostat/1.Write")
    assert "zenostat/3.Write" in message
    assert "zenostat/1.Write" in message


def test_codec__another_class_is_refused_by_name() -> None:
    message = refused(Write, codec.encode(Write(value=1.0)), codec.encoding(Command))
    assert "zenostat/3.Write" in message
    assert "zenostat/3.Command" in message


@pytest.mark.parametrize(
    "encoding", ["text/plain", "application/json", "zenoh/string", "application/msgpack;other/1.Write"]
)
def test_codec__encoding_that_is_no_msgpack_is_refused_by_name(encoding: str) -> None:
    assert f"got {encoding!r}" in refused(Write, codec.encode(Write(value=1.0)), encoding)


@pytest.mark.parametrize("encoding", ["", "zenoh/bytes", "application/msgpack"])
def test_codec__stranger_that_names_no_version_is_checked_like_any_other(encoding: str) -> None:
    assert codec.decode(Write, msgpack.packb({"value": 21}), encoding) == Write(value=21.0)
    refused(Write, msgpack.packb({"value": 21, "priority": 0}), encoding)


# Arrays


@given(st.integers(0, 64), st.integers(0, 4), st.integers(0, 4))
def test_codec__array_has_the_size_of_its_shape_or_is_refused(size: int, slots: int, points: int) -> None:
    raw = bytes(size)
    if size == 8 * slots * points:
        assert codec.floats(raw, (slots, points), "values").shape == (slots, points)
    else:
        with pytest.raises(BadMessage, match=f"values has {size} bytes; {8 * slots * points} expected"):
            codec.floats(raw, (slots, points), "values")
    if size == slots * points:
        assert codec.uint8s(raw, (slots, points), "operations").shape == (slots, points)
    else:
        with pytest.raises(BadMessage, match=f"operations has {size} bytes; {slots * points} expected"):
            codec.uint8s(raw, (slots, points), "operations")


def test_codec__arrays_stand_in_c_order_slots_first() -> None:
    raw = struct.pack("<6d", 0, 1, 2, 10, 11, 12)
    assert codec.floats(raw, (2, 3), "values").tolist() == [[0, 1, 2], [10, 11, 12]]
    assert codec.uint8s(bytes([1, 2, 3, 4]), (2, 2), "operations").tolist() == [[1, 2], [3, 4]]


def test_codec__message_cannot_be_changed_through_its_arrays() -> None:
    array = codec.floats(bytes(8), (1, 1), "values")
    assert not array.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        array[0, 0] = np.pi


@pytest.mark.parametrize(("what", "opening"), [("", "memory: "), ("the request", "the request: memory: ")])
def test_validated__error_of_the_class_names_what_is_invalid(what: str, opening: str) -> None:
    assert codec.validated(Query, {"memory": True}) == Query(memory=True)
    with pytest.raises(InvalidAction) as caught:
        codec.validated(Query, {"memory": "noon"}, what, InvalidAction)
    assert str(caught.value).startswith(opening)
    assert str(caught.value).endswith("got 'noon'")
