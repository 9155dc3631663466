"""Controllers that come, go, freeze and share a building: real nodes, real Zenoh, processes of their own."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import zenoh
from support.events import events_of, next_event
from support.nodes import COOLING, SMALL, NodeProgram, Program, begin_new_episode, free_port, node_on_bus, until
from support.run_cli import ZENOSTAT, error_of, run_program
from support.tank_plant import TANK

import zenostat
from zenostat.bridge.client.sample import SampleView
from zenostat.topics import codec, keys
from zenostat.topics.errors import EpisodeAborted, InvalidConfig, RequestRejected, ZenostatError
from zenostat.topics.messages import Claim, Command, ControllerState, ControllerStatus, EventKind, Policy, State

STEPS = 96
POINT = "core_zn_cooling_setpoint"
OTHER = "perimeter_zn_1_cooling_setpoint"
NORTH, SOUTH = list(COOLING)[:2], list(COOLING)[2:]

TOLD_WHAT_TO_SEND = """
import sys
import zenostat
from zenostat.topics.errors import ZenostatError
endpoint, name, *points = sys.argv[1:]
with zenostat.connect(endpoint, affinity="off") as bus, bus.controller("office", name=name, actuators=points) as link:
    print(link.name, flush=True)
    asks = True
    try:
        for sample in link:
            if asks:
                print(sample.step, flush=True)
                said = sys.stdin.readline().split()
                asks = said[-1] != "on"
            sample.send(dict.fromkeys(points, float(said[0])))
    except ZenostatError as error:
        print(type(error).__name__, error, flush=True)
