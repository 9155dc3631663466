"""Commands and writes as requests, from a bare session: each has one reply, which says what a put's event would say."""

import queue
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgpack
import numpy as np
import pytest
import zenoh
from support.nodes import NodeProgram, until
from zenoh.handlers import Callback

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.exchange.step_exchange import MAX_MESSAGES_PER_STEP
from zenostat.bridge.node.publications import EVENTS_A_STEP
from zenostat.bridge.node.waiting import MAX_PENDING
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, NodeNotFound
from zenostat.topics.keys import Topic
from zenostat.topics.messages import (
    Ack,
    Claim,
    Command,
    CreateBranch,
    ErrorReply,
    Event,
    EventKind,
    Flag,
    Message,
    Reset,
    Sample,
    State,
    Status,
    Write,
)

POINT = "core_zn_cooling_setpoint"
REPLIES = {codec.encoding(kind): kind for kind in (Ack, ErrorReply)}


class Client:
    """A Zenoh session and what it has heard of the node; nothing of the package's own client."""

    def __init__(self, session: zenoh.Session, bus: Bus) -> None:
        self.session, self.bus = session, bus
        self.events: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
        self.samples: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
        session.declare_subscriber(keys.EVENT.at("office"), Callback(self.events.put, indirect=False))
        session.declare_subscriber(keys.SAMPLE.at("office"), Callback(self.samples.put, indirect=False))
        self.ask(keys.RESET, "tester", Reset())  # the reply shows that the node has heard of the subscriptions
        self.sample = self.next_sample()
        self.actuators = [actuator.name for actuator in bus.manifest("office").actuators]

    def start(self, topic: Topic, name: str, content: Message | bytes, encoding: str = "") -> queue.SimpleQueue[Any]:
        """Send a request; return the queue of its replies, which ends with None."""
        replies: queue.SimpleQueue[Any] = queue.SimpleQueue()
        payload = content if isinstance(content, bytes) else codec.encode(content)
        handler = Callback(replies.put, lambda: replies.put(None), indirect=False)
        zenoh_encoding = zenoh.Encoding(encoding) if encoding else None
        self.session.get(_key(topic, name, payload), handler, payload=payload, encoding=zenoh_encoding, timeout=60)
        return replies

    @staticmethod
    def reply(replies: queue.SimpleQueue[Any]) -> Any:
        """The one reply of a request; None if it has none."""
        received = list(iter(lambda: replies.get(timeout=60), None))
        assert len(received) <= 1
        if not received:
            return None
        ok = received[0].ok
        return codec.decode(REPLIES[str(ok.encoding)], ok.payload.to_bytes(), str(ok.encoding))

    def ask(self, topic: Topic, name: str, content: Message | bytes, encoding: str = "") -> Any:
        return self.reply(self.start(topic, name, content, encoding))

    def put(self, topic: Topic, name: str, content: Message | bytes, encoding: str = "") -> None:
        payload = content if isinstance(content, bytes) else codec.encode(content)
        zenoh_encoding = zenoh.Encoding(encoding) if encoding else None
        self.session.put(_key(topic, name, payload), payload, encoding=zenoh_encoding)

    def claim(self, name: str, actuators: list[str] | None = None, **more: Any) -> None:
        assert isinstance(self.ask(keys.CLAIM, name, Claim(controller=name, actuators=actuators, **more)), Ack)

    def event(self, source: str) -> Event:
        """The next event of a source that is not about its claim."""
        while True:
            event = codec.decode(Event, self.events.get(timeout=60).payload.to_bytes())
            if event.source == source and event.kind is not EventKind.CONNECTED:
                return event

    def next_sample(self) -> Sample:
        self.sample = codec.decode(Sample, self.samples.get(timeout=60).payload.to_bytes())
        return self.sample

    def command(self, *, step: int | None = None, value: float = 25.0, **points: int) -> Command:
        """A command that sets all actuators, or those in `points` to their value."""
        values = np.full(len(self.actuators), value)
        values[["heating" in name for name in self.actuators]] = 20.0
        operations = bytes(name in points for name in self.actuators) if points else None
        for name, number in points.items():
            values[self.actuators.index(name)] = number
        at = self.sample.step if step is None else [step]
        return Command(episode=self.sample.episode, step=at, operations=operations, values=values.tobytes())


