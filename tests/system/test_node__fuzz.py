"""A node among strangers that send anything, as fast as they can: it lives, and serves the others."""

import os
import random
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgpack
import pytest
import zenoh
from support.nodes import SMALL, NodeProgram, Program, node_on_bus, nothing_left, size_of, until, values_of_day
from zenoh.handlers import RingChannel

from zenostat.bridge.client.bus import Bus
from zenostat.topics import codec, keys
from zenostat.topics.messages import Event, EventKind, State

SEED = int(os.environ.get("FUZZ_SEED", "0")) or random.SystemRandom().randrange(1, 2**31)
FUZZ_S = float(os.environ.get("FUZZ_SECONDS", "8"))

FUZZER = r"""
import json, random, sys
import msgpack, zenoh
from zenoh.handlers import Callback
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec

endpoint, seed, tame, own = sys.argv[1], int(sys.argv[2]), sys.argv[3] == "tame", sys.argv[4]
draw = random.Random(seed)
root = "zenostat/v3/office"
nodes_own = ["sample", "manifest", "event", "sensor/outdoor_temperature", "wake", "nothing", "a/b/c", "@live/x"]
verbs = ["claim", "reset", "snapshot", "drop", "branch", "stop", "pace", "pause", "resume", "step", "faults", "weather"]
verbs = [f"{verb}/x" for verb in verbs] + ["claim", "weather", "write/x"]
verbs += ["command/x", "write/x/x", "write/x/core_zn_cooling_setpoint", *([] if tame else [f"command/{own}"])]
reading = ["rpc/status", "rpc/scenario", "rpc/weather", "manifest", "sample", "rpc/unknown", "command/x"]
reading += ["actuator/x/y"]
names = ["x", "é", "名", "with space", "-", "a" * 3000, "'quoted'", "..", "%2F", "\t", "@at", "~"]
points = ["core_zn_cooling_setpoint", "core_zn_heating_setpoint", "core_zn_coling_setpoint"]
encodings = ["", "application/msgpack", "zenoh/bytes", "application/msgpack;zenostat/1.Command", ";zenostat/",
             "application/msgpack;zenostat/3.Write", "text/plain"]


def anything(depth=0):
    kinds = [None, True, -1, 2**64 - 1, 0.5, float("nan"), -0.0, "x" * draw.randrange(300), b"\xff" * 9,
             msgpack.ExtType(4, b"x")]
    if depth < 3 and draw.random() < 0.5:
        return [anything(depth + 1) for _ in range(draw.randrange(4))]
    return draw.choice(kinds)


def payload():
    # Never valid for a request or a write: a map with a field that there is nowhere.
    kind = draw.randrange(9)
    if kind == 0:
        return draw.randbytes(draw.randrange(200))
    if kind == 1:
        return b"\x91" * draw.randrange(100_000)
    if kind == 2:
        return b"\xdd\xff\xff\xff\xff" * draw.randrange(1, 50)
    if kind == 3 and draw.random() < 0.03:
        return bytes(codec.MAX_BYTES + 1)
    if kind == 4 and draw.random() < 0.004:
        return bytes(64 * 2**20)
    if kind == 5:
        fields = {"episode": [draw.randrange(9)], "step": [10**6], "operations": None}
        fields["values"] = bytes(draw.randrange(99))
        return msgpack.packb(fields)
    fields = draw.sample(["value", "controller", "source", "priority", "speed", "steps", "seed", "faults", "step"], 3)
    return msgpack.packb({"nowhere": 0} | {name: anything() for name in fields})


def valid():
    return draw.choice([
        ("claim/fuzz", {"controller": "fuzz", "priority": draw.randrange(1, 17), "required": False}),
        ("claim/fuzz", {"controller": "fuzz", "priority": 1, "actuators": ["nowhere"]}),
        ("reset/fuzz", {}), ("snapshot/fuzz", {"controller": "fuzz"}),
        ("drop/fuzz", {"snapshot": f"s{draw.randrange(9)}"}),
        ("branch/fuzz", {"controller": "fuzz"}), ("pace/fuzz", {"mode": "free"}), ("pace/fuzz", {"mode": "lockstep"}),
        ("pace/fuzz", {"mode": "paced", "speed": 3600.0}), ("pause/fuzz", {}), ("resume/fuzz", {}),
        ("step/fuzz", {"steps": 3}),
        ("faults/fuzz", {"faults": []}), ("faults/fuzz", {"faults": [{"kind": "bias", "points": "*", "offset": 1.0}]}),
        ("weather", {"columns": ["dry_bulb_temperature"]}),
        ("write/fuzz/core_zn_cooling_setpoint", {"value": draw.choice([None, 25.0, 99.0]), "source": "fuzz"}),
        ("command/fuzz", {"episode": [draw.randrange(9)], "step": [draw.randrange(9)], "values": bytes(80)}),
    ])


def get(key, content):
    session.get(key, payload=content, encoding=zenoh.Encoding(draw.choice(encodings)) if tame else None,
                handler=Callback(lambda reply: None, indirect=False), timeout=5)


with open_session(connect=[endpoint]) as session:
    print("sends", flush=True)
    tokens, sent = [], 0
    while True:
        for _ in range(50):
            what = draw.randrange(8)
            said = zenoh.Encoding(draw.choice(encodings))
            try:
                if what == 0:
                    key = root + "/" + draw.choice(nodes_own if not tame else nodes_own[5:])
                    session.put(key, payload(), encoding=said)
                elif what == 1:
                    session.put(f"{root}/command/{draw.choice(names)}", payload(), encoding=said)
                elif what == 2:
                    key = f"{root}/actuator/{draw.choice(names)}/{draw.choice(points + names)}"
                    session.put(key, payload(), encoding=said)
                elif what == 3:
                    get(f"{root}/rpc/{draw.choice(verbs)}", payload())
                elif what == 4:
                    get(f"{root}/{draw.choice(reading)}", draw.choice([b"", payload()]))
                elif what == 5:
                    session.put(f"{root}/rpc/{draw.choice(verbs)}", payload())
                    session.delete(f"{root}/{draw.choice(['command/x', 'rpc/reset/x', 'actuator/x/' + points[0]])}")
                elif what == 6:
                    tokens.append(session.liveliness().declare_token(f"{root}/@live/controller/{draw.choice(names)}"))
                    if len(tokens) > 5:
                        tokens.pop(0).undeclare()
                elif not tame:
                    verb, fields = valid()
                    get(f"{root}/rpc/{verb}", msgpack.packb(fields))
                    write = {"value": draw.choice([None, 25.0, 24.0]), "priority": draw.randrange(1, 17)}
                    session.put(f"{root}/actuator/fuzz/{points[0]}", msgpack.packb(write))
                    session.put(f"{root}/command/{own}", payload())
                sent += 1
            except zenoh.ZError:
                pass  # no key of Zenoh's
        print(sent, flush=True)
        if sys.stdin.readline() == "":
            break
    for token in tokens:
        token.undeclare()
"""