"""
"""Says each step and sends the value that it is told; after `VALUE on` that one for ever, and nothing is said."""


@contextmanager
def office(folder: Path, **settings: Any) -> Iterator[tuple[NodeProgram, zenostat.Bus]]:
    with node_on_bus(folder / "node", **{**SMALL, **settings}) as (node, bus):
        yield node, bus


def to_the_end(samples: Iterator[SampleView]) -> list[SampleView]:
    received = []
    for sample in samples:
        received.append(sample)
        if sample.truncated:
            break
    return received


def effective(sample: SampleView, point: str = POINT) -> float:
    return float(sample.effective[[a.name for a in sample.manifest.actuators].index(point)])


def told_steps(program: Program, values: list[float]) -> None:
    """It sends these values, from sample 0 on, and has then said that it got the next sample."""
    for step, value in enumerate(values):
        assert program.json() == step
        program.tell(str(value))
    assert program.json() == len(values)


def status_of(bus: zenostat.Bus, name: str) -> ControllerStatus:
    return next(c for c in bus.status("office").controllers if c.controller == name)


# Killed


@pytest.mark.parametrize(
    ("policy", "bus_of"),
    [
        ("wait", "unix"),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("hold", "tcp"), ("hold", "unix"), ("relinquish", "unix"), ("wait", "tcp"))
        ),
    ],
)
def test_fallback_policies__killed_controller_is_noticed_and_the_policy_follows(
    scratch: Path, policy: str, bus_of: str
) -> None:
    """agent@0 → agent@1 → node@2 → agent is killed → policy"""
    listen = {"listen": [f"tcp/127.0.0.1:{free_port()}"]} if bus_of == "tcp" else {}
    with (
        office(scratch, policy=policy, **listen) as (node, bus),
        events_of(bus) as events,
        Program(TOLD_WHAT_TO_SEND, node.endpoint, "agent", POINT) as agent,
    ):
        name = agent.line()
        told_steps(agent, [26.0, 27.0])
        with bus.listen("office") as samples:
            agent.process.kill()
            left = next_event(events, EventKind.DISCONNECTED)
            assert (left.source, left.step) == (name, 2)
            if policy == "wait":
                assert "waits for it" in left.text
                status = bus.status("office")
                assert (status.state, status.step) == (State.WAITING, [2])
                assert [c.state for c in status.controllers] == [ControllerState.DISCONNECTED]
                return
            assert next_event(events, EventKind.FALLBACK).source == name
            rest = to_the_end(samples)
        assert [sample.step for sample in rest] == [*range(3, STEPS + 1)]
        assert all(sample.fallback for sample in rest)
        if policy == "hold":
            assert {(effective(s), s.value_source[POINT]) for s in rest} == {(27.0, name)}
        else:
            assert {s.value_source[POINT] for s in rest} == {""}
            assert {effective(s) for s in rest} == {24.0, 26.7}  # the building's own: at work, and set back
        agent_ = status_of(bus, name)
        assert (agent_.accepted, agent_.missed, agent_.state) == (2, STEPS - 2, ControllerState.BYPASSED)
        assert bus.status("office").statistics.missed == STEPS - 2


@pytest.mark.slow
def test_fallback_policies__one_that_was_killed_returns_at_the_present_step(scratch: Path) -> None:
    """north and south → south is killed → north alone → another south takes over: no timestep without a ruler"""
    with office(scratch, policy="hold") as (node, bus), events_of(bus) as events, bus.listen("office") as samples:
        with ExitStack() as stack:
            first = stack.enter_context(Program(TOLD_WHAT_TO_SEND, node.endpoint, "south", *SOUTH))
            north = stack.enter_context(bus.controller("office", name="north", actuators=NORTH))
            name = first.line()
            assert first.json() == 0
            first.tell("26 on")
            sample = north.current()
            for step in range(STEPS):
                sample.send(dict.fromkeys(NORTH, 25.0))
                sample = north.receive()
                if step == 20:
                    first.process.kill()
                    assert next_event(events, EventKind.FALLBACK).source == name
                if step == 30:
                    second = stack.enter_context(Program(TOLD_WHAT_TO_SEND, node.endpoint, "south", *SOUTH))
                    successor = second.line()
                    assert second.json() == sample.step == 31
                    second.tell("27 on")
        received = to_the_end(samples)
    assert [sample.step for sample in received] == [*range(1, STEPS + 1)]
    sources = [{sample.value_source[point] for point in SOUTH} for sample in received]
    fell = [sample.step for sample in received if sample.fallback]
    assert {sample.value_source[point] for sample in received for point in NORTH} == {north.name}
    assert sources == [{name}] * 31 + [{successor}] * (STEPS - 31)
    assert [effective(sample, SOUTH[0]) for sample in received] == [26.0] * 31 + [27.0] * (STEPS - 31)
    # It had answered sample 21 before it was killed, or had not.
    assert fell in ([*range(22, 32)], [*range(23, 32)])


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["hold", "relinquish", "abort"])
def test_fallback_policies__controller_whose_token_returns_is_connected_with_its_claim(
    scratch: Path, policy: str
) -> None:
    """A lost link, or one of a client that knows nothing but the contract; the grace period of `abort` goes on."""
    with (
        office(scratch, policy=policy, grace_s=60.0 if policy == "abort" else 0.0) as (_, bus),
        events_of(bus) as events,
        bus.controller("office", name="south", actuators=SOUTH) as south,
    ):

        def declare_token() -> zenoh.LivelinessToken:
            return bus.session.liveliness().declare_token(keys.CONTROLLER_TOKEN.at("office", sender="bare"))

        token = declare_token()
        bus.claim("office", Claim(controller="bare", actuators=NORTH))
        token.undeclare()
        left = next_event(events, EventKind.DISCONNECTED)
        if policy != "abort":
            assert next_event(events, EventKind.FALLBACK).source == left.source
        token = declare_token()
        back = next_event(events, EventKind.CONNECTED, EventKind.FAILED)
        assert (left.source, back.source, back.text) == ("bare", "bare", "bare is on the bus again, with its claim")
        assert status_of(bus, "bare").state is ControllerState.CONNECTED
        with pytest.raises(RequestRejected, match="is claimed by 'bare'"):
            bus.controller("office", name="other", actuators=NORTH)
        sample = south.current()
        sample.send(dict.fromkeys(SOUTH, 26.0))
        until(lambda: status_of(bus, south.name).accepted == 1, "its command is there")
        assert bus.status("office").step == [0], "it waits for the other"
        command = Command(
            episode=[sample.episode],
            step=[sample.step],
            operations=bytes(actuator.name in NORTH for actuator in south.manifest.actuators),
            values=np.full(len(south.manifest.actuators), 27.0).tobytes(),
        )
        bus.session.put(keys.COMMAND.at("office", sender="bare"), codec.encode(command))
        assert (effective(south.receive(), NORTH[0]), status_of(bus, "bare").missed) == (27.0, 0)
        token.undeclare()


# Frozen


@pytest.mark.slow
def test_late_command_of_a_frozen_controller__reported_and_not_applied(scratch: Path) -> None:
    """agent@0 → node@1 → agent frozen → deadlines → … → agent goes on: agent@1 is late, then it has caught up"""
    with (
        office(scratch, policy="hold", deadline_s=1.0, end="07-09") as (node, bus),
        events_of(bus) as events,
        Program(TOLD_WHAT_TO_SEND, node.endpoint, "agent", POINT) as agent,
        bus.listen("office") as samples,
    ):
        name = agent.line()
        told_steps(agent, [25.0])
        assert next(samples).step == 1
        came_s = time.monotonic()
        os.kill(agent.pid, signal.SIGSTOP)
        until(lambda: psutil.Process(agent.pid).status() == psutil.STATUS_STOPPED, "the controller is frozen")
        agent.tell("29")
        fallback = next_event(events, EventKind.FALLBACK, EventKind.LATE)
        assert (fallback.kind, fallback.source, fallback.step) == (EventKind.FALLBACK, name, 1)
        frozen = [next(samples)]
        went_s = time.monotonic()
        frozen += [next(samples) for _ in range(2)]
        assert status_of(bus, name).state is ControllerState.UNRESPONSIVE
        woken_s = time.monotonic()
        os.kill(agent.pid, signal.SIGCONT)
        late = next_event(events, EventKind.LATE, EventKind.DISCONNECTED, EventKind.CONNECTED)
        told_s = time.monotonic()
        assert (late.kind, late.source) == (EventKind.LATE, name)
        assert "step [1]" in late.text
        assert late.late_s is not None
        assert woken_s - went_s <= late.late_s <= told_s - came_s
        # From now on it answers whatever is on its way to it, until it has caught up.
        agent.line()
        agent.tell("24 on")
        again = next_event(events, EventKind.CONNECTED)
        assert (again.source, "answers again" in again.text) == (name, True)
        while not (sample := next(samples)).step > again.step + 3:
            frozen += [sample] if sample.step <= again.step else []
            assert sample.step <= again.step or (effective(sample), sample.fallback) == (24.0, False)
    assert [s.step for s in frozen] == [*range(2, again.step + 1)]
    assert {(effective(s), s.value_source[POINT], s.fallback) for s in frozen} == {(25.0, name, True)}


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("policy", ["abort", "hold"])
def test_fallback_policies__controller_that_joins_late_and_is_silent_meets_its_deadline(
    scratch: Path, policy: str
) -> None:
    """The sample was there long before anyone was: the time of its first step begins when it joins."""
    with (
        office(scratch, policy=policy, deadline_s=0.02) as (_, bus),
        events_of(bus) as events,
        bus.controller("office", name="agent") as link,
    ):
        event = next_event(events, EventKind.FALLBACK, EventKind.FAILED)
        assert event.step == 0
        if policy == "hold":
            assert (event.kind, event.source) == (EventKind.FALLBACK, link.name)
        else:
            assert (event.kind, event.error) == (EventKind.FAILED, "EpisodeAborted")


# The node itself is occupied or suspended

SLOW_TRIALS = """
import time

