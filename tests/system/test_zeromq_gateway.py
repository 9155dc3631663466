"""The ZeroMQ gateway: a real node, the gateway and controllers each as a process, pyzmq at the other end."""

import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import psutil
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from support.examples import examples
from support.nodes import SMALL, NodeProgram, Program, until
from support.run_cli import plain, run_program

import zenostat
from zenostat.topics import codec, messages
from zenostat.topics.messages import Event, EventKind, Manifest, Sample, State

zmq = pytest.importorskip("zmq", reason="pyzmq is not installed")

from support.zeromq import ANY, KILLED, GatewayProgram, Peer, answering, gateway, keeping, module_gateway  # noqa: E402

from zenostat.gateways.zeromq.frames import split  # noqa: E402
from zenostat.gateways.zeromq.sockets import check_endpoint  # noqa: E402

__all__ = ["gateway", "module_gateway"]

EXAMPLES = Path(__file__).parents[2] / "examples"
SETPOINT = "core_zn_cooling_setpoint"


@pytest.fixture
def own_gateway(node: NodeProgram) -> Iterator[GatewayProgram]:
    """The gateway of a node of the test's own."""
    with GatewayProgram(node.endpoint) as program:
        yield program


def plan(manifest: Manifest, step: int) -> np.ndarray:
    """Setpoints that move each step, within their bounds: heating 18 to 20, cooling 24 to 26."""
    low = [18.0 if "heating" in actuator.name else 24.0 for actuator in manifest.actuators]
    return np.array(low) + 0.25 * (step % 9)


# Episodes


@pytest.mark.variants
@pytest.mark.parametrize("kind", ["DEALER", "REQ"])
def test_zeromq_gateway__episode_gives_the_same_samples_as_over_zenoh_to_the_bit(shared_node, gateway, kind):
    direct = []
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus, bus.controller("office") as link:
        for sample in link:
            direct.append((sample.message.values, sample.message.effective, sample.message.time))
            sample.send(plan(link.manifest, sample.step))
    through = []
    with Peer(gateway, getattr(zmq, kind)) as peer:
        peer.listen("sample")
        until(lambda: not any(c.state.is_connected for c in agent_status(shared_node).controllers), "it has gone")
        while (last := peer.hear(Sample)).step != [96]:
            pass  # the gateway hears by itself
        manifest = Manifest(**peer.ask("manifest")[1])
        assert peer.ask("rpc/claim/c", controller="c")[0] == "Ack"
        (episode,) = peer.ask("rpc/reset/c", controller="c")[1]["episode"]
        assert episode == last.episode[0] + 1
        sample = peer.after(last)
        while True:
            through.append((sample.values, sample.effective, sample.time))
            if sample.flags[0] & messages.Flag.TRUNCATED:
                break
            command = answering(sample, plan(manifest, sample.step[0]))
            assert peer.ask("command/c", **command) == ("Ack", peer_accepted(episode, sample.step))
            sample = peer.after(sample)
    assert len(through) == 97
    assert through == direct


def peer_accepted(episode: int, step: Sequence[int] = ()) -> dict[str, Any]:
    return msgpack.unpackb(codec.encode(messages.Ack(episode=[episode], step=[*step])))


def refusal(answer: tuple[str, dict[str, Any]], error: str = "RequestRejected") -> str:
    """Return the message of a reply that refuses a request with that error."""
    kind, denied = answer
    assert (kind, denied["error"]) == ("ErrorReply", error)
    return denied["message"]


def test_zeromq_gateway__two_controllers_in_lockstep_each_answered_although_the_other_has_not_spoken(gateway):
    with Peer(gateway) as one, Peer(gateway, zmq.REQ) as two:
        sample = one.first_sample()
        names = [a["name"] for a in one.ask("manifest")[1]["actuators"]]
        before = messages.Status(**one.ask("rpc/status")[1])
        for peer, name, mine in ((one, "one", names[::2]), (two, "two", names[1::2])):
            assert peer.ask(f"rpc/claim/{name}", controller=name, actuators=mine)[0] == "Ack"
        for step in range(20):
            first, second = ((one, "one"), (two, "two"))[:: 1 if step % 2 else -1]
            for peer, name in (first, second):
                assert one.ask("sample")[1]["step"] == [step] if peer is one else True
                assert peer.ask(f"command/{name}", **keeping(sample))[0] == "Ack"
            sample = one.after(sample)
            assert sample.step == [step + 1]
        status = messages.Status(**one.ask("rpc/status")[1])
        assert {c.controller: c.accepted for c in status.controllers} == {"one": 20, "two": 20}
        assert (status.rejected, status.late, status.duplicate) == (before.rejected, before.late, before.duplicate)


