"""Strangers' bytes for every message there is: a valid message, or `BadMessage`, in little memory."""

import struct
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.topics import codec, fault_plan
from zenostat.topics.errors import BadMessage
from zenostat.topics.messages import (
    Ack,
    Claim,
    Command,
    EngineStart,
    EpisodeStart,
    Manifest,
    Message,
    PriorityArrays,
    Reset,
    Sample,
    Write,
)


def _tree(kind: type[Message]) -> Iterator[type[Message]]:
    for child in kind.__subclasses__():
        yield child
        yield from _tree(child)


KINDS = sorted(
    {kind for kind in _tree(Message) if kind.__module__.startswith("zenostat.topics.")}, key=lambda k: k.__name__
)
REQUESTS = (Claim, Command, Reset, Write, fault_plan.FaultPlan)
"""Messages that anybody may send to a node, one class of each form."""

SEEDS: dict[type[Message], dict[str, Any]] = {
    Claim: {"controller": "c-1", "priority": 9, "actuators": ["heat", "cool"], "required": True},
    Command: {"episode": [1], "step": [3], "operations": b"\x01\x00", "values": struct.pack("<2d", 20.0, -0.0)},
    Reset: {"controller": "c", "seed": [1, None], "slots": [0, 1], "snapshot": "s1"},
    Write: {"value": -0.0, "priority": 8, "duration_s": 60.0, "source": "panel-3.Kate"},
    fault_plan.FaultPlan: {
        "seed": 1,
        "faults": [
            {"kind": "bias", "points": ["t*"], "offset": 1.5, "when": {"hours": [8.0, 17.0]}},
            {"kind": "loss", "commands": "*", "probability": 0.5},
        ],
    },
}

MEGABYTE = 1_000_000
PLENTY = 1_000_000


class LongText(str):
    """A text of 70 kB that Hypothesis shows in a few characters: it warns of each example above 30,000."""

    __slots__ = ()

    def __repr__(self) -> str:
        return "LongText()"


odd = st.sampled_from(
    [
        msgpack.ExtType(5, b"abc"), msgpack.Timestamp(2**33, 5), 2**64 - 1, -(2**63), -0.0, float("nan"), b"bytes",
        b"\xff\xfe", "/", "*", "#", "ü/**", "\x00", LongText("x" * 70_000), [], {}, [[]], {"a": {}}, True, None, 0, 0.5,
    ]
)  # fmt: skip


def check(kind: type[Message], payload: bytes) -> bool:
    """Whether it is a message; then it is the same one again after another way."""
    try:
        message = codec.decode(kind, payload)
    except BadMessage as error:
        error_text = str(error)
    else:
        error_text = ""
    if error_text:
        assert len(error_text) < 20_000
        return False
    assert codec.decode(kind, codec.encode(message), codec.encoding(kind)) == message
    return True


def refused(kind: type[Message], payload: bytes) -> str:
    with pytest.raises(BadMessage) as raised:
        codec.decode(kind, payload)
    return str(raised.value)


@given(st.sampled_from(KINDS), st.binary(max_size=300))
def test_codec__arbitrary_bytes(kind: type[Message], payload: bytes) -> None:
    check(kind, payload)


@pytest.mark.parametrize("kind", SEEDS)
def test_codec__what_is_mutated_was_a_message(kind: type[Message]) -> None:
    assert check(kind, msgpack.packb(SEEDS[kind]))


@given(st.sampled_from([*SEEDS]), st.data())
def test_codec__mutated_bytes(kind: type[Message], data: st.DataObject) -> None:
    payload = bytearray(msgpack.packb(SEEDS[kind]))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(payload)))
        cut = data.draw(st.integers(0, 3))
        payload[at : at + cut] = data.draw(st.binary(max_size=4))
    check(kind, bytes(payload))