def _key(topic: Topic, name: str, payload: bytes) -> str:
    """The key of a message: of a write, `name` is the actuator, and its source the sender; else it is the sender."""
    if not topic.key.endswith("{name}"):
        return topic.at("office", sender=name)
    try:
        source = msgpack.unpackb(payload)["source"]
    except Exception:
        source = ""
    return topic.at("office", name=name, sender=source or "panel")


def counts(status: Status) -> tuple[int, int, int, int]:
    return status.accepted, status.rejected, status.late, status.duplicate


@pytest.fixture
def client(bus: Bus) -> Iterator[Client]:
    with open_session(connect=[bus.endpoint]) as session:
        yield Client(session, bus)


def agree(client: Client, topics: tuple[Topic, Topic], name: str, content: Any, source: str, **more: Any) -> Any:
    """Put a message and request it: the events and what is counted are the same; the reply repeats the event."""
    put, request = topics
    before = counts(client.bus.status("office"))
    client.put(put, name, content, **more)
    event = client.event(source)
    between = counts(client.bus.status("office"))
    reply = client.ask(request, name, content, **more)
    again = client.event(source)
    after = counts(client.bus.status("office"))
    assert again.model_copy(update={"late_s": event.late_s}) == event
    assert (event.late_s is None) == (again.late_s is None) == (event.kind is not EventKind.LATE)
    assert np.subtract(between, before).tolist() == np.subtract(after, between).tolist()
    if event.kind is EventKind.WRITTEN:
        assert reply == Ack(episode=client.sample.episode, step=client.sample.step, text=event.text)
    else:
        assert sum(after) == sum(before) + 2
        assert reply.message == event.text
    return reply


WRITES = keys.ACTUATOR, keys.WRITE_REQUEST
COMMANDS = keys.COMMAND, keys.COMMAND_REQUEST


@pytest.mark.slow
def test_bus__write_is_answered_as_its_event_states(client: Client) -> None:
    def write(name: str = POINT, /, **fields: Any) -> Any:
        return agree(client, WRITES, name, msgpack.packb({"source": "panel", **fields}), "panel")

    assert write(value=26.5).text == f"{POINT} = 26.5 degC at priority 8"
    assert write(value=24.0, priority=9).text == f"{POINT} = 24 degC at priority 9"
    client.claim("c", required=False)
    rejected = {
        "no actuator 'chair'": write("chair", value=1.0),
        f"{POINT} = 99; its bounds are": write(value=99.0),
        f"priority 10 of '{POINT}' is claimed by 'c'": write(value=25.0, priority=10),
    }
    assert {reply.error for reply in rejected.values()} == {"RequestRejected"}
    assert all(reply.message.startswith(words) for words, reply in rejected.items())
    malformed = {
        f"{POINT}: Write: value: Input should be a valid number": write(value="warm"),
        f"{POINT}: Write: priority": write(value=25.0, priority=17),
        f"{POINT}: Write: value: it is missing": write(),
        f"{POINT}: not msgpack": agree(client, WRITES, POINT, b"\xc1", "panel"),
        f"{POINT}: expected encoding": agree(client, WRITES, POINT, b"\x80", "panel", encoding="text/plain"),
    }
    assert {reply.error for reply in malformed.values()} == {"BadMessage"}
    assert all(reply.message.startswith(words) for words, reply in malformed.items())
    for priority in (8, 9):  # both forms have had an effect
        client.put(keys.ACTUATOR, POINT, msgpack.packb({"value": None, "priority": priority, "source": "hand"}))
        assert client.event("hand").text == f"{POINT} relinquished at priority {priority}"


def test_bus__write_that_is_acknowledged_is_in_effect_in_the_next_timestep(client: Client) -> None:
    client.claim("c", required=True)
    ack = client.ask(keys.WRITE_REQUEST, POINT, msgpack.packb({"value": 26.5, "source": "panel"}))
    assert (ack.episode, ack.step) == (client.sample.episode, client.sample.step)
    assert isinstance(client.ask(keys.COMMAND_REQUEST, "c", client.command()), Ack)
    sample = client.next_sample()
    index = client.actuators.index(POINT)
    assert sample.step == [ack.step[0] + 1]
    assert np.frombuffer(sample.effective)[index] == np.frombuffer(sample.commanded)[index] == 26.5
    assert sample.sources[np.frombuffer(sample.source_index, "<u2")[index]] == "panel"


