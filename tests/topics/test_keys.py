"""The table of topics, walked row by row."""

import ast
import string
from pathlib import Path
from typing import get_args

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st
from zenoh import KeyExpr

from zenostat.bridge.transport.access_control import Permission, may
from zenostat.topics import codec, keys, messages
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.keys import TOPICS, Delivery, Role, Topic
from zenostat.topics.messages import Ack, ErrorReply, Message

ROOT = Path(__file__).parents[2]
PACKAGES = (
    "agent_sdk", "bench", "bridge", "cli", "eplus_node", "examples", "gateways", "lab", "metrics", "models", "plants",
    "views",
)  # fmt: skip

rows = pytest.mark.parametrize("topic", TOPICS, ids=lambda t: t.key)


def nested_in(message: type[Message]) -> set[type[Message]]:
    """Message classes that are fields of `message`, at any depth."""
    kinds: set[type[Message]] = set()
    waiting = [field.annotation for field in message.model_fields.values()]
    while waiting:
        kind = waiting.pop()
        waiting.extend(get_args(kind))
        if isinstance(kind, type) and issubclass(kind, Message) and kind not in kinds:
            kinds |= {kind} | nested_in(kind)
    return kinds


def all_messages() -> set[type[Message]]:
    return {
        kind
        for kind in (*vars(messages).values(), FaultPlan)
        if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message
    }


@rows
def test_keys__key_lies_below_the_root_of_its_node(topic: Topic) -> None:
    key = KeyExpr(topic.at("office", name="one", sender="ppo-7"))
    assert str(key).startswith("zenostat/v3/office/")
    assert keys.node_of(str(key)) == "office"
    assert "{" not in str(key)


@rows
def test_keys__sender_and_name_are_read_from_a_key(topic: Topic) -> None:
    expected = "ppo-7" if "{sender}" in topic.key else "", "one" if "{name}" in topic.key else ""
    assert topic.names_in(topic.at("office", name="one", sender="ppo-7")) == expected
    assert topic.names_in(topic.at("*", name="one", sender="ppo-7")) == expected  # a put may be for all nodes


@pytest.mark.parametrize("length", [1, 127, 128, 129, 60_000])
def test_keys__name_that_is_too_long_is_shortened_to_one_that_is_not_valid(length: int) -> None:
    name, short = "p" * length, keys.shortened("p" * length)
    assert (len(short), keys.is_name(short)) == (min(length, 128), length <= 128)
    assert (short == name) is (length <= 128)
    assert keys.shortened(short) == short


@rows
def test_keys__what_changes_something_names_its_sender(topic: Topic) -> None:
    reads = topic.sender in (Role.NODE, Role.ANYONE)
    assert topic.has_sender is not reads


@pytest.mark.parametrize(
    ("identity", "name", "sender"),
    [
        ("", "", "anonymous"),
        ("", "panel", "panel"),
        ("ppo-7", "", "ppo-7"),
        ("ppo-7", "ppo-7", "ppo-7"),
        ("ppo-7", "ppo-7.a", "ppo-7.a"),
        ("ppo-7", "ppo-70", "ppo-7.ppo-70"),
        ("ppo-7", "panel", "ppo-7.panel"),
    ],
)
def test_own_name__is_at_or_below_the_name_in_the_certificate(identity: str, name: str, sender: str) -> None:
    assert keys.own_name(identity, name) == sender
    assert keys.is_own(identity, sender) or not identity


@rows
def test_keys__key_is_found_by_its_own_wildcards_and_not_by_another_node(topic: Topic) -> None:
    key = KeyExpr(topic.at("office", name="one", sender="ppo-7"))
    assert KeyExpr(topic.everywhere()).includes(key)
    assert KeyExpr(topic.everywhere("office")).includes(key)
    assert not KeyExpr(topic.everywhere("school")).intersects(key)


@rows
def test_keys__wildcards_match_all_but_presence(topic: Topic) -> None:
    key = KeyExpr(topic.at("office", name="one", sender="ppo-7"))
    hidden = topic.delivery is Delivery.TOKEN
    assert hidden == ("@" in topic.key)
    for pattern in ("zenostat/v3/office/**", "zenostat/v3/*/**", "zenostat/**", "**"):
        assert KeyExpr(pattern).intersects(key) is not hidden, pattern


def test_keys__no_two_rows_can_be_taken_for_each_other() -> None:
    expressions = [KeyExpr(topic.everywhere()) for topic in TOPICS]
    for index, one in enumerate(expressions):
        assert not [str(other) for other in expressions[index + 1 :] if one.intersects(other)]


def test_keys__own_stream_is_the_manifest_the_samples_and_the_events() -> None:
    stream = KeyExpr(f"{keys.root('office')}/{keys.OWN_STREAM}")
    within = {t.key for t in TOPICS if stream.intersects(KeyExpr(t.at("office", name="one", sender="ppo-7")))}
    assert within == {"manifest", "sample", "event"}
    wake = KeyExpr(keys.wake("office", 7))
    assert stream.includes(wake)
    assert not [t.key for t in TOPICS if wake.intersects(KeyExpr(t.everywhere("office")))]


