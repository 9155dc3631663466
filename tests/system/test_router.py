"""A router between nodes and controllers: on one machine, and between machines that cannot reach each other.

The machines are network namespaces of Linux: a node's, a controller's and the router's between them, which forwards
no packets. Where they may not be made, those tests are skipped, with the reason.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import sleep
from typing import Any

import pytest
from support.events import events_of, next_event
from support.nodes import SMALL, NodeProgram, free_port, node_on_bus, until
from support.run_cli import ZENOSTAT, run_program

import zenostat
from zenostat.bridge.node.names import SETTLE_S
from zenostat.bridge.transport.certificates import add, make
from zenostat.bridge.transport.session import Mode, open_session
from zenostat.eplus_node.config import read_config
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, NameInUse
from zenostat.topics.keys import Role
from zenostat.topics.messages import Claim, EventKind

CONTROLLER = """
import json, sys
from pathlib import Path
import zenostat
from zenostat.topics.errors import NodeLost


def say(**what):
    print(json.dumps(what), flush=True)


keys = Path(sys.argv[2]) if sys.argv[2:] else None
with zenostat.connect(sys.argv[1], keys=keys, certificate=keys and "trainer", affinity="off") as bus:
    say(nodes=bus.nodes())
    say(state=bus.status("office").state, step=bus.latest("office").step)
    with bus.controller("office", name="far") as link:
        sample, heard, values = link.reset(), 1, []
        say(controllers=bus.controllers(), name=link.name)
        while not sample.truncated:
            sample.send({"core_zn_cooling_setpoint": 25.0})
            sample = link.receive()
            heard += 1
            values.append(sample["core_zn_air_temperature"])
        say(heard=heard, step=sample.step, accepted=bus.status("office").accepted, values=values)
        try:
            link.receive()
        except NodeLost as error:
            say(lost=str(error), nodes=bus.nodes())