def test_zeromq_gateway__commands_sent_without_waiting_are_answered_in_order(gateway):
    with Peer(gateway) as peer:
        sample = peer.first_sample()
        peer.say("rpc/claim/c", controller="c")
        peer.say("command/c", **keeping(sample))
        peer.say("command/c", **keeping(sample))  # again
        peer.say("command/c", **keeping(sample, step=[1]))
        peer.say("command/c", **keeping(sample, step=[9]))
        answers = [peer.answer() for _ in range(5)]
    assert [kind for kind, _ in answers] == ["Ack", "Ack", "ErrorReply", "Ack", "ErrorReply"]
    assert "the current ones are episode" in answers[2][1]["message"]
    assert f"answers episode {sample.episode} step [9]" in answers[4][1]["message"]


@pytest.mark.slow
def test_zeromq_gateway__command_to_a_node_that_runs_freely(scratch):
    with (
        NodeProgram(scratch / "node", **{**SMALL, "mode": "free", "begin": "01-01", "end": "12-31"}) as node,
        GatewayProgram(node.endpoint) as gateway,
        Peer(gateway) as peer,
    ):
        peer.listen("sample")
        assert peer.ask("rpc/claim/c", controller="c") == ("Ack", peer_accepted(0))
        kinds = [peer.ask("command/c", **keeping(peer.hear(Sample)))[0] for _ in range(20)]
        status = messages.Status(**peer.ask("rpc/status")[1])
    assert set(kinds) <= {"Ack", "ErrorReply"}
    (controller,) = status.controllers
    assert controller.accepted == kinds.count("Ack")
    assert controller.accepted + status.late + status.duplicate + status.rejected == 20


# Answers


def test_refusals__carry_the_reason_of_the_node(gateway):
    with Peer(gateway) as peer, Peer(gateway) as other:
        sample = peer.first_sample()
        count = len(sample.effective) // 8
        assert peer.ask("command/c", **keeping(sample))[1]["message"].startswith("'c' has claimed nothing")
        assert peer.ask("rpc/claim/c", controller="c", actuators=["chair"])[1]["error"] == "RequestRejected"
        assert peer.ask("rpc/claim/c", controller="c")[0] == "Ack"
        assert "is claimed by 'c'" in refusal(other.ask("rpc/claim/d", controller="d"))
        assert other.ask("command/c", **keeping(sample))[1]["message"].startswith(
            "'c' is connected through another connection; claim first"
        )
        for _ in range(30):  # more than the node publishes as events in a step
            assert "its bounds are" in refusal(peer.ask("command/c", **answering(sample, np.full(count, 99.0))))
        assert peer.ask("command/c", **keeping(sample))[0] == "Ack"
        assert peer.ask("rpc/weather", columns=["no such"])[1]["error"] == "UnknownName"
        assert peer.ask("rpc/scenario")[0] == "ScenarioText"


@pytest.mark.slow
def test_zeromq_gateway__writes_are_answered(gateway):
    with Peer(gateway) as peer:
        sample = peer.first_sample()
        assert peer.ask(f"actuator/panel/{SETPOINT}", value=26.5, source="panel")[0] == "Ack"
        denied = peer.ask(f"actuator/panel/{SETPOINT}", value=99.0, source="panel")[1]
        assert "its bounds are" in denied["message"]
        assert "no actuator 'chair'" in peer.ask("actuator/peer/chair", value=1.0)[1]["message"]
        peer.ask("rpc/claim/c", controller="c")
        peer.ask("command/c", **keeping(sample))
        sample = peer.after(sample)
        names = [a["name"] for a in peer.ask("manifest")[1]["actuators"]]
        assert np.frombuffer(sample.effective)[names.index(SETPOINT)] == 26.5


