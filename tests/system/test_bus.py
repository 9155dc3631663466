"""The bus with strangers and several controllers on it: real nodes, real Zenoh, processes of their own."""

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from support.events import events_of, next_event
from support.nodes import SMALL, NodeProgram, Program, node_on_bus, until

import zenostat
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.transport.session import MAX_MESSAGE_BYTES
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, NodeNotFound, RequestRejected
from zenostat.topics.messages import Claim, EventKind, Reset, State

DAY = {**SMALL, "name": "office"}

STRANGER = """
import json, struct, sys
import msgpack, zenoh

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
root = "zenostat/v3/office"


def say(**what):
    print(json.dumps(what), flush=True)


def unpacked(message):
    return msgpack.unpackb(message.payload.to_bytes())


with zenoh.open(config) as session:
    manifest = unpacked(next(iter(session.get(root + "/manifest"))).ok)
    say(manifest=manifest, ours=[m for m in sys.modules if m.startswith("zenostat")])
    points = [session.declare_subscriber(f"{root}/sensor/{s['name']}") for s in manifest["sensors"]]
    points += [session.declare_subscriber(f"{root}/meter/{m['name']}") for m in manifest["meters"]]
    samples = session.declare_subscriber(root + "/sample")
    events = session.declare_subscriber(root + "/event")
    which = [a["name"] for a in manifest["actuators"]].index("core_zn_cooling_setpoint")
    for written in (26.0, None):
        payload = msgpack.packb({"value": written})
        session.put(root + "/actuator/panel/core_zn_cooling_setpoint", payload)
        while (event := unpacked(events.recv()))["kind"] != "written":
            pass
        say(written=event["text"])
        sample = unpacked(samples.recv())
        effective = struct.unpack(f"<{len(manifest['actuators'])}d", sample["effective"])[which]
        source = sample["sources"][struct.unpack_from("<H", sample["source_index"], 2 * which)[0]]
        values = {str(m.key_expr): unpacked(m) for m in (point.recv() for point in points)}
        say(step=sample["step"], effective=effective, source=source, values=values)
"""

TAKES_THREE_STEPS = """
import sys
import zenostat
with zenostat.connect(sys.argv[1], affinity="off") as bus, bus.controller("office", name="first") as link:
    for sample in link:
        if sample.step == 3:
            print(link.name, flush=True)
            sys.stdin.readline()
        sample.send()
"""

LISTENS_TO_ALL = """
import sys
import zenoh
from zenostat.bridge.transport.session import open_session
with open_session(connect=[sys.argv[1]]) as session:
    with session.declare_subscriber("zenostat/**") as subscriber:
        next(iter(session.get("zenostat/v3/office/manifest")))
        print("listens", flush=True)
        while True:
            subscriber.recv()
            print("heard", flush=True)
            sys.stdin.readline()
"""


@pytest.fixture(scope="module")
def endpoint(module_folder: Path) -> Iterator[str]:
    """Endpoint of a node named `office`, which these tests share; each begins an episode of its own."""
    with NodeProgram(module_folder / "shared", **DAY) as node:
        yield node.endpoint


@pytest.fixture
def bus(endpoint: str) -> Iterator[zenostat.Bus]:
    with zenostat.connect(endpoint, affinity="off") as connected:
        yield connected


@pytest.fixture
def second_bus(endpoint: str) -> Iterator[zenostat.Bus]:
    with zenostat.connect(endpoint, affinity="off") as connected:
        yield connected


# Strangers