"""


@dataclass(frozen=True)
class Place:
    """Endpoints of a router for nodes and for controllers, and arguments of a program at either side."""

    to_nodes: str
    to_controllers: str
    keys: Path | None = None
    at_router: tuple[str, ...] = ()
    at_node: tuple[str, ...] = ()
    at_controller: tuple[str, ...] = ()

    @property
    def listen(self) -> list[str]:
        return list(dict.fromkeys((self.to_nodes, self.to_controllers)))


class FarNode(NodeProgram):
    """A node that only connects, perhaps in a namespace of its own."""

    def __init__(self, folder: Path, place: Place, **settings: Any) -> None:
        arguments: dict[str, Any] = {"listen": [], "connect": [place.to_nodes], **SMALL, **settings}
        if place.keys:
            arguments["keys"] = str(place.keys)
        super().__init__(folder, before=place.at_node, **arguments)
        self.endpoint = place.to_controllers


@contextmanager
def router(place: Place, *options: str) -> Iterator[subprocess.Popen[str]]:
    """A router as a program; it must end in good order."""
    words = [word for endpoint in place.listen for word in ("--listen", endpoint)]
    words += ["--keys", str(place.keys), "--certificate", "router"] if place.keys else []
    process = subprocess.Popen(
        [*place.at_router, *ZENOSTAT, "router", *words, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        line = process.stdout.readline()
        assert line.startswith("router on"), process.communicate()[1]
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.stdout.close()
        process.stderr.close()
        ended = process.wait()
    assert ended == 0


def router_keys(folder: Path, hosts: Sequence[str] = ()) -> Path:
    make(folder / "keys")
    add(folder / "keys", Role.NODE, "router", hosts=hosts)
    return folder / "keys"


def ip(*words: str) -> None:
    done = subprocess.run(["ip", *words], capture_output=True, text=True)
    if done.returncode:
        raise OSError(f"ip {' '.join(words)}: {done.stderr.strip()}")


@contextmanager
def machines() -> Iterator[dict[str, tuple[str, ...]]]:
    """Three namespaces: `node` at 10.77.1.2, `controller` at 10.77.2.2, `router` at 10.77.1.1 and 10.77.2.1."""
    names = {side: f"zt{os.getpid()}{side[0]}" for side in ("router", "node", "controller")}
    with ExitStack() as stack:
        for name in names.values():
            ip("netns", "add", name)
            stack.callback(ip, "netns", "del", name)
            ip("-n", name, "link", "set", "lo", "up")
        for net, side in ((1, "node"), (2, "controller")):
            ends = (f"zt{net}a", f"zt{net}b")
            ip(
                "-n",
                names["router"],
                "link",
                "add",
                ends[0],
                "type",
                "veth",
                "peer",
                "name",
                ends[1],
                "netns",
                names[side],
            )
            for name, end, host in ((names["router"], ends[0], 1), (names[side], ends[1], 2)):
                ip("-n", name, "addr", "add", f"10.77.{net}.{host}/24", "dev", end)
                ip("-n", name, "link", "set", end, "up")
        yield {side: ("ip", "netns", "exec", name) for side, name in names.items()}


@pytest.fixture(params=["loopback", "loopback with keys", "machines", "machines with keys"])
def place(request: pytest.FixtureRequest, folder: Path) -> Iterator[Place]:
    """A place for a router; between machines where that is permitted."""
    closed = request.param.endswith("keys")
    kind = "tls" if closed else "tcp"
    if request.param.startswith("loopback"):
        endpoint = f"{kind}/127.0.0.1:{free_port()}"
        yield Place(endpoint, endpoint, router_keys(folder) if closed else None)
        return
    with ExitStack() as stack:
        try:
            at = stack.enter_context(machines())
        except OSError as error:
            pytest.skip(f"network namespaces are not permitted here: {error}")
        yield Place(
            f"{kind}/10.77.1.1:7447",
            f"{kind}/10.77.2.1:7447",
            router_keys(folder, ["10.77.1.1", "10.77.2.1"]) if closed else None,
            at_router=at["router"],
            at_node=at["node"],
            at_controller=at["controller"],
        )


@contextmanager
def far_controller(place: Place) -> Iterator[subprocess.Popen[str]]:
    words = [place.to_controllers, *([str(place.keys)] if place.keys else [])]
    process = subprocess.Popen(
        [*place.at_controller, sys.executable, "-P", "-u", "-c", CONTROLLER, *words], stdout=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.stdout.close()
        process.wait()


@pytest.mark.slow
def test_router__day_through_a_router(place: Place, scratch: Path) -> None:
    """Presence, requests, samples, lockstep, the refusal of a second node of the name, and a node's death."""
    exposed = ["--expose"] * bool(place.at_router)
    with router(place, *exposed), FarNode(scratch / "node", place) as node, far_controller(place) as far:

        def next_line() -> dict[str, Any]:
            return json.loads(far.stdout.readline())

        assert next_line() == {"nodes": ["office"]}
        assert next_line() == {"state": "waiting", "step": [0]}
        joined = next_line()
        assert joined["controllers"] == [["office", joined["name"]]]
        day = next_line()
        assert (day["heard"], day["step"], day["accepted"]) == (97, 96, 96)
        with pytest.raises(NameInUse, match="a node named 'office' is on this bus already"):
            FarNode(scratch / "second", place)
        node.kill()
        lost = next_line()
        assert "node 'office' is gone" in lost["lost"]
        assert lost["nodes"] == []
        assert far.wait() == 0
    assert day["values"] == straight(scratch)


def straight(folder: Path) -> list[float]:
    """Day without a router."""
    with node_on_bus(folder / "straight", **SMALL) as (_, bus):
        link, values = bus.controller("office"), []
        sample = link.reset()
        while not sample.truncated:
            sample.send({"core_zn_cooling_setpoint": 25.0})
            sample = link.receive()
            values.append(sample["core_zn_air_temperature"])
        return values


def test_router__two_machines_that_only_the_router_joins(scratch: Path) -> None:
    """Without the router there is no way: the test above passes for the right reason."""
    try:
        with machines() as at:
            reach = "import socket, sys; socket.create_connection((sys.argv[1], 1), 1)"
            outputs = {
                host: subprocess.run(
                    [*at["controller"], sys.executable, "-c", reach, host], capture_output=True, text=True
                ).stderr
                for host in ("10.77.2.1", "10.77.1.2")
            }
    except OSError as error:
        pytest.skip(f"network namespaces are not permitted here: {error}")
    assert "ConnectionRefusedError" in outputs["10.77.2.1"]
    assert "Network is unreachable" in outputs["10.77.1.2"]


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("closed", [False, True], ids=["open", "closed"])
def test_router__two_routers(folder: Path, scratch: Path, closed: bool) -> None:
    """node → router → router → controller"""
    kind = "tls" if closed else "tcp"
    near, far = (f"{kind}/127.0.0.1:{free_port()}" for _ in range(2))
    pki = router_keys(folder) if closed else None
    with (
        router(Place(near, near, pki)),
        router(Place(far, far, pki), "--connect", near),
        FarNode(scratch / "node", Place(near, near, pki)),
        zenostat.connect(far, keys=pki, certificate=pki and "trainer", affinity="off") as bus,
    ):
        until(lambda: bus.nodes() == ["office"], "the routers have met")
        link = bus.controller("office")
        sample = link.reset()
        for _ in range(3):
            sample.send({"core_zn_cooling_setpoint": 25.0})
            sample = link.receive()
        assert sample.step == 3
        assert sample.value_source["core_zn_cooling_setpoint"] == link.name