@rows
def test_keys__what_travels_has_a_class_and_presence_has_none(topic: Topic) -> None:
    assert (topic.message is None) == (topic.delivery is Delivery.TOKEN)


@rows
def test_query__has_a_reply_and_is_never_the_nodes(topic: Topic) -> None:
    if topic.delivery is Delivery.QUERY:
        assert topic.reply is not None
        assert topic.sender is not Role.NODE


@rows
def test_keys__what_the_node_streams_never_makes_it_wait(topic: Topic) -> None:
    # The manifest is no stream: it is sent once, and losing it would leave a reader without names.
    if topic.sender is Role.NODE and topic is not keys.MANIFEST and topic.message is not None:
        assert topic.delivery is Delivery.DROP


@rows
def test_keys__commands_and_writes_are_not_lost(topic: Topic) -> None:
    if topic.key.startswith(("command/", "actuator/")):
        assert topic.delivery is Delivery.BLOCK


@pytest.mark.parametrize(
    ("put", "request_row"),
    [(keys.COMMAND, keys.COMMAND_REQUEST), (keys.ACTUATOR, keys.WRITE_REQUEST)],
    ids=lambda t: t.key,
)
def test_put__has_an_acknowledged_query_beside_it(put: Topic, request_row: Topic) -> None:
    assert (request_row.message, request_row.delivery, request_row.reply) == (put.message, Delivery.QUERY, Ack)
    for role in (Role.CONTROLLER, Role.OPERATOR, Role.GATEWAY, Role.MONITOR):
        permitted = role in (put.sender, Role.GATEWAY)
        assert may(role, request_row) == ((Permission.ASK,) if permitted else ())
        assert may(role, put) == ((Permission.SEND,) if permitted else ())


@pytest.mark.parametrize("message", sorted(all_messages(), key=lambda m: m.__name__), ids=lambda m: m.__name__)
def test_keys__encoding_names_the_class_and_the_version_and_survives_zenoh(message: type[Message]) -> None:
    encoding = codec.encoding(message)
    assert encoding == f"application/msgpack;zenostat/3.{message.__name__}"
    assert str(zenoh.Encoding(encoding)) == encoding


def test_keys__every_message_that_travels_is_in_the_table() -> None:
    nested = set().union(*(nested_in(message) for message in all_messages()))
    in_table = {kind for t in TOPICS for kind in (t.message, t.reply) if kind is not None}
    assert all_messages() - nested - {ErrorReply} == in_table - nested  # any request may be answered by ErrorReply
    assert in_table <= all_messages()


def test_keys__table_has_every_row_that_the_module_defines() -> None:
    assert {value for value in vars(keys).values() if isinstance(value, Topic)} == set(TOPICS)
    assert len(TOPICS) == len(set(TOPICS))


def test_keys__no_key_is_spelled_outside_of_the_table() -> None:
    beginnings = (keys.PREFIX, *(t.key.split("{")[0] for t in TOPICS if "/" in t.key))
    spelled = [
        f"{file.relative_to(ROOT)}:{node.lineno} {node.value!r}"
        for package in PACKAGES
        for file in sorted((ROOT / package).rglob("*.py"))
        if file.name != "zeromq_controller.py"  # it has nothing of ours, on purpose
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and "\n" not in node.value
        if node.value.startswith(beginnings)
    ]
    assert spelled == []


@given(st.text() | st.text(string.printable))
def test_keys__any_text_can_be_made_a_name(text: str) -> None:
    name = keys.safe_name(text)
    assert keys.check_name(name, "the name") == name
    assert keys.safe_name(name) == name
    assert name == name.lower()
    KeyExpr(keys.SENSOR.at("office", name=name))


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Core_ZN", "core_zn"),
        ("Perimeter ZN 1", "perimeter_zn_1"),
        ("Électricité", "lectricit"),
        ("a/b*c$d#e?f@g", "a_b_c_d_e_f_g"),
        ("a-b.c+d", "a-b.c_d"),
        ("..", "x"),
        ("", "x"),
        ("a" * 200, "a" * 128),
    ],
)
def test_keys__names_are_made_safe(text: str, name: str) -> None:
    assert keys.safe_name(text) == name


@pytest.mark.parametrize("name", ["", "a/b", "*", "a b", "-a", ".a", "..", "@live", "a$", "ä", "a\n", "a" * 129])
def test_keys__unfit_name_is_refused_with_a_fit_one(name: str) -> None:
    with pytest.raises(InvalidConfig) as raised:
        keys.check_name(name, "the node name")
    assert "the node name" in str(raised.value)
    assert repr(keys.shortened(name)) in str(raised.value)
    assert "of which the first is no '.' or '-'" in str(raised.value)
    assert repr(keys.safe_name(name)) in str(raised.value)


@pytest.mark.parametrize("name", ["a", "_a", "Core_ZN.1-b", "0", "a" * 128])
def test_keys__fit_name_stays_as_it_is(name: str) -> None:
    assert keys.check_name(name, "the node name") == name