FLOOD = """
import sys
import zenoh
from zenoh.handlers import Callback
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec, keys
kind, endpoint, own = sys.argv[1:]
point = keys.ACTUATOR.at("office", name="core_zn_cooling_setpoint", sender="flood")
what = {
    "malformed": (keys.COMMAND.at("office", sender="stranger"), b"\\xc1"),
    "duplicates": (
        keys.COMMAND.at("office", sender=own), codec.pack(episode=[0], step=[0], operations=None, values=bytes(80))
    ),
    "writes": (point, codec.pack(value=80.0)),
    "requests": (keys.PACE.at("office", sender="flood"), b"\\xc1"),
    "command requests": (
        keys.COMMAND_REQUEST.at("office", sender=own),
        codec.pack(episode=[0], step=[0], operations=None, values=bytes(80)),
    ),
    "write requests": (
        keys.WRITE_REQUEST.at("office", name="core_zn_cooling_setpoint", sender="flood"), codec.pack(value=80.0)
    ),
}
key, payload = what[kind]
with open_session(connect=[endpoint]) as session:
    for number in range(10**9):
        if kind.endswith("requests"):
            session.get(key, payload=payload, handler=Callback(lambda reply: None, indirect=False), timeout=5)
        else:
            session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        if number == 5000:
            print("floods", flush=True)
"""


def until_quiet(session: zenoh.Session) -> None:
    """Returns once nothing more comes of what a stranger has said in the node's name, which is still on its way."""
    with session.declare_subscriber(keys.stream("office"), RingChannel(1)) as stream:
        until(lambda: time.sleep(0.5) or stream.try_recv() is None, "nobody speaks in the node's name any more")