def test_bus__write_that_ends_with_a_timestep_is_over_at_its_sample(client: Client) -> None:
    """The sample has its value, and the priorities after it have it no more, however long the node waits there."""

    def sources() -> set[str | None]:
        return {each.source for each in client.bus.priorities("office")[POINT]} - {None}

    client.claim("c")
    step_s = client.bus.manifest("office").step_s
    client.ask(keys.WRITE_REQUEST, POINT, msgpack.packb({"value": 26.5, "duration_s": step_s, "source": "panel"}))
    assert client.event("panel").kind is EventKind.WRITTEN
    assert sources() == {"panel"}
    assert isinstance(client.ask(keys.COMMAND_REQUEST, "c", client.command()), Ack)
    sample = client.next_sample()
    assert np.frombuffer(sample.effective)[client.actuators.index(POINT)] == 26.5
    event = client.event("panel")
    assert (event.kind, event.step) == (EventKind.EXPIRED, sample.step[0])
    assert sources() == {"c"}


@pytest.mark.slow
def test_bus__write_acts_in_the_timestep_that_the_next_command_of_its_session_completes(client: Client) -> None:
    """Both are puts, so nothing waits between them: hundreds of pairs, in the order in which they were sent."""
    client.claim("one")
    index, misplaced = client.actuators.index(POINT), []
    for number in range(200):
        value = 26.0 + number % 3
        client.put(keys.ACTUATOR, POINT, Write(value=value, source="writer"))
        client.put(keys.COMMAND, "one", client.command(), codec.encoding(Command))
        sample = client.next_sample()
        if np.frombuffer(sample.commanded)[index] != value:
            misplaced.append(number)
        if sample.flags[0] & Flag.TRUNCATED:
            client.ask(keys.RESET, "tester", Reset())
            client.next_sample()
    assert misplaced == []


@pytest.mark.slow
def test_bus__command_is_answered_as_its_event_states(client: Client) -> None:
    """c and d in lockstep: what is wrong, then an answer of each, one put and one requested; then what is late."""
    other = next(name for name in client.actuators if name != POINT)

    def command(content: Command | bytes, name: str = "c", **more: Any) -> tuple[str, str]:
        reply = agree(client, COMMANDS, name, content, name, **more)
        return reply.error, reply.message

    right = client.command(**{POINT: 26})
    error, text = command(right)
    assert (error, text) == ("RequestRejected", "'c' has claimed nothing; claim first")
    client.claim("c", [POINT])
    client.claim("d", [other])
    rejected = {
        f"{POINT} = 99; its bounds are": command(client.command(**{POINT: 99})),
        f"{other!r} is not among the actuators that it claimed": command(client.command(**{other: 20})),
        "it answers episode [1] step [7]; the current ones": command(client.command(step=7)),
        "values has 0 bytes": command(right.model_copy(update={"values": b""})),
        "no slot is answered": command(right.model_copy(update={"step": [None]})),
    }
    assert {error for error, _ in rejected.values()} == {"RequestRejected"}
    assert all(text.startswith(words) for words, (_, text) in rejected.items())
    malformed = {
        "not msgpack": command(b"\xc1"),
        "Command: episode: it is missing": command(b"\x80"),
        "expected encoding": command(right, encoding="application/msgpack;zenostat/1.Command"),
    }
    assert {error for error, _ in malformed.values()} == {"BadMessage"}
    assert all(text.startswith(words) for words, (_, text) in malformed.items())
    for first, second in (("c", "d"), ("d", "c")):
        accepted = client.bus.status("office").accepted
        own = {"c": {POINT: 26}, "d": {other: 20}}
        ack = client.ask(keys.COMMAND_REQUEST, first, client.command(**own[first]))
        assert ack == Ack(episode=client.sample.episode, step=client.sample.step)
        assert client.bus.status("office").step == client.sample.step, "it waits for the other"
        assert command(client.command(**own[first]), first)[1] == f"step {client.sample.step} is already answered"
        client.put(keys.COMMAND, second, client.command(**own[second]))
        client.next_sample()
        assert client.bus.status("office").accepted == accepted + 2
        error, text = command(client.command(step=0, **own[first]), first)
        assert (error, text.partition(";")[0]) == ("RequestRejected", "it answers episode [1] step [0]")
    status = client.bus.status("office")
    assert (status.late, status.duplicate) == (4, 4)


