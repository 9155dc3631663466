"""Nodes of one name: of those that start at once, one remains; others report each other."""

import math
import subprocess
import sys
from pathlib import Path

import pytest
import zenoh
from support.nodes import node_on_bus, until

from zenostat.bridge.node import names
from zenostat.bridge.node.names import NameWatch
from zenostat.bridge.runtime.timer import Timer
from zenostat.bridge.transport.session import Mode, open_session
from zenostat.topics import codec, keys
from zenostat.topics.errors import NameInUse, RequestRejected
from zenostat.topics.messages import CreateBranch, Event

pytestmark = pytest.mark.process

PROGRAM = """
import sys
from zenostat.bridge.node import names
names.SETTLE_S = float(sys.argv.pop(1))
from zenostat.cli.main import main
main()
"""
LOWEST, HIGHEST = "0", "g"
"""Instances below and above each session id, which is hexadecimal and has no zeros at its beginning."""


def declare(session: zenoh.Session, instance: str, name: str = "room") -> zenoh.LivelinessToken:
    return session.liveliness().declare_token(keys.NODE_TOKEN.at(name, name=instance))


def test_name_watch__of_nodes_that_start_at_once_the_lowest_remains(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(names, "SETTLE_S", math.inf)
    endpoint = f"unixsock-stream/{folder}/bus"
    instances, ended, reported = list[str](), list[str](), list[str]()
    with open_session(listen=[endpoint], mode=Mode.ROUTER), Timer() as timer:
        nodes = [open_session(connect=[endpoint]) for _ in range(4)]
        for node in nodes:
            session = node.__enter__()
            instances.append(own := str(session.zid()))

            def end(error: NameInUse, own: str = own) -> None:
                assert "a node named 'room' is on this bus already" in str(error)
                ended.append(own)

            NameWatch(session, "room", timer, end, reported.append)
        tokens = [declare(node.__enter__(), instance) for node, instance in zip(nodes, instances, strict=True)]
        others = sorted(instances)[1:]
        until(lambda: {*ended} >= {*others}, "all others end")
        assert min(instances) not in ended
        assert not reported
        for token in tokens:
            token.undeclare()
        for node in nodes:
            node.__exit__()


def test_name_watch__nodes_that_have_settled_report_each_other(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(names, "SETTLE_S", 0.0)
    endpoint, ended, reported = f"unixsock-stream/{folder}/bus", list[NameInUse](), list[str]()
    with open_session(listen=[endpoint]) as node, open_session(connect=[endpoint]) as other, Timer() as timer:
        watch = NameWatch(node, "room", timer, ended.append, reported.append)
        tokens = [declare(node, str(node.zid()))]
        for instance in (LOWEST, HIGHEST):
            tokens.append(declare(other, instance))
            until(lambda instance=instance: reported[-1:] == [instance], "it is reported")
        tokens[1].undeclare()
        until(lambda: len(reported) == 3, "one has left")
        tokens[2].undeclare()
        until(lambda: len(reported) == 4, "the other has left")
        watch.close()
    assert reported == [LOWEST, HIGHEST, HIGHEST, ""]
    assert not ended


def test_name_watch__node_that_ends_at_once_is_not_reported(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(names, "monotonic", lambda: clock[0])
    endpoint, ended, reported = f"unixsock-stream/{folder}/bus", list[NameInUse](), list[str]()
    with (
        open_session(listen=[endpoint]) as node,
        open_session(connect=[endpoint]) as other,
        Timer(lambda: clock[0]) as timer,
    ):
        watch = NameWatch(node, "room", timer, ended.append, reported.append)
        brief = declare(other, HIGHEST)
        until(lambda: watch._others, "it is seen")
        brief.undeclare()
        until(lambda: not watch._others, "it has left")
        lasting = declare(other, HIGHEST + "2")
        until(lambda: watch._others, "it is seen")
        clock[0] = names.SETTLE_S
        timer.at(0.0, lambda: None)  # wakes its thread
        until(lambda: reported, "the one that stays is reported")
        lasting.undeclare()
        watch.close()
    assert reported[0] == HIGHEST + "2"
    assert not ended


@pytest.mark.parametrize(("settle_s", "is_ended"), [("inf", True), ("0", False)])
def test_node__another_with_a_lower_id(folder: Path, settle_s: str, is_ended: bool) -> None:
    """Before it has settled the node ends with an error; after that it prints a warning, though nobody uses it."""
    endpoint = f"unixsock-stream/{folder}/bus"
    words = ("node", "--plant", "zenostat.agent_sdk.testing.fake_plant:FakePlant", "--name", "room")
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, settle_s, *words, "--listen", endpoint],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert "Press Ctrl-C" in process.stdout.readline()
        with open_session(connect=[endpoint]) as other, declare(other, LOWEST):
            if is_ended:
                text = process.stderr.readline()
                assert text.startswith(f"error: a node named 'room' is on this bus already (instance {LOWEST})")
                assert process.wait() == 1
            else:
                text = process.stdout.readline()
                assert text.startswith(f"warning: another node named 'room' (instance {LOWEST}) is on this bus")
                process.terminate()
                assert process.wait() == 0


def test_branches__leave_their_names_to_other_nodes(folder: Path) -> None:
    """A branch takes no name that is in use, and ends when a node takes its name at the same time."""
    settings = {"plant": "zenostat.agent_sdk.testing.fake_plant:FakePlant", "name": "room"}
    with node_on_bus(folder, **settings) as (node, bus), open_session(connect=[node.endpoint]) as other:
        events = list[Event]()

        def add(sample: zenoh.Sample) -> None:
            events.append(codec.decode(Event, sample.payload.to_bytes()))

        with (
            bus.controller("room") as link,
            other.declare_subscriber(keys.EVENT.at("room"), add),
        ):
            link.reset()
            building = declare(other, HIGHEST, "room.b1")
            tokens = keys.NODE_TOKEN.at("room.b1", name="*")
            until(lambda: [*bus.session.liveliness().get(tokens)], "the other node is on the bus")
            branch = bus.branch("room", CreateBranch(controller=link.name))
            assert branch == "room.b2"
            at_once = declare(other, HIGHEST, branch)
            until(lambda: not bus.status("room").branches, "the branch has ended")
            until(lambda: [e for e in events if e.text.startswith(f"branch {branch} ends")], "its node says why")
            assert bus.branch("room", CreateBranch(controller=link.name)) == "room.b3"
            for token in (building, at_once):
                token.undeclare()


def test_stop__of_another_instance_is_rejected(folder: Path) -> None:
    settings = {"plant": "zenostat.agent_sdk.testing.fake_plant:FakePlant", "name": "room"}
    with node_on_bus(folder, **settings) as (_, bus), bus.controller("room") as link:
        link.reset()
        branch = bus.branch("room", CreateBranch(controller=link.name))
        for name in ("room", branch):
            with pytest.raises(RequestRejected, match=f"this node '{name}' has the instance"):
                bus.stop(name, instance="another")
        link.send()
        assert link.receive().step == 1
        bus.stop(branch, instance=link.manifest.instance)
        until(lambda: bus.nodes() == ["room"], "the branch has ended")