class Slow:
    step_s, begin, duration_s = 60.0, "2026-01-12T00:00", 86400.0
    sensors, actuators = {"level": ("m", 0.0, None)}, {"pump": ("W", 0.0, 100.0, 5.0)}
    forkable = True

    def reset(self, seed):
        return {"level": 0.0}

    def step(self, commands):
        time.sleep(1.5 if commands["pump"] == 42.0 else 0.0)
        return {"level": commands["pump"]}
"""


@pytest.mark.parametrize("policy", ["abort", "hold"])
def test_deadline__command_that_arrives_during_a_trial_is_in_time(scratch: Path, policy: str) -> None:
    (scratch / "slow.py").write_text(SLOW_TRIALS)
    with (
        node_on_bus(scratch / "node", plant=f"{scratch}/slow.py:Slow", policy=policy, deadline_s=0.6) as (node, bus),
        zenostat.connect(node.endpoint, affinity="off") as other,
        ThreadPoolExecutor(1) as thread,
        bus.controller("office", name="agent") as link,
    ):
        trial = thread.submit(other.try_steps, "office", [[{"pump": 42.0}]], name="planner")
        time.sleep(0.2)
        link.current().send({"pump": 7.0})
        sample = link.receive()
        assert trial.result()[0][0]["level"] == 42.0
        assert (sample.step, sample["level"], sample.fallback) == (1, 7.0, False)


def test_deadline__begins_again_after_the_node_was_suspended(scratch: Path) -> None:
    with (
        node_on_bus(scratch / "node", plant=TANK, policy="abort", deadline_s=1.0) as (node, bus),
        events_of(bus) as events,
        bus.controller("office", name="agent") as link,
    ):
        link.current()
        os.kill(node.process.pid, signal.SIGSTOP)
        time.sleep(2.0)
        os.kill(node.process.pid, signal.SIGCONT)
        event = next_event(events, EventKind.WARNING, EventKind.FAILED)
        assert "suspended for" in event.text
        link.current().send({"pump": 7.0})
        assert link.receive().step == 1
        assert next_event(events, EventKind.FAILED).error == "EpisodeAborted"  # nobody answers the next one


# Aborted


def test_abort__current_continues_in_the_episode_that_another_controller_began(scratch: Path) -> None:
    with (
        node_on_bus(scratch / "node", plant=TANK, policy="abort") as (_, bus),
        bus.controller("office", name="first") as first,
        bus.controller("office", name="second", priority=12) as second,
    ):
        leaving = bus.controller("office", name="leaving", priority=14)
        first.current()
        second.current()
        leaving.close()
        for link in (first, second):
            with pytest.raises(EpisodeAborted, match=leaving.name):
                link.receive()
        first.reset().send({"pump": 7.0})
        sample = second.current()
        assert (sample.episode, sample.step) == (1, 0)
        sample.send()
        assert [link.receive().step for link in (first, second)] == [1, 1]


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("how", ["killed", "unresponsive"])
def test_abort__reaches_the_other_controller_and_a_reset_begins_anew(scratch: Path, how: str) -> None:
    silent = {"deadline_s": 4.0} if how == "unresponsive" else {}
    with (
        office(scratch, policy="abort", **silent) as (node, bus),
        Program(TOLD_WHAT_TO_SEND, node.endpoint, "south", *SOUTH) as south,
        nullcontext(south.line()) as name,  # before the other one joins, which begins the step's time
        bus.controller("office", name="north", actuators=NORTH) as north,
    ):
        assert south.json() == 0
        south.tell("26")
        north.current().send(dict.fromkeys(NORTH, 25.0))
        north.receive().send(dict.fromkeys(NORTH, 25.0))
        assert south.json() == 1
        if how == "killed":
            south.process.kill()
        with pytest.raises(EpisodeAborted, match=name):
            north.receive()
        status = bus.status("office")
        assert status.state is State.FAILED
        assert name in status.failure
        if how == "unresponsive":
            south.tell("26")
            assert south.line().startswith("EpisodeAborted")
            south.process.kill()
        until(lambda: not [c for c in bus.controllers() if c[1] == name], "it has gone")
        sample = north.reset()
        assert (sample.episode, sample.step) == (1, 0)
        if how == "killed":  # whoever is still there at the reset is waited for
            sample.send(dict.fromkeys(NORTH, 25.0))
            sample = north.receive()
            assert (sample.step, sample.fallback, sample.value_source[SOUTH[0]]) == (1, False, "")


# Together


def wanted(point: str, step: int) -> float:
    """Return the command of a zone group's controller for a sample."""
    return 23.0 + (7 * step + 3 * list(COOLING).index(point)) % 13 / 4