@pytest.mark.slow
def test_router__end_of_a_router_costs_nothing_to_those_beside_it(scratch: Path) -> None:
    """Zenoh goes on asking the router for a while: the replies of the node itself have to be enough."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        running = stack.enter_context(ExitStack())
        running.enter_context(router(Place(endpoint, endpoint, None)))
        node = stack.enter_context(node_on_bus(scratch / "node", **SMALL, connect=[endpoint]))[0]
        bus = stack.enter_context(zenostat.connect(node.endpoint, affinity="off"))
        bus.timeout_s = 5.0
        assert bus.status("office").step == [0]
        running.close()
        asked = [bus.status("office").step for _ in range(3)]
        assert asked == [[0]] * 3


@pytest.mark.slow
def test_router__router_keeps_the_rules(folder: Path, scratch: Path) -> None:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    place = Place(endpoint, endpoint, router_keys(folder))

    def answers(role: Role, name: str) -> int:
        claim = codec.encode(Claim(controller=name, required=False))
        with open_session(connect=[endpoint], keys=place.keys, role=role) as session:
            replies = session.get(keys.CLAIM.at("office", sender=name), payload=claim, timeout=30)
            return len([reply for reply in replies if reply.ok])

    with router(place), FarNode(scratch / "node", place):
        assert answers(Role.MONITOR, "monitor") == 0
        assert answers(Role.CONTROLLER, "second") == 0
        assert answers(Role.CONTROLLER, "controller") == 1
        assert answers(Role.CONTROLLER, "controller.x") == 1


@pytest.mark.slow
def test_router__router_that_all_can_reach_without_keys_is_warned_of() -> None:
    process = subprocess.Popen(
        [*ZENOSTAT, "router", "--listen", f"tcp/0.0.0.0:{free_port()}", "--expose"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert "router on" in process.stdout.readline()
    process.send_signal(signal.SIGTERM)
    _, warned = process.communicate()
    assert process.returncode == 0
    assert "zenostat keys init" in warned


def test_router__node_needs_a_bus() -> None:
    with pytest.raises(InvalidConfig, match="name an endpoint to listen on, or one to connect to"):
        read_config({**SMALL, "listen": [], "connect": []})
    assert read_config({**SMALL, "listen": [], "connect": ["tcp/127.0.0.1:7447"]}).listen == []


@pytest.mark.slow
def test_router__command_of_a_node_that_does_not_listen() -> None:
    words = ["node", "--building", "x", "--weather", "y", "--no-listen"]
    bare = run_program(*words)
    assert bare.returncode == 2
    assert "one to connect to" in bare.stderr
    both = run_program(*words, "--listen", "tcp/127.0.0.1:1")
    assert both.returncode == 2
    assert "use one of them" in both.stderr


def test_router__nodes_of_one_name_report_each_other_once_their_buses_are_connected(scratch: Path) -> None:
    """A second node may have started under the name while a link was down; the link then comes back."""
    plant = "zenostat.agent_sdk.testing.fake_plant:FakePlant"
    endpoints = [f"tcp/127.0.0.1:{free_port()}" for _ in range(2)]
    with ExitStack() as stack:
        events, instances = [], []
        for number, endpoint in enumerate(endpoints):
            stack.enter_context(open_session(listen=[endpoint], mode=Mode.ROUTER))
            stack.enter_context(
                NodeProgram(scratch / f"{number}", plant=plant, name="room", listen=[], connect=[endpoint])
            )
            bus = stack.enter_context(zenostat.connect(endpoint, affinity="off"))
            events.append(stack.enter_context(events_of(bus, "room")))
            instances.append(bus.manifest("room").instance)
        sleep(SETTLE_S)  # before that, nodes settle which of them remains
        stack.enter_context(open_session(connect=endpoints, mode=Mode.ROUTER))
        for received, own, other in zip(events, instances, reversed(instances), strict=True):
            warning = (
                f"another node named 'room' (instance {other}) is on this bus, besides this one (instance {own}): "
                "subscribers receive the samples of both, and one of them answers a request; stop one of them"
            )
            while next_event(received, EventKind.WARNING).text != warning:  # that of the other node
                pass