def test_subscriber__gets_the_latest_of_its_topics_at_once(gateway):
    with Peer(gateway) as peer, Peer(gateway) as other:
        peer.listen("sample")
        topic, encoding, payload = peer.published.recv_multipart()
        assert (topic, encoding) == (b"zenostat/v3/office/sample", b"application/msgpack;zenostat/3.Sample")
        assert msgpack.unpackb(payload)["step"] == [0]
        peer.listen("manifest")
        assert peer.hear(Manifest).node == "office"
        other.listen("event")
        until(
            lambda: other.ask("rpc/status") and other.ask("actuator/peer/x", value=1.0) and other.published.poll(0),
            "heard",
        )
        assert other.hear(Event).kind is EventKind.REJECTED


# Presence


def test_zeromq_gateway__killed_controller_is_noticed_by_the_node_and_may_come_back(shared_node, gateway):
    with Peer(gateway) as peer, Peer(gateway) as back:
        peer.listen("event")
        with Program(KILLED, gateway.command) as program:
            assert program.line().endswith(".Ack")
            with zenostat.connect(shared_node.endpoint, affinity="off") as bus:
                until(lambda: bus.controllers() == [("office", "doomed")], "its token is there")
            program.process.kill()
            assert peer.event(EventKind.DISCONNECTED).source == "doomed"
        assert back.ask("rpc/claim/doomed", controller="doomed")[0] == "Ack"
        back.listen("sample")
        assert back.ask("command/doomed", **keeping(back.after(None)))[0] == "Ack"


def test_zeromq_gateway__frozen_controller_is_gone_after_its_lease(episode_bus):
    with GatewayProgram(episode_bus.endpoint, "--lease", "0.5") as gateway, Peer(gateway) as peer:
        peer.listen("event")
        with Program(KILLED, gateway.command) as program:
            assert program.line().endswith(".Ack")
            program.process.send_signal(signal.SIGSTOP)
            assert peer.event(EventKind.DISCONNECTED).source == "doomed"


def test_zeromq_gateway__name_of_a_connected_controller_is_free_only_once_its_connection_has_ended(
    shared_node, gateway
):
    with Peer(gateway) as new, zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        sample = new.first_sample()
        with Peer(gateway) as old:
            assert old.ask("rpc/claim/c", controller="c")[0] == "Ack"
            for _ in range(2):
                denied = refusal(new.ask("rpc/claim/c", controller="c", priority=5))
                assert denied.startswith("a controller 'c' is connected already; end its connection first")
                _, denied = new.ask("command/c", **keeping(sample))
                assert denied["message"].startswith("'c' is connected through another connection; claim first")
                assert old.ask("command/c", **keeping(sample))[0] == "Ack"
                sample = new.after(sample)
                assert old.ask("rpc/claim/c", controller="c")[0] == "Ack"  # its own claim can be renewed
            assert [(each.controller, each.state) for each in bus.status("office").controllers] == [("c", "connected")]
        until(lambda: new.ask("rpc/claim/c", controller="c")[0] == "Ack", "the connection has ended")
        for _ in range(3):
            assert new.ask("command/c", **keeping(sample))[0] == "Ack"
            sample = new.after(sample)
        assert bus.controllers() == [("office", "c")]


def test_zeromq_gateway__name_of_a_controller_that_does_not_use_the_gateway_is_taken_too(shared_node, gateway):
    with Peer(gateway) as peer, zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        with bus.controller("office") as link:
            denied = refusal(peer.ask(f"rpc/claim/{link.name}", controller=link.name, actuators=[SETPOINT]))
            assert denied.startswith(f"a controller {link.name!r} is connected already")
            link.current()
            link.send(None)
            assert link.receive().step == 1
        until(lambda: peer.ask(f"rpc/claim/{link.name}", controller=link.name)[0] == "Ack", "it has left")


def _is_stopped(pid: int) -> bool:
    """Whether each thread of a process has stopped."""
    states = [(task / "stat").read_text().rpartition(")")[2].split()[0] for task in Path(f"/proc/{pid}/task").iterdir()]
    return set(states) == {"T"}