@given(st.sampled_from([*SEEDS]), odd, st.data())
def test_codec__odd_values_in_odd_places(kind: type[Message], value: Any, data: st.DataObject) -> None:
    fields = dict(SEEDS[kind])
    fields[data.draw(st.sampled_from([*fields, "", "colour", "a/b", "x" * 5000]))] = value
    check(kind, msgpack.packb(fields))


@given(st.sampled_from(KINDS), st.dictionaries(odd.filter(lambda v: isinstance(v, (int, float, bytes, str))), odd))
def test_codec__odd_maps(kind: type[Message], fields: dict[Any, Any]) -> None:
    check(kind, msgpack.packb(fields))


@pytest.mark.parametrize("kind", REQUESTS)
@pytest.mark.parametrize(
    "bomb",
    [
        b"\x91" * PLENTY + b"\xc0",
        b"\x81\xa1a" * PLENTY,
        b"\xdd\xff\xff\xff\xff",
        b"\xdf\xff\xff\xff\xff",
        b"\xc6\xff\xff\xff\xff",
        b"\xdb\xff\xff\xff\xff",
        b"\xc9\xff\xff\xff\xff\x01",
        b"\xdd\x00\x7f\xff\xff" * 1000,
    ],
    ids=["lists", "maps", "4 GB list", "4 GB map", "4 GB bytes", "4 GB text", "4 GB extension", "lists of millions"],
)
@pytest.mark.parametrize("within", [False, True])
def test_codec__bomb_costs_no_memory(kind: type[Message], bomb: bytes, within: bool) -> None:
    payload = b"\x81" + msgpack.packb(next(iter(SEEDS[kind]))) + bomb if within else bomb
    tracemalloc.start()
    try:
        refused(kind, payload)
        assert tracemalloc.get_traced_memory()[1] < 2 * len(payload) + MEGABYTE
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", REQUESTS)
@pytest.mark.parametrize("entry", [b"\xc0", b"\x80", b"\xa1x", b"\x91\x90"])
def test_codec__list_of_a_million_is_refused_before_it_is_looked_at(kind: type[Message], entry: bytes) -> None:
    payload = b"\x81\xa7episode\xdd" + PLENTY.to_bytes(4, "big") + entry * PLENTY
    tracemalloc.start()
    try:
        refused(kind, payload)
        assert tracemalloc.get_traced_memory()[1] < 10 * MEGABYTE
    finally:
        tracemalloc.stop()


@given(st.integers(1, 60), st.integers(1, 200))
def test_codec__entries_are_counted_in_all_lists_together(outer: int, inner: int) -> None:
    error_text = refused(Command, msgpack.packb({"episode": [[0] * inner] * outer, "step": [], "values": bytes(9000)}))
    # The map, the outer list, the inner ones.
    assert ("entries" in error_text) == (3 + outer + outer * inner > codec.MAX_ENTRIES)


def test_codec__as_many_entries_as_are_allowed_are_a_message() -> None:
    most = codec.MAX_ITEMS[Claim]
    claim = Claim(controller="c", actuators=[f"a{i}" for i in range(most - 4)])
    assert codec.decode(Claim, codec.encode(claim)) == claim
    longer = claim.model_copy(update={"actuators": [*claim.actuators, "b"]})
    assert f"more than {most} entries" in refused(Claim, codec.encode(longer))


def test_codec__answers_of_the_largest_nodes_are_messages() -> None:
    """256 slots with noise on eight columns of the weather, and 4,096 sources."""
    noise = {f"column_{column}.{name}": 1.0 for column in range(8) for name in ("sigma", "mu", "tau_h")}
    start = EpisodeStart(engine_start=EngineStart.FORKED, weather="USA_CO_Denver", noise_parameters=noise)
    ack = Ack(episode=[7] * 256, episode_starts=[start] * 256)
    assert codec.decode(Ack, codec.encode(ack)) == ack
    raw = bytes(8)
    arrays = PriorityArrays(
        episode=[0], step=[0], values=raw, source_index=raw, sources=[f"device-{i}" for i in range(4096)]
    )
    assert codec.decode(PriorityArrays, codec.encode(arrays)) == arrays