@contextmanager
def computing(client: Client, node: NodeProgram) -> Iterator[None]:
    """A timestep that a command of `c` has begun; its engine stands still within the context."""
    client.claim("c")
    node.engine.send_signal(signal.SIGSTOP)
    try:
        assert isinstance(client.ask(keys.COMMAND_REQUEST, "c", client.command()), Ack)
        until(lambda: client.bus.status("office").state is State.RUNNING, "the node computes")
        yield
    finally:
        node.engine.send_signal(signal.SIGCONT)


@pytest.mark.slow
def test_bus__command_is_answered_at_once_and_not_after_its_timestep(client: Client, node: NodeProgram) -> None:
    """the engine stands still → the command is acknowledged → it goes on → the sample"""
    with computing(client, node):
        asked = [client.start(keys.WRITE_REQUEST, POINT, b"\x80") for _ in range(MAX_PENDING + 3)]
        late = client.start(keys.COMMAND_REQUEST, "c", client.command())
        busy = [client.reply(replies) for replies in asked[MAX_PENDING:]]
    assert [(reply.error, "pending requests" in reply.message) for reply in busy] == [("RequestRejected", True)] * 3
    assert [client.reply(replies).error for replies in asked[:MAX_PENDING]] == ["BadMessage"] * MAX_PENDING
    assert client.reply(late).message.startswith("it answers episode [1] step [0]; the current ones are")
    assert client.next_sample().step == [1]
    status = client.bus.status("office")
    assert (status.statistics.rate_limited, status.rejected, status.late) == (3, MAX_PENDING, 1)


@pytest.mark.slow
def test_bus__write_that_gives_way_to_a_newer_one_is_counted_once(client: Client, node: NodeProgram) -> None:
    with computing(client, node):
        for _ in range(MAX_PENDING + 3):
            client.put(keys.ACTUATOR, POINT, b"\x80")
        until(lambda: client.bus.status("office").statistics.rate_limited == 3, "all have arrived")
    client.next_sample()
    reply = client.ask(keys.WRITE_REQUEST, POINT, msgpack.packb({"value": 26.0, "priority": 4}))
    assert isinstance(reply, Ack), "all that waited were handled before"
    status = client.bus.status("office")
    assert (status.rejected, status.statistics.rate_limited) == (MAX_PENDING, 3)


@pytest.mark.slow
def test_bus__day_of_commands_sent_at_once_is_answered_step_by_step(client: Client) -> None:
    """Requests for steps 0 to 95 without a pause: each is accepted, because the node steps before it reads the next."""
    client.claim("c")
    asked = [client.start(keys.COMMAND_REQUEST, "c", client.command(step=step)) for step in range(96)]
    assert [client.reply(replies) for replies in asked] == [Ack(episode=[1], step=[step]) for step in range(96)]
    assert [client.next_sample().step for _ in range(96)] == [[step + 1] for step in range(96)]
    event = agree(client, COMMANDS, "c", client.command(), "c")
    assert (event.error, event.message) == ("RequestRejected", "the episode is over")
    reply = agree(client, WRITES, POINT, msgpack.packb({"value": 26.0, "source": "panel"}), "panel")
    assert (reply.error, "the episode is over" in reply.message) == ("RequestRejected", True)
    client.bus.stop("office")
    until(lambda: client.bus.nodes() == [], "the node has ended")
    assert client.ask(keys.COMMAND_REQUEST, "c", client.command()) is None
    assert client.ask(keys.WRITE_REQUEST, POINT, msgpack.packb({"value": 26.0})) is None
    with pytest.raises(NodeNotFound):
        client.bus.write("office", POINT, 26.0)