@contextmanager
def node_and_bus(folder: Path) -> Iterator[tuple[NodeProgram, Bus]]:
    print("FUZZ_SEED", SEED)  # noqa: T201  # to run a failure again
    with node_on_bus(folder / "node", **SMALL) as (node, bus):
        yield node, bus


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("seconds", [4.0, FUZZ_S])
def test_malformed_messages__change_nothing(scratch: Path, seconds: float) -> None:
    with node_and_bus(scratch) as (node, bus), bus.controller("office") as link:
        quiet = values_of_day(link)
        assert values_of_day(link) == quiet
        with bus.session.declare_subscriber(keys.EVENT.at("office"), RingChannel(100_000)) as events:
            with Program(FUZZER, node.endpoint, str(SEED), "tame", link.name) as fuzzer:
                fuzzer.line()
                warm, until_s = None, time.monotonic() + seconds
                while time.monotonic() < until_s:
                    fuzzer.tell()
                    assert values_of_day(link) == quiet
                    warm = warm or size_of(node.pid)
            published = [codec.decode(Event, e.payload.to_bytes()) for e in iter(events.try_recv, None)]
            status = bus.status("office")  # after them: what is told has been counted
            assert status.rejected > 20
            refusals = [event for event in published if event.kind is EventKind.REJECTED]
            assert any("not msgpack" in event.text for event in refusals)
            assert len(refusals) <= status.rejected
        until(lambda: size_of(node.pid)[0] <= warm[0] + 5, "descriptors are given back")
        until(lambda: size_of(node.pid)[1] <= warm[1] + 3, "threads have ended")
        assert size_of(node.pid)[2] < warm[2] + 300  # Zenoh keeps buffers of the 64 MB messages
        assert values_of_day(link) == quiet


@pytest.mark.slow
def test_valid_messages__leave_the_node_in_order(scratch: Path) -> None:
    with nothing_left(scratch), node_and_bus(scratch) as (node, bus):
        with Program(FUZZER, node.endpoint, str(SEED + 1), "wild", "fuzz") as fuzzer:
            fuzzer.line()
            until_s = time.monotonic() + FUZZ_S
            while time.monotonic() < until_s:
                fuzzer.tell()
                fuzzer.line()
                assert bus.status("office").node == "office"
        # Whoever the fuzzer was has gone; what is left of it is put right by requests, and once more after its last.
        for _ in range(2):
            for verb, fields in (
                (keys.FAULTS, {"faults": []}), (keys.RESUME, {}), (keys.PACE, {"mode": "lockstep"}), (keys.RESET, {}),
            ):  # fmt: skip
                for reply in bus.session.get(
                    verb.at("office", sender="mender"), payload=msgpack.packb(fields), timeout=60
                ):
                    assert str(reply.ok.encoding) == "application/msgpack;zenostat/3.Ack"
            until(lambda: bus.status("office").state is State.WAITING, "the node waits again")
            until_quiet(bus.session)
        taken = {controller.priority for controller in bus.status("office").controllers}  # the fuzzer's last claim
        with bus.controller("office", priority=min({2, 3} - taken)) as link:
            assert len(values_of_day(link)) == 97
    assert node.process.returncode == 0


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    "kind", ["malformed", "duplicates", "writes", "requests", "command requests", "write requests"]
)
def test_node__flood_is_bounded_and_others_are_served(scratch: Path, kind: str) -> None:
    with node_and_bus(scratch) as (node, bus), bus.controller("office") as link:
        quiet = values_of_day(link)
        before = size_of(node.pid)
        with Program(FLOOD, kind, node.endpoint, link.name) as flood:
            assert flood.line() == "floods"
            assert values_of_day(link) == quiet
            status = bus.status("office")
            assert status.statistics.rate_limited > 0
        # In each of 97 steps 100 of the controller and 100 of strangers; others are bounded by their queue.
        if kind in ("malformed", "duplicates"):
            assert status.rejected + status.late + status.duplicate <= 2 * 97 * 100
        assert size_of(node.pid)[2] < before[2] + 100
        assert values_of_day(link) == quiet
    assert node.process.returncode == 0