@pytest.mark.slow
def test_peer_with_too_many_unanswered_requests__gets_an_error_and_delays_no_other(node, own_gateway):
    """frozen node: 100 of 300 requests wait for it, the others are rejected → the node goes on: all are answered"""
    with Peer(own_gateway) as flood, Peer(own_gateway) as peer:
        assert flood.ask("rpc/status")[0] == peer.ask("rpc/status")[0] == "Status"
        psutil.Process(node.pid).send_signal(signal.SIGSTOP)
        try:
            until(lambda: _is_stopped(node.pid), "the node is frozen")
            for _ in range(300):
                flood.say("rpc/status")
            for _ in range(200):
                assert refusal(flood.answer()).startswith("100 requests of this connection are not answered yet")
            peer.say("rpc/status")
            assert peer.silent()
        finally:
            psutil.Process(node.pid).send_signal(signal.SIGCONT)
        assert peer.answer()[0] == "Status"
        assert [flood.answer()[0] for _ in range(100)] == ["Status"] * 100
        assert flood.ask("rpc/status")[0] == "Status"


@pytest.mark.slow
def test_zeromq_gateway__killed_gateway_breaks_nothing_of_the_node(episode_bus):
    with GatewayProgram(episode_bus.endpoint) as gateway, Peer(gateway) as peer:
        peer.listen("sample")
        assert peer.ask("rpc/claim/c", controller="c")[0] == "Ack"
        assert peer.ask("command/c", **keeping(peer.after(None)))[0] == "Ack"
        gateway.process.kill()
        gateway.process.wait()
        missed = ["disconnected"]
        until(lambda: [c.state for c in episode_bus.status("office").controllers] == missed, "the node misses it")
    with episode_bus.controller("office") as link:
        assert [sample.step for sample in link][-1] == 96


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("end", ["killed", "stopped"])
def test_end_of_the_node__published_and_answered(scratch, node, own_gateway, end):
    gateway = own_gateway
    with Peer(gateway) as peer, Peer(gateway) as waiting, Peer(gateway) as slow:
        sample = peer.first_sample()
        peer.published.unsubscribe(f"{peer.root}/sample")
        peer.listen("event")
        for one, name, mine in ((waiting, "waiting", [SETPOINT]), (slow, "slow", ["core_zn_heating_setpoint"])):
            assert one.ask(f"rpc/claim/{name}", controller=name, actuators=mine)[0] == "Ack"
        assert waiting.ask("command/waiting", **keeping(sample))[0] == "Ack"
        if end == "killed":
            psutil.Process(node.pid).send_signal(signal.SIGSTOP)
            slow.say("command/slow", **keeping(sample))
            slow.say("rpc/reset/peer")
            assert slow.ask("rpc/sing")[0] == "ErrorReply", "the gateway has taken both"
            node.kill()
            errors = sorted(slow.answer()[1]["error"] for _ in range(2))
            assert errors == ["NodeLost", "NodeLost"]
            event = peer.event(EventKind.FAILED)
            assert (event.error, event.text) == ("NodeLost", "node 'office' is gone")
        else:
            assert peer.ask("rpc/stop/peer")[0] == "Ack"
            assert peer.event(EventKind.STOPPED)
            until(lambda: peer.ask("rpc/status")[0] == "ErrorReply", "it is gone")
        assert refusal(peer.ask("command/slow", **keeping(sample)), "NodeNotFound")


def test_zeromq_gateway__failure_of_the_engine_is_an_event_after_the_command_was_accepted(shared_node, gateway):
    """stopped engine → the command is accepted, although its timestep never ends → killed engine → event, reset"""
    with Peer(gateway) as peer, Peer(gateway) as watcher:
        sample = peer.first_sample()
        watcher.listen("event")
        watcher.listen("manifest")
        watcher.hear(Manifest)  # the gateway knows of both subscriptions
        peer.ask("rpc/claim/c", controller="c")
        shared_node.engine.send_signal(signal.SIGSTOP)
        assert peer.ask("command/c", **keeping(sample))[0] == "Ack"
        until(lambda: agent_status(shared_node).state is State.RUNNING, "the node computes")
        shared_node.engine.kill()
        assert watcher.event(EventKind.FAILED).error == "EngineDied"
        failed = {"error": "RequestRejected", "message": "the node is failed"}
        assert peer.ask("command/c", **keeping(sample)) == ("ErrorReply", failed)
        assert peer.ask("rpc/reset/peer")[0] == "Ack"
        assert peer.ask("command/c", **keeping(peer.after(sample)))[0] == "Ack"


def agent_status(node: NodeProgram) -> messages.Status:
    with zenostat.connect(node.endpoint, affinity="off") as bus:
        return bus.status(node.name)