def test_bus__stranger_reads_and_writes_with_msgpack_alone(endpoint: str, bus: zenostat.Bus) -> None:
    """stranger joins late: manifest → subscribes → writes → node@1 → releases → node@2"""
    with bus.controller("office") as link, Program(STRANGER, endpoint, options=("-I",)) as stranger:
        sample = link.reset()
        hello = stranger.json()
        assert hello["ours"] == []
        assert hello["manifest"] == codec.msgpack.unpackb(codec.encode(link.manifest))
        place = list(link.manifest.actuators).index(
            next(a for a in link.manifest.actuators if a.name == "core_zn_cooling_setpoint")
        )
        for text, source_index in (
            ("core_zn_cooling_setpoint = 26 degC at priority 8", "panel"),
            ("core_zn_cooling_setpoint relinquished at priority 8", ""),
        ):
            assert stranger.json() == {"written": text}
            sample.send()
            sample = link.receive()
            seen = stranger.json()
            assert seen["step"] == [sample.step]
            assert seen["effective"] == sample.effective[place]
            assert (seen["effective"] == 26.0) == (source_index == "panel")
            assert seen["source"] == source_index == sample.value_source["core_zn_cooling_setpoint"]
            _check_points(seen["values"], sample)
        assert stranger.end()[0] == 0


def _check_points(values: dict[str, dict[str, object]], sample: SampleView) -> None:
    """Each point came under its own key, equal to the sample to the bit."""
    manifest = sample.manifest
    points = {f"zenostat/v3/office/sensor/{s.name}": s for s in manifest.sensors}
    points |= {f"zenostat/v3/office/meter/{m.name}": m for m in manifest.meters}
    assert set(values) == set(points)
    for key, point in points.items():
        assert values[key] == {
            "value": sample[point.name],
            "unit": point.unit,
            "episode": sample.episode,
            "step": sample.step,
            "time": sample.time.isoformat(),
        }


def test_bus__strangers_faulty_write_changes_nothing_and_is_named(bus: zenostat.Bus) -> None:
    with bus.controller("office") as link, events_of(bus) as events:
        sample = link.reset()
        rejected = bus.status("office").rejected
        writes = {
            "core_zn_cooling_setpoint": codec.pack(value=80.0),
            "core_zn_coling_setpoint": codec.pack(value=25.0),
            "core_zn_heating_setpoint": b"\xc1 not msgpack",
        }
        expected = {
            "core_zn_cooling_setpoint": "core_zn_cooling_setpoint = 80; its bounds are 22.5 to 30 degC",
            "core_zn_coling_setpoint": "no actuator 'core_zn_coling_setpoint'; did you mean 'core_zn_cooling_setpoint'",
            "core_zn_heating_setpoint": "core_zn_heating_setpoint: not msgpack",
        }
        for name, payload in writes.items():
            bus.session.put(keys.ACTUATOR.at("office", name=name, sender="panel"), payload)
            assert expected[name] in next_event(events, EventKind.REJECTED).text
        sample.send()
        after = link.receive()
        assert set(after.value_source.values()) == {""}
        assert after.message.rejected == rejected + 3