def test_codec__of_thousands_of_faults_the_first_are_named() -> None:
    error_text = refused(Command, msgpack.packb({"episode": [-1] * 3000, "step": [0], "values": b""}))
    assert "episode.0: " in error_text
    assert "and 2990 more" in error_text
    assert len(error_text) < 2000


def test_codec__field_name_is_quoted_in_part() -> None:
    assert len(refused(Write, msgpack.packb({"value": 1.0, "x" * 100_000: 1}))) < 400


@pytest.mark.parametrize(
    "payload",
    [
        msgpack.packb({"value": msgpack.Timestamp(2**33, 5)}),
        msgpack.packb({"value": msgpack.ExtType(5, b"abc")}),
        b"\x81\xa5value\xd4\xff\x00",
        b"\x81\xa5value\xd7\xff" + b"\xff" * 8,
        b"\x81\xa5value\xcf" + b"\xff" * 8 + b"\x00",
        b"\x82\xa5value\xc0\xa6source\xa4\xff\xfe\xfd\xfc",
        b"\x82\xa5value\xc0\xa6source\xa3\xed\xa0\x80",
        b"\x81\xc4\x05value\xc0",
        b"\x81\x91\x01\x01",
        b"\x81\x80\x01",
        b"\x81\xa5value\xc1",
    ],
    ids=[
        "timestamp", "extension", "short timestamp", "nanoseconds", "tail", "no utf-8", "surrogate", "bytes for a name",
        "list for a name", "map for a name", "reserved",
    ],
)  # fmt: skip
def test_codec__what_msgpack_has_and_messages_have_not(payload: bytes) -> None:
    refused(Write, payload)


def test_codec__whole_number_beyond_64_bits_of_float_is_a_finite_number() -> None:
    assert codec.decode(Write, b"\x81\xa5value\xcf" + b"\xff" * 8) == Write(value=float(2**64))


def test_codec__minus_zero_stays_minus_zero() -> None:
    value = codec.decode(Write, msgpack.packb({"value": -0.0})).value
    assert struct.pack("<d", value) == struct.pack("<d", -0.0)


def test_codec__of_a_field_that_is_repeated_the_last_one_counts() -> None:
    twice = b"\x82\xa5value" + msgpack.packb(1.0) + b"\xa5value" + msgpack.packb(2.0)
    assert codec.decode(Write, twice) == Write(value=2.0)


def test_codec__all_messages_are_fuzzed() -> None:
    assert {Manifest, Sample, fault_plan.FaultPlan, fault_plan.Bias} <= set(KINDS)
    assert len(KINDS) > 50


def test_codec__limits_in_the_documentation_are_those_of_the_code() -> None:
    from zenostat.bridge.exchange import step_exchange
    from zenostat.bridge.node import publications, subscriptions, waiting
    from zenostat.bridge.transport import session

    page = (Path(__file__).parents[2] / "docs" / "security.md").read_text()
    section = page.split("## Limits on incoming messages", 1)[1].split("\n## ", 1)[0]
    numbers = (
        codec.MAX_BYTES // 2**20, session.MAX_MESSAGE_BYTES // 2**20, codec.MAX_ENTRIES, codec.MAX_ITEMS[Claim],
        step_exchange.MAX_MESSAGES_PER_STEP, step_exchange.MAX_SOURCE_NAME,
        subscriptions.COMMAND_QUEUE, waiting.MAX_PENDING, waiting.MAX_LARGE,
        publications.EVENTS_A_STEP, publications.WRITTEN_A_STEP,
    )  # fmt: skip
    rows = [line.split("|")[2].strip() for line in section.splitlines() if line.startswith("| ")][1:]
    assert [row.split(" ")[0] for row in rows] == [f"{number:,}" for number in numbers]