@pytest.mark.slow
def test_bus__each_of_a_hundred_rejections_has_its_reason_and_further_ones_are_not_processed(client: Client) -> None:
    client.claim("c")
    wrong = client.command(value=99.0)
    replies = [client.ask(keys.COMMAND_REQUEST, "c", wrong) for _ in range(MAX_MESSAGES_PER_STEP + 5)]
    reasons = [f"{POINT} = 99; its bounds are" in reply.message for reply in replies]
    assert reasons == [True] * MAX_MESSAGES_PER_STEP + [False] * 5
    limit = f"more than {MAX_MESSAGES_PER_STEP} messages in one step"
    assert all(reply.message.startswith(limit) for reply in replies[MAX_MESSAGES_PER_STEP:])
    assert isinstance(client.ask(keys.COMMAND_REQUEST, "c", client.command()), Ack), "the fast path is not limited"
    client.next_sample()
    texts = [client.event("c").text for _ in range(EVENTS_A_STEP)]
    assert texts == [reply.message for reply in replies[:EVENTS_A_STEP]]
    assert f"{POINT} = 98; its bounds are" in client.ask(keys.COMMAND_REQUEST, "c", client.command(value=98.0)).message
    assert f"{POINT} = 98; its bounds are" in client.event("c").text, "of the others there were no events"
    status = client.bus.status("office")
    assert (status.rejected, status.statistics.rate_limited) == (MAX_MESSAGES_PER_STEP + 1, 5)


@pytest.mark.slow
def test_bus__faults_of_the_link_apply_to_commands_in_both_forms(client: Client) -> None:
    """lost, doubled and delayed commands of c, of which another controller waits in each step"""
    other = [name for name in client.actuators if name != POINT]
    client.claim("c", [POINT])
    client.claim("d", other, required=True)
    bus = client.bus

    def faults(kind: str, **more: Any) -> None:
        """Faults of the link of commands that answer the present sample, too."""
        bus.faults("office", {"faults": [{"name": "link", "kind": kind, "commands": "c", **more}]})

    faults("loss", probability=1.0)
    lost = client.ask(keys.COMMAND_REQUEST, "c", client.command(**{POINT: 26}))
    assert (lost.error, lost.message) == ("BusError", "an injected fault of the link lost the command")
    assert bus.status("office").faults == ["link (1 messages)"]
    assert bus.status("office").controllers[0].accepted == 0
    bus.faults("office", None)
    faults("duplicate", probability=1.0)
    step = client.sample.step
    assert client.ask(keys.COMMAND_REQUEST, "c", client.command(**{POINT: 26})) == Ack(episode=[1], step=step)
    assert client.event("c").kind is EventKind.DUPLICATE
    bus.faults("office", None)
    client.put(keys.COMMAND, "d", client.command(**{other[0]: 20}))
    client.next_sample()
    faults("latency", delay_ms=50.0)
    step = client.sample.step
    assert client.ask(keys.COMMAND_REQUEST, "c", client.command(**{POINT: 26})) == Ack(episode=[1], step=step)
    assert client.ask(keys.COMMAND_REQUEST, "c", b"\xc1").error == "BadMessage"
    assert "link (2 messages)" in bus.status("office").faults
    assert isinstance(client.ask(keys.COMMAND_REQUEST, "stranger", b"\xc1"), ErrorReply)
    assert "link (2 messages)" in bus.status("office").faults, "whoever has no claim has no link"


@pytest.mark.slow
def test_bus__key_with_wildcards_names_no_controller_and_no_actuator(client: Client) -> None:
    client.claim("c")
    for name in ("*", "c$*", "**"):
        write = msgpack.packb({"value": 26.0})
        for topic, payload in ((keys.COMMAND_REQUEST, client.command()), (keys.WRITE_REQUEST, write)):
            assert "wildcard in place of a name" in client.ask(topic, name, payload).message
    assert client.bus.status("office").accepted == 0


@pytest.mark.slow
def test_bus__branch_answers_commands_and_writes(client: Client) -> None:
    with client.bus.controller("office") as link:
        link.current()
        link.send()
        link.receive()
        branch = client.bus.branch("office", CreateBranch(controller=link.name))
        ack = client.bus.write(branch, POINT, 26.0, source="panel")
        assert (ack.step, ack.text) == ([1], f"{POINT} = 26 degC at priority 8")
        assert client.bus.status("office").step == [1]


@pytest.mark.slow
def test_bus__monitor_may_not_write(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus, "roles", (keys.Role.MONITOR,))
    with pytest.raises(InvalidConfig, match=r"may not query rpc/write/\{sender\}/\{name\}"):
        bus.write("office", POINT, 26.0)