# Bad input


@pytest.fixture(scope="module")
def open_gateway(shared_node: NodeProgram) -> Iterator[Peer]:
    with GatewayProgram(shared_node.endpoint, "--node", "office") as gateway, Peer(gateway) as peer:
        yield peer


BAD = {
    "office": "zenostat/v3/NODE/… expected",
    "zenostat/v2/office/rpc/status": "zenostat/v3/NODE/… expected",
    "zenostat/v3/*/rpc/status": "is not valid in a topic",
    "zenostat/v3/**": "zenostat/v3/NODE/… expected",
    "zenostat/v3/office/command/*": "is not valid in a topic",
    "zenostat/v3/office/command/": "is not valid in a topic",
    "zenostat/v3/office/command/a/b": "is not valid in a topic",
    "zenostat/v3/office/@live/controller/x": "no request '@live/controller/x'",
    "zenostat/v3/office/actuator/panel": "is not valid in a topic",
    "zenostat/v3/office/actuator/panel/a/b": "is not valid in a topic",
    "zenostat/v3/office/rpc/claim": "no request 'rpc/claim'",
    "zenostat/v3/office/sensor/x": "no request 'sensor/x'",
    "zenostat/v3/office/event": "no request 'event'",
    "zenostat/v3/office/wake": "no request 'wake'",
    "zenostat/v3/office/rpc/sing": "no request 'rpc/sing'",
    "zenostat/v3/plant/rpc/status": "for node 'office' alone",
}


@pytest.mark.parametrize("topic", BAD)
def test_zeromq_gateway__bad_topics_are_denied_by_name(open_gateway, topic):
    open_gateway.requests.send_multipart([topic.encode(), msgpack.packb({})])
    echoed, _, payload = open_gateway.requests.recv_multipart()
    assert echoed.decode() == topic
    assert BAD[topic] in msgpack.unpackb(payload)["message"]


@pytest.mark.parametrize(
    ("what", "payload", "words"),
    [
        ("rpc/try/c", b"", "alternatives: it is missing"),
        ("rpc/claim/c", msgpack.packb([]), "a Claim should be a map"),
        ("rpc/claim/c", msgpack.packb({"controller": "a/b"}), "controller"),
        ("command/c", b"\xc1", "not msgpack"),
        ("command/c", msgpack.packb({"episode": [0]}), "step: it is missing"),
        ("actuator/peer/x", msgpack.packb({"value": float("nan")}), "value"),
        ("manifest", msgpack.packb({"x": 1}), "x: there is no such field"),
        ("rpc/status", b"\x00" * (codec.MAX_BYTES + 1), "at most 8388608"),
    ],
)
def test_zeromq_gateway__bad_payloads_are_denied_with_the_reason(open_gateway, what, payload, words):
    assert words in refusal(open_gateway.ask(what, payload), "BadMessage")


WORDS = st.sampled_from([b"", b"zenostat/v3/office/rpc/status", b"zenostat/v3/office/command/c", b"\x80", b"\xff"])