def test_bus__message_that_is_too_large_is_refused_by_name_and_a_larger_one_not_taken_in(bus: zenostat.Bus) -> None:
    with events_of(bus) as events:
        before = bus.status("office").rejected
        key = keys.COMMAND.at("office", sender="huge")
        for size in (MAX_MESSAGE_BYTES + 1, MAX_MESSAGE_BYTES // 2):
            bus.session.put(key, bytes(size), congestion_control=zenoh.CongestionControl.BLOCK)
        assert f"at most {codec.MAX_BYTES}" in next_event(events, EventKind.REJECTED).text
        assert bus.status("office").rejected == before + 1


# Several controllers


def test_bus__two_controllers_are_both_waited_for(bus: zenostat.Bus, second_bus: zenostat.Bus) -> None:
    """core@0 → (node waits) → rest@0 → node@1"""
    names = [a.name for a in bus.manifest("office").actuators]
    half = len(names) // 2
    with (
        bus.controller("office", name="core", actuators=names[:half]) as core,
        second_bus.controller("office", name="rest", actuators=names[half:]) as rest,
    ):
        ours = core.reset()
        theirs = rest.current()
        assert (ours.step, theirs.step) == (0, 0)
        for step in range(3):
            accepted = bus.status("office").accepted
            value = {True: 20.0 + step, False: 25.0 + step}
            core.send({name: value["heating" in name] for name in names[:half]})
            until(lambda before=accepted: bus.status("office").accepted == before + 1, "the node has the one command")
            # A request goes through the node's own loop: had it gone on, it would be at the next step now.
            with pytest.raises(RequestRejected, match=f"priority 10 of {names[0]!r} is claimed by '{core.name}'"):
                bus.claim("office", Claim(controller="third", actuators=names[:1]))
            status = bus.status("office")
            assert (status.state, status.step) == (State.WAITING, [step])
            rest.send({name: value["heating" in name] for name in names[half:]})
            ours, theirs = core.receive(), rest.receive()
            assert (ours.step, theirs.step) == (step + 1, step + 1)
            assert ours.message == theirs.message
            assert list(ours.value_source.values()) == [core.name] * half + [rest.name] * (len(names) - half)
            assert ours.effective.tolist() == [value["heating" in name] for name in names]


def test_bus__higher_level_rules_until_it_is_released(bus: zenostat.Bus, second_bus: zenostat.Bus) -> None:
    with (
        bus.controller("office", name="usual") as usual,
        second_bus.controller("office", name="urgent", priority=2, required=False) as urgent,
    ):
        sample = usual.reset()
        urgent.current()
        sources = []
        for command in ({"core_zn_cooling_setpoint": 29.0}, {"core_zn_cooling_setpoint": None}):
            accepted = bus.status("office").accepted
            urgent.send(command)
            until(lambda before=accepted: bus.status("office").accepted == before + 1, "the node has it")
            usual.send({"core_zn_cooling_setpoint": 24.0})
            sample, _ = usual.receive(), urgent.receive()
            index = [a.name for a in usual.manifest.actuators].index("core_zn_cooling_setpoint")
            sources.append((sample.value_source["core_zn_cooling_setpoint"], sample.effective[index]))
        assert sources == [(urgent.name, 29.0), (usual.name, 24.0)]


def test_bus__second_claim_of_a_level_names_the_holder(bus: zenostat.Bus, second_bus: zenostat.Bus) -> None:
    until(lambda: bus.controllers() == [], "those of other tests have gone")
    with bus.controller("office", name="holder") as holder:
        with pytest.raises(
            RequestRejected, match=f"priority 10 of .* is claimed by '{holder.name}'; claim another priority"
        ):
            second_bus.controller("office", name="late")
        with pytest.raises(RequestRejected, match=f"'{holder.name}' is a controller of this connection"):
            bus.controller("office", name="again")
        until(lambda: bus.controllers() == [("office", holder.name)], "the holder alone is there")
        with second_bus.controller("office", name="late", priority=11) as late:
            both = sorted([("office", holder.name), ("office", late.name)])
            until(lambda: bus.controllers() == both, "both are there")
    with pytest.raises(RequestRejected, match="no actuator 'core_zn_heating'; did you mean 'core_zn_heating_setpoint'"):
        bus.controller("office", actuators=["core_zn_heating"])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"priority": 17}, "priority"),
        ({"actuators": "core_zn_cooling_setpoint"}, "actuators"),
        ({"name": None}, "None"),
        ({"name": "x" * 125}, r"use up to 1[12]\d characters, since '-\d+-\d+' is added to it"),
    ],
)
def test_bus__claim_that_is_not_valid_is_described(bus: zenostat.Bus, arguments: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        bus.controller("office", **arguments)


def test_bus__reset_that_names_a_slot_twice_is_refused(bus: zenostat.Bus) -> None:
    episode = bus.status("office").episode
    with pytest.raises(RequestRejected, match=r"slots \[0, 0\] name a slot twice"):
        bus.reset("office", Reset(slots=[0, 0], seed=[5, 6]))
    assert bus.status("office").episode == episode


def test_bus__nodes_controllers_and_status(bus: zenostat.Bus) -> None:
    assert bus.nodes() == ["office"]
    until(lambda: bus.controllers() == [], "those of other tests have gone")
    with bus.controller("office", name="one") as link:
        sample = link.reset()
        until(lambda: bus.controllers() == [("office", link.name)], "the controller is there")
        sample.send({"core_zn_cooling_setpoint": 25.0})
        sample = link.receive()
        status = bus.status("office")
        assert (status.node, status.building, status.weather) == ("office", SMALL["building"], SMALL["weather"])
        assert (status.state, status.step, status.steps) == (State.WAITING, [1], 96)
        assert status.episode == [sample.episode]
        assert status.time == [sample.time.isoformat()]
        (controller,) = [c for c in status.controllers if c.controller == link.name]
        assert (controller.priority, controller.actuators, controller.required) == (10, 10, True)
        assert (controller.state, controller.accepted) == ("connected", 1)
        assert status.node_rss_bytes > 0
        assert status.engine_rss_bytes > 0
        assert bus.latest("office") == sample.message
    with pytest.raises(NodeNotFound, match=r"no node 'offise' on .*; did you mean 'office'"):
        bus.manifest("offise")


def test_bus__another_takes_over_from_one_that_vanished(endpoint: str, bus: zenostat.Bus) -> None:
    """first@0 … first@2 → node@3 → first dies → second@3 → node@4"""
    until(lambda: bus.controllers() == [], "those of other tests have gone")
    with bus.controller("office", name="resets") as link:
        link.reset()
    until(lambda: bus.controllers() == [], "it has gone")
    with events_of(bus) as events, Program(TAKES_THREE_STEPS, endpoint) as program:
        first = program.line()
        program.process.kill()
        left = next_event(events, EventKind.DISCONNECTED)
        while left.source != first:  # "takes over from" of its own claim
            left = next_event(events, EventKind.DISCONNECTED)
        assert left.text == f"{first} disconnected; the node waits for it"
        assert left.step == 3
        with bus.controller("office", name="second") as second:
            over = next_event(events, EventKind.DISCONNECTED)
            assert (over.source, over.text) == (first, f"{second.name} takes over from {first}")
            sample = second.current()
            assert sample.step == 3
            second.send({"core_zn_cooling_setpoint": 27.0})
            after = second.receive()
            assert after.step == 4
            assert after.value_source["core_zn_cooling_setpoint"] == second.name


# Listeners


def trajectory(link: zenostat.ControllerLink) -> Iterator[tuple[bytes, bytes]]:
    """Values and actuators of an episode under commands that change, sample by sample."""
    sample, chance = link.reset(), np.random.default_rng(1)
    while True:
        yield sample.values.tobytes(), sample.effective.tobytes()
        if sample.truncated:
            return
        link.send(np.array([chance.uniform(a.low, a.high) for a in link.manifest.actuators]))
        sample = link.receive()


@pytest.mark.slow
@pytest.mark.parametrize("fate", ["frozen", "killed"])
def test_bus__listener_changes_nothing(folder: Path, fate: str) -> None:
    """A week with a listener to everything that reads one message and is then stopped, or killed in mid-episode."""
    week = {**DAY, "begin": "07-01", "end": "07-07"}
    with (
        node_on_bus(folder, **week) as (node, bus),
        bus.controller("office") as link,
        Program(LISTENS_TO_ALL, node.endpoint) as listener,
    ):
        quiet = list(trajectory(link)) if fate == "killed" else None
        assert listener.line() == "listens"
        disturbed = []
        for sample in trajectory(link):
            disturbed.append(sample)
            if len(disturbed) == 3:
                assert listener.line() == "heard"
                if fate == "frozen":
                    listener.process.send_signal(signal.SIGSTOP)
                else:
                    listener.process.kill()
        if quiet is None:
            listener.close()
            quiet = list(trajectory(link))
        status = bus.status("office")
    assert len(quiet) == 7 * 96 + 1
    assert disturbed == quiet
    assert (status.rejected, status.late, status.duplicate) == (0, 0, 0)
