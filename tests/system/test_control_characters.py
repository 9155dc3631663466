"""Texts of a hostile program on the bus reach no terminal, log, report or monitor with their control characters."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zenoh
from support.nodes import node_on_bus, until
from support.recordings import rewrite
from support.run_cli import run_in_process as run

from zenostat.bridge.recording.reader import RecordedItem
from zenostat.metrics.recording import load
from zenostat.topics import codec, keys
from zenostat.topics.errors import UnknownName
from zenostat.topics.messages import ErrorReply, Event, Write
from zenostat.topics.printable import replace_controls
from zenostat.views.live.summary import NodeNumbers, NodeRow, markdown, overview

PLANT = "zenostat.agent_sdk.testing.fake_plant:FakePlant"
EVIL = "\x1b]0;owned\x07\x9b31m\u202e\r\nok"
HARMLESS = replace_controls(EVIL)


def is_plain(text: str) -> bool:
    """Whether a terminal shows all of a text and obeys none of it but line ends."""
    return replace_controls(text, keep="\n") == text


@contextmanager
def raw_session(endpoint: str) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    with zenoh.open(config) as session:
        yield session


@pytest.fixture(scope="module")
def recorded(module_scratch: Path) -> tuple[Path, list[bytes]]:
    """A recording of a node to which a hostile client wrote, and the events that the node sent."""
    path, events = module_scratch / "run.mcap", list[bytes]()
    with (
        node_on_bus(module_scratch / "room", plant=PLANT, name="room", record=str(path)) as (program, bus),
        raw_session(program.endpoint) as session,
    ):
        subscriber = session.declare_subscriber(keys.EVENT.at("room"), lambda m: events.append(m.payload.to_bytes()))
        actuator = bus.manifest("room").actuators[0]
        encoding = zenoh.Encoding(codec.encoding(Write))
        key = keys.ACTUATOR.at("room", name=actuator.name, sender="panel")
        with bus.controller("room", name="plain") as link:
            session.put(key, codec.pack(value=actuator.low, source=EVIL), encoding=encoding)
            session.put(key, codec.pack(value=[EVIL], source=EVIL), encoding=encoding)
            session.put(
                keys.ACTUATOR.at("room", name="x\x1b[2J", sender="panel\x1b[2J"),
                codec.pack(value=1.0, source=EVIL),
                encoding=encoding,
            )
            session.put(keys.COMMAND.at("room", sender="x\x1b[2J"), codec.pack(**{EVIL: 1}))
            until(lambda: len(events) >= 4 and "x␛[2J".encode() in events[-1], "events of all messages")
            link.reset(seed=1).send(None)
            link.receive()
            with pytest.raises(UnknownName) as caught:
                bus.acknowledge("room", EVIL, comment=EVIL)
            assert is_plain(str(caught.value))
        subscriber.undeclare()
        status = run("status", "--connect", program.endpoint)
        assert is_plain(status.stdout + status.stderr)
    return path, events


@pytest.mark.slow
def test_control_characters__node_sends_no_control_character_that_it_received(
    recorded: tuple[Path, list[bytes]],
) -> None:
    for raw in recorded[1]:
        event = msgpack.unpackb(raw)
        assert all(is_plain(value) for value in event.values() if isinstance(value, str)), event


@pytest.mark.slow
@pytest.mark.parametrize("sender", ["ev\x1bil", "ab\u202ecd"])
def test_control_characters__node_answers_requests_whose_sender_has_them(sender: str, scratch: Path) -> None:
    """A reply has to have the key of its query."""
    with (
        node_on_bus(scratch / "room", plant=PLANT, name="room") as (program, bus),
        raw_session(program.endpoint) as session,
    ):
        for topic in keys.TOPICS:
            if topic.has_sender and topic.delivery is keys.Delivery.QUERY:
                replies = list(session.get(topic.at("room", name=sender, sender=sender), timeout=60))
                assert [reply.ok is not None for reply in replies] == [True], topic.key
                error = codec.decode(ErrorReply, replies[0].ok.payload.to_bytes())
                assert is_plain(error.message), topic.key
        session.put("**", b"x")  # a key of every topic
        assert len(list(session.get("**", timeout=60))) > 10
        assert bus.status("room").step == [0]


@pytest.fixture(scope="module")
def hostile(recorded: tuple[Path, list[bytes]]) -> Path:
    """The recording as a hostile program would write it: every text that is not a name has control characters."""

    def changed(_: int, item: RecordedItem) -> bytes:
        message: dict[str, Any] = msgpack.unpackb(item.payload)
        for name in ("text", "source", "comment", "message"):
            is_name = name == "source" and item.schema != "Event"
            if isinstance(message.get(name), str) and not is_name:
                message[name] = EVIL
        if item.schema == "Sample":
            message["sources"] = ["baseline", *(EVIL for _ in message["sources"][1:])]
        return msgpack.packb(message)

    path = recorded[0]
    return rewrite(path, path.with_name("hostile.mcap"), changed, about={"zenostat": EVIL})


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("command", [("log",), ("verify", "--plant", PLANT), ("report",), ("export", "--to", "csv")])
def test_control_characters__no_command_prints_a_control_character_of_a_file(
    hostile: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    out = tmp_path / ("out.html" if command == ("report",) else "out.csv")
    output = ("--out", str(out)) if command[0] in ("report", "export") else ()
    printed = run(command[0], str(hostile), *command[1:], *output)
    assert is_plain(printed.stdout + printed.stderr)
    if command[0] == "log":
        assert printed.returncode == 0
        assert HARMLESS in printed.stdout
    if out.exists():
        assert is_plain(out.read_text(encoding="utf-8").replace("\t", " "))


@pytest.mark.slow
def test_control_characters__loaded_recording_has_none(hostile: Path) -> None:
    loaded = load(hostile)
    assert all(is_plain(f"{entry.source} {entry.subject} {entry.result}") for entry in loaded.log)
    assert any("x␛[2J" in entry.source for entry in loaded.log)
    assert {event.text for _, event in loaded.events} == {replace_controls(EVIL, keep="\n")}


def test_control_characters__replies_of_a_hostile_node_are_errors_without_them() -> None:
    reply = codec.decode(ErrorReply, codec.pack(error="RequestRejected", message=EVIL))
    assert is_plain(reply.message)
    assert codec.decode(Event, codec.pack(kind="failed", text=EVIL)).text == reply.message


def test_control_characters__monitor_shows_names_as_they_are_and_not_as_markdown() -> None:
    numbers = NodeNumbers(zones=1, sources=("[x](http://a) <b>|*y*",), faults=("a*b",))
    shown = markdown(numbers) + overview([NodeRow("room", "![i](http://a/i.png)", numbers)])
    assert "[x](http" not in shown
    assert "![i]" not in shown
    assert r"\[x\](http://a) \<b\>/\*y\*" in shown
    assert r"a\*b" in shown
