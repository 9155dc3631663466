"""Revocation, and what a node permits beside the rules of its links: real certificates, a node of a Python plant."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from support.certificates import house_keys
from support.events import events_of, next_event
from support.gateways import RunningGateway
from support.nodes import NodeProgram, free_port, until
from support.run_cli import run_program
from zenoh.handlers import FifoChannel

import zenostat
from zenostat import Bus
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.transport.certificates import add
from zenostat.bridge.transport.deny_list import REVOKED, read_revoked, revoke, shut_down
from zenostat.bridge.transport.session import Mode, open_session
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, NodeLost, NodeNotFound, RequestRejected, UnknownName, UsageError
from zenostat.topics.keys import Role
from zenostat.topics.messages import (
    Claim,
    Command,
    CreateBranch,
    DropSnapshot,
    ErrorReply,
    EventKind,
    Stop,
    TakeSnapshot,
    Write,
)

PLANT = "zenostat.agent_sdk.testing.fake_plant:FakePlant"
PEOPLE = ("ann", "bob", "cleo", "dan", "eve", "fay")
NO_LONGER = "revoked or not in the list of names"
BOTH = (Role.CONTROLLER, Role.OPERATOR)


@pytest.fixture(scope="module")
def pki(pki: Path) -> Path:
    for name in PEOPLE:
        add(pki, BOTH, name)
    add(pki, Role.NODE, "gate")
    return pki


@pytest.fixture(scope="module")
def node(module_folder: Path, pki: Path) -> Iterator[NodeProgram]:
    listen = [f"tls/127.0.0.1:{free_port()}"]
    with NodeProgram(module_folder / "node", plant=PLANT, name="room", listen=listen, keys=str(pki)) as running:
        yield running


def connect(node: NodeProgram, pki: Path, name: str) -> Bus:
    return zenostat.connect(node.endpoint, keys=pki / f"{name}.pem", affinity="off")


@pytest.fixture
def operator(node: NodeProgram, pki: Path) -> Iterator[Bus]:
    with connect(node, pki, "operator") as bus:
        yield bus


def ask(
    session: zenoh.Session, topic: keys.Topic, message: Any, sender: str, *, node: str = "room", name: str = ""
) -> Any:
    key = topic.at(node, sender=sender, name=name)
    (reply,) = session.get(key, payload=codec.encode(message), timeout=30)
    encoding, payload = str(reply.ok.encoding), reply.ok.payload.to_bytes()
    kind = ErrorReply if encoding == codec.encoding(ErrorReply) else topic.reply
    return codec.decode(kind, payload, encoding)


def by_request(operator: Bus, _: Path, name: str) -> None:
    assert operator.revoke("room", name).text == f"{name} is revoked"


def by_file(_: Bus, pki: Path, name: str) -> None:
    revoke(pki, name)


@pytest.mark.variants
@pytest.mark.parametrize(("act", "name"), [(by_request, "ann"), (by_file, "bob")])
def test_revoke__ends_claims_values_and_links_of_a_name_and_nothing_of_others(
    node: NodeProgram, pki: Path, operator: Bus, act: Callable[[Bus, Path, str], None], name: str
) -> None:
    others = connect(node, pki, "cleo")
    with others, connect(node, pki, name) as own, events_of(operator, "room") as events:
        actuator, *rest = [actuator.name for actuator in operator.manifest("room").actuators]
        link = own.controller("room", name="agent", priority=9)
        kept = others.controller("room", name="agent", priority=11)
        link.reset()
        link.send({actuator: 20.0})
        own.write("room", rest[0], 26.0 if rest[0] != actuator else 25.0, priority=3, source="screen")
        others.write("room", rest[0], None, priority=4)
        before = operator.priorities("room")
        assert before[rest[0]][2].source == f"{name}.screen"
        act(operator, pki, name)
        event = next_event(events, EventKind.REVOKED)
        assert event.source == name
        assert f"released: {link.name}" in event.text
        assert f"relinquished: {actuator}, {rest[0]}" in event.text or f"relinquished: {rest[0]}" in event.text
        status, after = operator.status("room"), operator.priorities("room")
        assert kept.name in {controller.controller for controller in status.controllers}
        assert link.name not in {controller.controller for controller in status.controllers}
        assert not [value for row in after.values() for value in row if (value.source or "").startswith(f"{name}.")]
        until(
            lambda: (operator.session.liveliness().get(keys.CONTROLLER_TOKEN.at("room", sender=link.name))) is not None,
            "",
        )
        until(lambda: ("room", link.name) not in operator.controllers(), "its link has ended")
        for _ in range(3):  # it connects again meanwhile, and is disconnected each time
            until(lambda: own.session.info.links() == [], "its link has ended")
            others.write("room", rest[0], None, priority=4)
        with pytest.raises(NodeLost, match=rf"node 'room' is gone \(last sample: .*\), or {name} is {NO_LONGER}"):
            link.receive()
    assert name in read_revoked(pki)


def test_revoke__values_of_the_name_do_not_come_back_with_a_snapshot(
    node: NodeProgram, pki: Path, operator: Bus
) -> None:
    with connect(node, pki, "cleo") as cleo, connect(node, pki, "eve") as eve, events_of(operator, "room") as events:
        revoked, kept = (f"zone_{number}_cooling_setpoint" for number in (1, 2))
        with cleo.controller("room", name="trainer", actuators=[]) as link:
            link.reset()
            cleo.write("room", kept, 25.0, priority=2)
            eve.write("room", revoked, 26.0, priority=2, source="screen")
            link.send({})
            link.receive()
            snapshot = cleo.snapshot("room", link.name).snapshot
            before = operator.priorities("room")
            assert before[revoked][1].source == "eve.screen"
            operator.revoke("room", "eve")
            assert next_event(events, EventKind.REVOKED).source == "eve"
            for _ in range(2):
                link.reset(snapshot=snapshot)
                after = operator.priorities("room")
                assert {name: row[1].source for name, row in after.items()} == {
                    name: "cleo" if name == kept else None for name in after
                }
                assert after[kept] == before[kept]
                link.send({})
                assert link.receive().value_source[revoked] != "eve.screen"
                event = next_event(events, EventKind.REVOKED)
                assert (event.source, event.text) == ("eve", f"eve is revoked; relinquished: {revoked}")
            branch = cleo.branch("room", CreateBranch(controller=link.name, snapshot=snapshot))
            assert operator.priorities(branch) == after


@pytest.mark.slow
def test_revoke__refuses_what_comes_through_a_router_by_name(scratch: Path, tmp_path: Path) -> None:
    """The router does not know yet that the name is revoked; the node does."""
    at_router, at_node = house_keys(tmp_path / "router"), tmp_path / "node"
    add(at_router, BOTH, "dan")
    at_node.mkdir(mode=0o700)
    for file in at_router.iterdir():
        (at_node / file.name).write_bytes(file.read_bytes())
        (at_node / file.name).chmod(0o600)
    endpoint = f"tls/127.0.0.1:{free_port()}"
    with (
        open_session(listen=[endpoint], keys=at_router, role=Role.NODE, mode=Mode.ROUTER),
        NodeProgram(scratch / "own", plant=PLANT, name="room", listen=[], connect=[endpoint], keys=str(at_node)),
        zenostat.connect(endpoint, keys=at_router / "dan.pem", affinity="off") as bus,
        zenostat.connect(endpoint, keys=at_router / "operator.pem", affinity="off") as operator,
        operator.session.declare_subscriber(keys.EVENT.at("room"), FifoChannel(4096)) as events,
    ):
        until(lambda: operator.nodes() == ["room"], "the node is there")
        actuator = operator.manifest("room").actuators[0]
        link = bus.controller("room")
        sample = link.reset()
        operator.revoke("room", "dan")
        next_event(events, EventKind.REVOKED)
        session, dan = bus.session, link.name
        session.put(keys.ACTUATOR.at("room", sender="dan", name=actuator.name), codec.encode(Write(value=None)))
        assert next_event(events, EventKind.REJECTED).text == f"{keys.ACTUATOR.key}: dan is revoked"
        session.put(keys.COMMAND.at("room", sender=dan), b"\x80")
        event = next_event(events, EventKind.REJECTED)
        assert (event.source, event.text) == (dan, "dan is revoked")
        command = Command(episode=sample.message.episode, step=sample.message.step, values=b"")
        for topic, message in (
            (keys.CLAIM, Claim(controller=dan)),
            (keys.COMMAND_REQUEST, command),
            (keys.WRITE_REQUEST, Write(value=None)),
            (keys.STOP, Stop()),
        ):
            reply = ask(session, topic, message, dan, name=actuator.name)
            assert (reply.error, reply.message) == ("AccessDenied", "dan is revoked")
        assert operator.status("room").step == [0], "nothing of it had an effect"


def test_revoked_name__has_no_rules_once_a_node_has_started(tmp_path: Path) -> None:
    pki, endpoint = house_keys(tmp_path / "keys"), f"tls/127.0.0.1:{free_port()}"
    revoke(pki, "monitor")
    with (
        open_session(listen=[endpoint], keys=pki, role=Role.NODE) as node,
        node.declare_queryable(keys.STATUS.at("room"), lambda query: query.reply(query.key_expr, b"yes")),
    ):
        for name, replies in (("monitor", 0), ("operator", 1)):
            with open_session(connect=[endpoint], keys=pki, certificate=name) as session:
                assert len(list(session.get(keys.STATUS.at("room"), timeout=30))) == replies
        with (
            zenostat.connect(endpoint, keys=pki / "monitor.pem", affinity="off") as bus,
            pytest.raises(
                NodeNotFound,
                match=r"no node 'room' on .*; there are none \(one may be starting\), or monitor is revoked or not in",
            ),
        ):
            bus.status("room")


def test_access__controller_ends_its_own_branches_and_drops_its_own_snapshots_only(
    node: NodeProgram, pki: Path, operator: Bus
) -> None:
    with (
        connect(node, pki, "cleo") as cleo,
        connect(node, pki, "second") as second,
        connect(node, pki, "controller") as other,
    ):
        with cleo.controller("room", priority=12, required=False) as starting:
            starting.reset()
        link, foreign = second.controller("room", required=False), other.controller("room", priority=11, required=False)
        snapshot = ask(link.bus.session, keys.SNAPSHOT, TakeSnapshot(), link.name).snapshot
        branch = second.branch("room", CreateBranch(controller=link.name))
        reply = ask(other.session, keys.DROP_SNAPSHOT, DropSnapshot(snapshot=snapshot), foreign.name)
        assert (reply.error, reply.message) == ("AccessDenied", f"snapshot {snapshot} is that of {link.name!r}")
        for target, reason in (("room", "may not stop a node"), (branch, "may not end a branch of")):
            reply = ask(other.session, keys.STOP, Stop(), "controller", node=target)
            assert reply.error == "AccessDenied"
            assert reason in reply.message
        assert operator.status("room").snapshots[0].name == snapshot
        assert branch in operator.nodes()
        second.stop(branch)
        until(lambda: branch not in operator.nodes(), "the branch has ended")
        second.drop("room", snapshot)
        assert operator.status("room").snapshots == []
        left = second.snapshot("room").snapshot
        operator.drop("room", left)  # an operator drops any
        assert operator.status("room").snapshots == []


@pytest.mark.slow
def test_access__reading_commands_take_a_certificate_of_any_role(node: NodeProgram, pki: Path) -> None:
    for keys_and_name in (("--keys", pki, "--certificate", "second"), ("--keys", pki / "second.pem")):
        done = run_program("status", "--connect", node.endpoint, *map(str, keys_and_name), cwd=pki)
        assert done.returncode == 0, done.stderr
        assert "room" in done.stdout
    refused = run_program("pace", "room", "1", "--connect", node.endpoint, "--keys", str(pki / "second.pem"), cwd=pki)
    assert "operator expected" in refused.stderr


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"role": "oper"}, "there is no role 'oper'; did you mean 'operator'"),
        ({"role": "node"}, "there is no role 'node'"),
        ({"affinity": "x"}, "there is no affinity 'x'"),
        ({"keys": "node.pem"}, "is that of a node; another program connects with its own"),
    ],
)
def test_connect__names_what_is_wrong(
    arguments: dict[str, str], text: str, node: NodeProgram, pki: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(pki)
    with pytest.raises(UsageError, match=text):
        zenostat.connect(node.endpoint, **{"keys": str(pki), **arguments})  # type: ignore[arg-type]


@pytest.mark.slow
def test_revoke__gateway_names_it_as_a_reason_why_it_has_no_node(node: NodeProgram, pki: Path, operator: Bus) -> None:
    options = ("--connect", node.endpoint, "--keys", str(pki), "--address", "127.0.0.1:0")
    with RunningGateway("modbus", "room", *options) as gateway:
        operator.revoke("room", "gateway")
        assert gateway.program.stdout.readline() == f"room: gone, or gateway is {NO_LONGER}; waiting for it\n"


def test_revoke__what_cannot_be_revoked(node: NodeProgram, pki: Path, operator: Bus) -> None:
    with pytest.raises(UnknownName, match="no name 'anne' in the list of names; did you mean 'ann'"):
        operator.revoke("room", "anne")
    with pytest.raises(RequestRejected, match="this node's own name"):
        operator.revoke("room", "node")
    with pytest.raises(RequestRejected, match="operator is your own name"):
        operator.revoke("room", "operator")
    with pytest.raises(RequestRejected, match="gate is the name of a node or router, on which others may depend"):
        operator.revoke("room", "gate")
    with (
        connect(node, pki, "second") as controller,
        pytest.raises(InvalidConfig, match="that also has the role operator"),
    ):
        controller.revoke("room", "ann")


def test_revoke__says_that_the_node_cannot_keep_the_name(node: NodeProgram, pki: Path, operator: Bus) -> None:
    lock = pki / ".names.lock"
    with events_of(operator, "room") as events:
        lock.mkdir()
        text = operator.revoke("room", "fay").text
        lock.rmdir()
        assert text.startswith(f"fay is revoked until this node ends: cannot create {lock}: Is a directory; before")
        assert next_event(events, EventKind.REVOKED).source == "fay"
        assert next_event(events, EventKind.WARNING).text == text


@pytest.mark.slow
def test_revoked_file__that_is_damaged_is_reported_and_the_names_stay(scratch: Path, tmp_path: Path) -> None:
    pki, listen = house_keys(tmp_path / "keys"), [f"tls/127.0.0.1:{free_port()}"]
    with (
        NodeProgram(scratch / "own", plant=PLANT, name="room", listen=listen, keys=str(pki)) as node,
        connect(node, pki, "operator") as bus,
        events_of(bus, "room") as events,
    ):
        (pki / REVOKED).write_text("second # left\nnot a name\n")
        assert "line 2: 'not a name' is not a name" in next_event(events, EventKind.WARNING).text
        with connect(node, pki, "second") as second:
            assert second.nodes() == ["room"]
        (pki / REVOKED).write_text("second # left\n")
        assert next_event(events, EventKind.REVOKED).source == "second"
        (pki / REVOKED).write_text("")
        assert "revoked.txt no longer has second" in next_event(events, EventKind.WARNING).text
    (pki / REVOKED).write_text("-\n")
    with pytest.raises(InvalidConfig, match="line 1"):
        read_revoked(pki)


@pytest.mark.slow
def test_revoke__without_keys_is_refused(scratch: Path) -> None:
    with (
        NodeProgram(scratch / "open", plant=PLANT, name="room") as node,
        zenostat.connect(node.endpoint, affinity="off") as bus,
        pytest.raises(RequestRejected, match="has no keys"),
    ):
        bus.revoke("room", "ann")


def test_certificate__new_one_is_read_at_the_next_connection(tmp_path: Path) -> None:
    """A program's certificate is exchanged while it runs: its next connection presents the new one."""
    folder, endpoint = house_keys(tmp_path / "keys"), f"tls/127.0.0.1:{free_port()}"
    with (
        open_session(listen=[endpoint], keys=folder, role=Role.NODE) as node,
        open_session(connect=[endpoint], keys=folder, certificate="second"),
    ):

        def names() -> list[str]:
            return [link.auth_identifier for link in node.info.links()]

        until(lambda: names() == ["second"], "it is connected")
        for kind in ("pem", "key"):  # another name shows which one is presented
            (folder / f"trainer.{kind}").replace(folder / f"second.{kind}")
        shut_down(node.info.links())
        until(lambda: names() == ["trainer"], "it has connected again")