FOLLOWS_A_PLAN = """
import sys
import zenostat
endpoint, name, *points = sys.argv[1:]
with zenostat.connect(endpoint, affinity="off") as bus, bus.controller("office", name=name, actuators=points) as link:
    print(link.name, flush=True)
    zones = "core_zn perimeter_zn_1 perimeter_zn_2 perimeter_zn_3 perimeter_zn_4".split()
    for sample in link:
        sample.send({p: 23.0 + (7 * sample.step + 3 * zones.index(p[:-17])) % 13 / 4 for p in points})
    print(sample.step, flush=True)
"""


@pytest.mark.slow
def test_fallback_policies__two_controllers_and_a_supervisor_are_as_one_to_the_bit(
    scratch: Path, episode_bus: zenostat.Bus
) -> None:
    """north and south answer each sample; from sample 8 the supervisor overrides the core at 28 for an hour."""
    with (
        Program(FOLLOWS_A_PLAN, episode_bus.endpoint, "north", *NORTH) as north,
        episode_bus.controller("office", name="south", actuators=SOUTH) as south,
    ):
        name = north.line()
        many = [south.current()]
        while not many[-1].truncated:
            if many[-1].step == 8:
                episode_bus.write("office", POINT, 28.0, priority=8, duration_s=3600.0, source="supervisor")
            many[-1].send({point: wanted(point, many[-1].step) for point in SOUTH})
            many.append(south.receive())
        assert north.json() == STEPS
    assert len(many) == STEPS + 1
    for sample in many[1:]:
        sources = dict.fromkeys(NORTH, name) | dict.fromkeys(SOUTH, south.name)
        source_index = sample.value_source[POINT]
        if 9 <= sample.step <= 12:
            assert source_index == "supervisor"
            sources[POINT] = source_index
        assert sample.value_source == {point: sources.get(point, "") for point in sample.value_source}
    begin_new_episode(episode_bus)
    with episode_bus.controller("office", name="one", actuators=[*COOLING]) as one:
        single = [one.current()]
        while not single[-1].truncated:
            step = single[-1].step
            override = {POINT: 28.0} if 8 <= step < 12 else {}
            single[-1].send({point: wanted(point, step) for point in COOLING} | override)
            single.append(one.receive())
    for together, alone in zip(many, single, strict=True):
        assert together.message.values == alone.message.values
        assert together.message.effective == alone.message.effective
    assert np.isfinite(single[-1].values).all()
    assert {effective(sample) for sample in many[9:13]} == {28.0}