@settings(max_examples=examples(200), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(frames=st.lists(st.one_of(WORDS, st.binary(max_size=40)), min_size=1, max_size=12))
@example([b""])
@example([b"", b""])
@example([b"", b"", b"", b"", b""])
def test_any_frames__have_one_answer(open_gateway, frames):
    requests = open_gateway.requests
    requests.send_multipart(frames)
    answer = requests.recv_multipart()
    peer, rest = split([b"route", *frames], 0)
    assert answer[:-3] == list(peer.envelope)
    assert answer[-3] == rest[0][:256]
    kind = answer[-2].decode().rpartition(".")[2]
    sound = len(rest) <= 2 and rest[0].endswith(b"rpc/status") and rest[1:] in ([], [b""], [b"\x80"])
    assert kind == ("Status" if sound else "ErrorReply")
    assert open_gateway.silent()


def test_zeromq_gateway__envelope_returns_as_it_was():
    assert split([b"r", b"", b"t", b"p"], 3)[0].envelope == (b"",)
    peer, rest = split([b"r", b"1", b"2", b"", b"t", b"p"], 3)
    assert (peer.route, peer.envelope, list(rest)) == (b"r", (b"1", b"2", b""), [b"t", b"p"])
    assert list(split([b"r", b"t", b""], 3)[1]) == [b"t", b""]


# The command line


def _fails(*options: str) -> str:
    done = run_program("gateway", "zeromq", *options)
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr
    return plain(done.stderr)


@pytest.mark.slow
def test_zeromq_gateway__port_in_use_is_named(shared_node, gateway):
    at = ("--connect", shared_node.endpoint)
    assert "another program listens on" in _fails(*at, "--publish", gateway.publish)
    assert "another program listens on" in _fails(*at, "--command", gateway.command, "--publish", ANY)
    assert "another program listens on" in _fails(*at, "--publish", gateway.publish.replace("127.0.0.1", "localhost"))
    assert check_endpoint("tcp://[::1]:5556", expose=False) == "tcp://[::1]:5556"


@pytest.mark.slow
def test_zeromq_gateway__ctrl_c_ends_it_in_good_order(shared_node):
    with GatewayProgram(shared_node.endpoint) as gateway, Peer(gateway) as peer:
        assert peer.ask("rpc/status")[0] == "Status"
        assert peer.ask("rpc/sing")[0] == "ErrorReply"
        code, out, err = gateway.interrupt()
    assert (code, err) == (0, "")
    assert out.endswith("0 samples, 2 requests, 1 of them rejected\n")


# Examples


def example_command(gateway: GatewayProgram) -> list[str]:
    at = ["--publish", gateway.publish, "--command", gateway.command]
    return [sys.executable, str(EXAMPLES / "zeromq_controller.py"), *at]


def test_zeromq_gateway__python_example(gateway):
    done = subprocess.run(example_command(gateway), capture_output=True, text=True, timeout=90)
    assert (done.stdout, done.stderr) == ("96 timesteps to 2017-07-04T00:00:00\n", "")


def test_zeromq_gateway__python_example_ends_with_the_reason_when_the_engine_dies(shared_node, gateway):
    shared_node.engine.send_signal(signal.SIGSTOP)
    with subprocess.Popen(
        example_command(gateway), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as program:
        until(lambda: agent_status(shared_node).state is State.RUNNING, "the node computes")
        shared_node.engine.kill()
        out, err = program.communicate(timeout=90)
    assert (program.returncode, out) == (1, "")
    assert err == "the engine process was killed by SIGKILL after sample 0; it printed no error\n"


def test_zeromq_gateway__c_example(gateway, scratch):
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("there is no C compiler; on Debian: apt install gcc libc6-dev")
    program = scratch / "controller"
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-o", str(program)]
    source = EXAMPLES / "zeromq_controller.c"
    build = subprocess.run([compiler, *options, str(source), "-lzmq"], capture_output=True, text=True)
    if "zmq.h" in build.stderr and "No such file" in build.stderr:
        pytest.skip("libzmq's header is not installed; on Debian: apt install libzmq3-dev")
    assert build.returncode == 0, build.stderr
    done = subprocess.run([program, gateway.publish, gateway.command], capture_output=True, text=True, timeout=90)
    assert (done.stdout, done.stderr) == ("96 timesteps to 2017-07-04T00:00:00\n", "")
    assert setpoint_and_source(gateway) == (26.0, "from-c")


def test_zeromq_gateway__javascript_example(gateway):
    node = shutil.which("node")
    if node is None:
        pytest.skip("Node.js is not installed; on Debian: apt install nodejs")
    done = subprocess.run(
        [node, EXAMPLES / "zeromq_controller.js", gateway.publish, gateway.command],
        capture_output=True,
        text=True,
        timeout=90,
    )
    last = f"96 timesteps to 2017-07-04T00:00:00, {SETPOINT} by from-javascript\n"
    assert (done.stdout, done.stderr) == (last, "")
    assert setpoint_and_source(gateway) == (26.0, "from-javascript")


def setpoint_and_source(gateway: GatewayProgram) -> tuple[float, str]:
    """Return the effective setpoint of the latest sample, and the name that the node has for who set it."""
    with Peer(gateway) as peer:
        peer.listen("sample")
        sample = peer.hear(Sample)
        names = [a["name"] for a in peer.ask("manifest")[1]["actuators"]]
    index = names.index(SETPOINT)
    return np.frombuffer(sample.effective)[index], sample.sources[np.frombuffer(sample.source_index, "<u2")[index]]