@pytest.mark.slow
def test_resumed_node__has_nothing_of_names_that_were_revoked_meanwhile(scratch: Path, tmp_path: Path) -> None:
    folder, path = house_keys(tmp_path / "keys"), scratch / "run.mcap"
    for name in ("ann", "dan"):
        add(folder, BOTH, name)
    settings = {"plant": PLANT, "name": "room", "listen": [f"tls/127.0.0.1:{free_port()}"], "keys": str(folder)}
    with NodeProgram(scratch / "first", **settings, record=str(path)) as node:
        with connect(node, folder, "dan") as dan, connect(node, folder, "ann") as ann:
            first, second, *_ = [actuator.name for actuator in ann.manifest("room").actuators]
            link = ann.controller("room", name="agent", priority=11)
            dan.controller("room", name="agent", priority=9, required=False)
            link.reset()
            for _ in range(5):
                link.send({first: 20.0})
                link.receive()
            dan.write("room", second, 26.0, priority=3)
            ann.write("room", second, 25.0, priority=4)
            before = ann.priorities("room")
        until(lambda: second.encode() + b" = 25" in _events(path), "all of it is recorded")
        node.kill()
    revoke(folder, "dan")
    with NodeProgram(scratch / "second", **settings, resume=str(path)) as node, connect(node, folder, "ann") as ann:
        after, status = ann.priorities("room"), ann.status("room")
        assert [controller.controller.partition("-")[0] for controller in status.controllers] == ["ann.agent"]
        assert status.step == [5]
    assert (before[second][2].source, after[second][2].source) == ("dan", None)
    assert after[second][3] == before[second][3]
    assert after[first] == before[first]


def _events(path: Path) -> bytes:
    with RecordingReader(path) as reader:
        return b"".join(item.payload for item in reader.messages({"Event"}))