# The command line


def run_zenostat(*arguments: str) -> subprocess.CompletedProcess[str]:
    return run_program(*arguments, columns=200)


def row(text: str, first: str) -> list[list[str]]:
    """The cells of the rows of tables whose first cell begins so."""
    lines = [re.split(r" {2,}", line.strip()) for line in text.splitlines()]
    return [cells for cells in lines if cells[0].startswith(first)]


@pytest.mark.slow
def test_status_command__shows_the_policy_and_the_bypassed_controller(scratch: Path) -> None:
    endpoint = f"unixsock-stream/{scratch}/bus"
    day = [part for k, v in SMALL.items() for part in (f"--{k.replace('_', '-')}", str(v))]
    how = ["--policy", "hold", "--grace", "0.25", "--deadline", "2000", "--affinity", "off"]
    node = subprocess.Popen(
        [*ZENOSTAT, "node", *day, "--name", "office", "--listen", endpoint, *how], stdout=subprocess.PIPE, text=True
    )
    try:
        while "Ctrl-C" not in node.stdout.readline():
            assert node.poll() is None
        with zenostat.connect(endpoint, affinity="off") as bus:
            manifest = bus.manifest("office")
            assert (manifest.policy, manifest.grace_s, manifest.deadline_s) == (Policy.HOLD, 0.25, 2000.0)
            with (
                events_of(bus) as events,
                bus.controller("office", name="north", actuators=NORTH) as north,
                Program(TOLD_WHAT_TO_SEND, endpoint, "south", *SOUTH) as south,
            ):
                name = south.line()
                assert south.json() == 0
                south.process.kill()
                assert next_event(events, EventKind.FALLBACK).source == name
                north.current().send()
                north.receive()
                output = run_zenostat("status", "--connect", endpoint).stdout
    finally:
        node.send_signal(signal.SIGINT)
        node.communicate(timeout=60)
    assert row(output, "fallback policy") == [["fallback policy", "hold; applied in 1 timestep"]]
    claims, counts = row(output, name)
    assert claims[1:] == ["office", "10", "3", "yes", "bypassed"]
    assert counts[1:] == ["0", "0", "0", "0", "1", "-", "-", "-"]
    claims, counts = row(output, north.name)
    assert claims[1:] == ["office", "10", "2", "yes", "connected"]
    assert counts[1:6] == ["1", "0", "0", "0", "0"]
    median, p99, most = (float(cell.replace(",", "")) for cell in counts[6:])
    assert 0.0 < median == p99 == most


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--grace", "-1", "grace_s"),
        ("--deadline", "0", "deadline_s"),
        ("--deadline", "inf", "deadline_s"),
        ("--grace", "nan", "grace_s"),
        ("--policy", "give-up", "'wait', 'hold', 'relinquish', 'abort'"),
    ],
)
def test_fallback_policies__settings_that_cannot_be_are_refused_before_anything_starts(
    option: str, value: str, words: str
) -> None:
    settings = ("--building", "ref-small-office", "--weather", "USA_CO_Denver", option, value)
    assert words in error_of("node", *settings, columns=200)


def test_fallback_policies__node_s_settings_are_checked_alike(folder: Path) -> None:
    with pytest.raises(InvalidConfig) as raised:
        NodeProgram(folder / "node", **SMALL, grace_s=-1, deadline_s=0)
    assert isinstance(raised.value, ZenostatError)
    for setting in ("grace_s", "deadline_s"):
        assert setting in str(raised.value)


@pytest.mark.slow
def test_node_on_its_fallback_policy__answers_requests(scratch: Path) -> None:
    """Without a deadline it runs as fast as it can, and whoever comes back is heard at once."""
    year = SMALL | {"begin": "01-01", "end": "12-31", "policy": "hold", "grace_s": 0.0}
    with node_on_bus(scratch / "n", **year) as (_, bus):
        link = bus.controller("office", name="goes")
        sample = link.current()
        sample.send()
        link.receive()
        link.close()
        until(lambda: bus.status("office").step[0] > 20, "it goes on without")
        bus.pause("office")
        status = bus.status("office")
        assert status.paused
        assert 20 < status.step[0] < status.steps
