"""Simulated time against the wall clock: the rules of the schedule, and real nodes that keep it."""

import math
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.nodes import SMALL, NodeProgram, begin_new_episode, free_port, node_on_bus, until
from support.run_cli import ZENOSTAT, error_of, output_of

import zenostat
from zenostat import Bus
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.exchange.step_schedule import StepSchedule
from zenostat.cli.pace import read_pace
from zenostat.topics.errors import InvalidConfig, RequestRejected
from zenostat.topics.messages import EventKind, Mode, Sample, State

SETPOINT = "core_zn_cooling_setpoint"
STEP_S = 900.0
DAY_STEPS = 96
FAST = 45_000.0
"""A timestep of a quarter of an hour in 20 ms."""
STEP_WALL_S = STEP_S / FAST
YEAR = {**SMALL, "begin": "01-01", "end": "12-31"}


# The schedule


@pytest.mark.variants
@pytest.mark.parametrize("speed", [1.0, 7.0, 3600.0])
def test_pacing__million_timesteps_do_not_drift(speed: float) -> None:
    pace = StepSchedule(STEP_S, speed)
    pace.rebase(1234.5678, 0)
    now_s = 0.0
    for step in range(1, 1_000_001):
        now_s = pace.due_s(step) + 0.1 * STEP_S / speed  # each a tenth of a timestep late
        assert not pace.record_sample(now_s, step)
    exact = Fraction(1234.5678) + Fraction(1_000_000) * Fraction(STEP_S) / Fraction(speed)
    assert abs(Fraction(pace.due_s(1_000_000)) - exact) <= 2 * Fraction(math.ulp(now_s))
    assert (pace.overruns, pace.max_lag_s) == (0, 0.0)


def test_pacing__overrun_is_a_sample_that_came_after_the_next_one_was_due() -> None:
    pace = StepSchedule(STEP_S, 900.0)  # a timestep a second
    pace.rebase(100.0, 0)
    times = {1: 101.0, 2: 103.0, 3: 104.5, 4: 106.25, 5: 106.5, 6: 106.75}
    late = [step for step, now_s in times.items() if pace.record_sample(now_s, step)]
    # due: 101, 102, 103, 104, 105, 106; the next of each a second later
    assert late == [3, 4, 5]
    assert pace.overruns == 3
    assert pace.max_lag_s == 2.25  # sample 4, due at 104


def test_pacing__after_an_overrun_the_schedule_is_the_old_one() -> None:
    pace = StepSchedule(STEP_S, 900.0)
    pace.rebase(0.0, 0)
    pace.record_sample(7.5, 1)
    assert [pace.due_s(step) for step in (2, 8, 9)] == [2.0, 8.0, 9.0]


def test_pacing__schedule_begins_where_it_is_anchored() -> None:
    pace = StepSchedule(STEP_S, 60.0)  # 15 s a timestep
    pace.rebase(1000.0, 40)
    assert [pace.due_s(step) for step in (40, 41, 44)] == [1000.0, 1015.0, 1060.0]
    pace.rebase(2000.0, 44)
    assert pace.due_s(45) == 2015.0


def test_pacing__change_of_speed_keeps_how_far_the_timestep_has_gone() -> None:
    pace = StepSchedule(STEP_S, 60.0)
    pace.rebase(0.0, 0)
    into_s = pace.elapsed_in_step_s(25.0, 1)  # sample 1 was due at 15; 10 s of 60 since
    assert into_s == 600.0
    pace.speed = 30.0
    pace.rebase(25.0, 1, into_s)
    assert pace.due_s(2) == 35.0  # 300 s are left, at 30


def test_pacing__what_is_behind_is_not_caught_up_after_a_change() -> None:
    pace = StepSchedule(STEP_S, 900.0)
    pace.rebase(0.0, 0)
    into_s = pace.elapsed_in_step_s(50.0, 3)
    assert into_s == STEP_S
    pace.rebase(50.0, 3, into_s)
    assert [pace.due_s(4), pace.due_s(5)] == [50.0, 51.0]


@given(
    step_s=st.sampled_from([60.0, 300.0, 900.0, 3600.0]),
    speed=st.floats(0.01, 1e9),
    origin_s=st.floats(0, 1e7),
    step=st.integers(0, 10**7),
)
def test_pacing__timesteps_are_of_one_length(step_s: float, speed: float, origin_s: float, step: int) -> None:
    pace = StepSchedule(step_s, speed)
    pace.rebase(origin_s, 0)
    exact = Fraction(origin_s) + step * Fraction(step_s) / Fraction(speed)
    assert float(exact) == pytest.approx(pace.due_s(step), rel=1e-15, abs=0)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("60", (Mode.PACED, 60.0)),
        ("0.5", (Mode.PACED, 0.5)),
        ("free", (Mode.FREE, None)),
        ("lockstep", (Mode.LOCKSTEP, None)),
    ],
)
def test_pacing__pace_on_the_command_line(text: str, meant: tuple[Mode, float | None]) -> None:
    assert read_pace(text) == meant


def test_pacing__no_pace_on_the_command_line() -> None:
    with pytest.raises(InvalidConfig, match=r"'fast' is not a pace: expected a number above 0 .*, lockstep or free"):
        read_pace("fast")


# Real nodes


def arrivals(samples: Iterator[SampleView], steps: int) -> list[tuple[int, float]]:
    """So many samples: the step of each, and when it came by the clock that all processes share."""
    received = []
    for sample in samples:
        received.append((sample.step, time.monotonic()))
        if len(received) == steps:
            break
    return received


def round_trips(bus: Bus, times: int = 5) -> None:
    """Requests that the node's own thread does one after another; a node that does not stand goes on between them."""
    for _ in range(times):
        bus.weather("office", ["dry_bulb"])


def held(link: ControllerLink) -> None:
    """The first timestep in lockstep, with a command that holds from then on."""
    link.current().send({SETPOINT: 27.0})
    assert link.receive().step == 1


def trajectory(samples: list[Sample]) -> list[tuple[list[int], bytes, bytes]]:
    """Return the parts of messages that must agree to the bit."""
    return [(sample.step, sample.values, sample.effective) for sample in samples]


def rest(samples: Iterator[SampleView]) -> list[Sample]:
    """All samples up to the episode's last."""
    messages = []
    for sample in samples:
        messages.append(sample.message)
        if sample.truncated:
            return messages
    raise AssertionError("the node is gone")


@pytest.fixture
def bus(episode_bus: Bus) -> Bus:
    """The bus of a node that the tests of this module share."""
    return episode_bus


@pytest.fixture(scope="module")
def year(module_folder: Path) -> Iterator[NodeProgram]:
    """A node whose episodes outlast all that the tests do."""
    with NodeProgram(module_folder / "year", **YEAR) as node:
        yield node


@pytest.fixture
def year_bus(year: NodeProgram) -> Iterator[Bus]:
    """The bus of `year`, which waits at the first sample of a new episode; paused in the end."""
    with zenostat.connect(year.endpoint, affinity="off") as bus:
        begin_new_episode(bus)
        yield bus
        bus.pause("office")


@pytest.fixture(scope="module")
def reference(shared_node: NodeProgram) -> list[Sample]:
    """Samples 1 to the last of a day in lockstep, with one setpoint held."""
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        begin_new_episode(bus)
        messages = []
        for sample in bus.controller("office"):
            messages.append(sample.message)
            sample.send({SETPOINT: 27.0})
        return messages[1:]


@pytest.mark.slow
def test_pacing__no_sample_comes_before_it_is_due(bus: Bus) -> None:
    with bus.listen("office") as samples:
        asked_s = time.monotonic()
        bus.pace("office", FAST)
        received = arrivals(samples, DAY_STEPS)
    assert [step for step, _ in received] == list(range(1, DAY_STEPS + 1))
    early = [(step, now_s - asked_s) for step, now_s in received if now_s < asked_s + step * STEP_WALL_S]
    assert early == []
    status = until(lambda: (s := bus.status("office")).state == "ended" and s, "the episode has ended")
    assert (status.mode, status.speed) == (Mode.PACED, FAST)


@pytest.mark.slow
def test_pacing__reset_begins_a_schedule(bus: Bus) -> None:
    bus.pace("office", FAST)
    with bus.controller("office", required=False) as link:
        asked_s = time.monotonic()
        link.reset()
        first = link.receive()
        assert time.monotonic() >= asked_s + first.step * STEP_WALL_S
        fifth = next(s for s in iter(link.receive, None) if s.step >= first.step + 4)
        assert time.monotonic() >= asked_s + fifth.step * STEP_WALL_S


def test_paced_node__holds_the_last_command(bus: Bus, reference: list[Sample]) -> None:
    with bus.controller("office", name="holder") as link:
        held(link)
        with bus.listen("office") as samples:
            bus.pace("office", 10 * FAST)
            messages = rest(samples)
        index = [a.name for a in link.manifest.actuators].index(SETPOINT)
        assert all(sample.sources[np.frombuffer(sample.source_index, "<u2")[index]] == link.name for sample in messages)
    assert trajectory(messages) == trajectory(reference[1:])


@pytest.mark.slow
def test_pacing__impossible_speed_is_counted_and_loses_nothing(scratch: Path, reference: list[Sample]) -> None:
    with node_on_bus(scratch / "n", **SMALL) as (_, bus):
        with bus.controller("office") as link:
            held(link)
            with bus.listen("office") as samples:
                bus.pace("office", 1e9)  # 0.9 us a timestep
                messages = rest(samples)
        assert trajectory(messages) == trajectory(reference[1:])
        until(lambda: bus.status("office").state == "ended", "the episode has ended")
        round_trips(bus, 1)  # by the node's own thread, which has counted by then
        counts = bus.status("office").statistics
        assert counts.overruns == DAY_STEPS - 1
        assert counts.max_lag_s > 0
        assert counts.step.count == DAY_STEPS
        assert bus.manifest("office").statistics.overruns == counts.overruns


def test_free_node__gives_the_same_trajectory_as_lockstep(bus: Bus, reference: list[Sample]) -> None:
    overruns = bus.status("office").statistics.overruns
    with bus.controller("office") as link:
        held(link)
        with bus.listen("office") as samples:
            bus.pace("office", mode="free")
            messages = rest(samples)
    assert trajectory(messages) == trajectory(reference[1:])
    assert bus.status("office").statistics.overruns == overruns
    assert bus.manifest("office").mode is Mode.FREE


def test_pacing__command_that_comes_in_time_controls_the_next_timestep(bus: Bus) -> None:
    accepted = bus.status("office").accepted
    bus.pace("office", 1e-3)  # ten days a timestep
    with bus.controller("office", required=False) as link:
        sample = link.current()
        sample.send({SETPOINT: 28.0})
        until(lambda: bus.status("office").accepted == accepted + 1, "the command is taken")
        assert bus.status("office").step == [0]
        bus.pace("office", 1e9)
        index = [a.name for a in link.manifest.actuators].index(SETPOINT)
        assert link.receive().effective[index] == 28.0


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("mode", ["free", "paced"])
def test_pacing__paused_node_stands_until_it_goes_on(year_bus: Bus, mode: str) -> None:
    bus = year_bus
    bus.pace("office", 1e6 if mode == "paced" else None, mode=mode)
    until(lambda: bus.status("office").step[0] > 3, "the node runs")
    bus.pause("office")
    status = bus.status("office")
    assert status.paused
    with bus.listen("office") as samples:
        round_trips(bus)
        assert bus.status("office").step == status.step
        overruns = bus.status("office").statistics.overruns
        bus.step("office", 4)
        until(lambda: bus.status("office").step == [status.step[0] + 4], "four timesteps are done")
        round_trips(bus)
        assert bus.status("office").step == [status.step[0] + 4]
        assert bus.status("office").statistics.overruns == overruns  # a step by hand has no schedule
        bus.resume("office")
        received = arrivals(samples, 6)
    assert [step for step, _ in received] == [status.step[0] + k for k in range(1, 7)]
    assert not bus.status("office").paused


@pytest.mark.slow
def test_pause__forgets_requested_steps(year_bus: Bus) -> None:
    bus = year_bus
    bus.pause("office")
    bus.pace("office", mode="free")
    bus.step("office", 1_000_000)
    bus.pause("office")
    before = bus.status("office").step
    assert before[0] < bus.status("office").steps
    round_trips(bus)
    assert bus.status("office").step == before


def test_pacing__reset_forgets_the_steps_that_were_left(year_bus: Bus) -> None:
    """A reset during a pause begins an episode that is paused."""
    bus = year_bus
    bus.pause("office")
    bus.pace("office", mode="free")
    bus.step("office", 30_000)
    with bus.controller("office", required=False) as link:
        link.reset()
        assert link.current().step == 0
        for _ in range(3):
            assert bus.status("office").step == [0]
        bus.step("office", 2)
        until(lambda: bus.status("office").step == [2], "it has gone two timesteps")


def test_pacing__steps_in_lockstep_go_once_they_are_answered(bus: Bus) -> None:
    accepted = bus.status("office").accepted
    bus.pause("office")
    with bus.controller("office") as link:
        link.current().send()
        until(lambda: bus.status("office").accepted == accepted + 1, "the command is taken")
        round_trips(bus)
        assert bus.status("office").step == [0]
        bus.step("office", 2)
        sample = link.receive()
        round_trips(bus)
        assert (sample.step, bus.status("office").step) == (1, [1])  # not answered yet
        sample.send()
        sample = link.receive()
        sample.send()
        until(lambda: bus.status("office").accepted == accepted + 3, "the command is taken")
        round_trips(bus)
        assert (sample.step, bus.status("office").step) == (2, [2])
        bus.resume("office")
        assert link.receive().step == 3


def test_pacing__resumed_node_does_not_catch_up(bus: Bus) -> None:
    with bus.listen("office") as samples:
        bus.pace("office", FAST)
        next(samples)
        bus.pause("office")
        standing, paused_s = bus.status("office").step[0], time.monotonic()
        until(lambda: time.monotonic() > paused_s + 20 * STEP_WALL_S, "twenty timesteps would have gone")
        assert bus.status("office").step == [standing]
        asked_s = time.monotonic()
        bus.resume("office")
        received = [(step, now_s) for step, now_s in arrivals(samples, standing + 14) if step > standing]
    assert len(received) >= 10
    # What was left of the timestep in which it was paused may be short; each after it has its length.
    early = [step for step, now_s in received if now_s < asked_s + (step - standing - 1) * STEP_WALL_S]
    assert early == []


@pytest.mark.slow
def test_pacing__pace_changes_while_it_runs(bus: Bus) -> None:
    with bus.listen("office") as samples:
        bus.pace("office", 1.0)  # a quarter of an hour a timestep
        round_trips(bus)
        assert bus.status("office").step == [0]
        asked_s = time.monotonic()
        bus.pace("office", FAST)
        received = arrivals(samples, 10)
        assert all(now_s >= asked_s + (step - 1) * STEP_WALL_S for step, now_s in received)
        bus.pace("office", mode=Mode.LOCKSTEP)
        standing = bus.status("office").step
        round_trips(bus)
        assert bus.status("office").step == standing
        assert bus.status("office").mode is Mode.LOCKSTEP


def test_repeated_pace_request__does_not_stop_the_clock(bus: Bus) -> None:
    with bus.controller("office", required=False):
        bus.pace("office", STEP_S)  # a timestep a second

        def asked_again() -> bool:
            bus.pace("office", STEP_S)
            return bus.status("office").step[0] > 0

        until(asked_again, "a timestep is over, though the pace was set anew all the while")


@pytest.mark.slow
def test_pacing__deadlines_hang_in_a_pause_and_go_on_after_it(scratch: Path) -> None:
    with (
        node_on_bus(scratch / "node", **SMALL, policy="hold", deadline_s=0.02) as (_, bus),
        bus.controller("office") as link,
    ):
        bus.pause("office")
        sample = link.current()
        paused_s = time.monotonic()
        until(lambda: time.monotonic() > paused_s + 0.1, "five deadlines would be over")
        round_trips(bus)
        assert bus.status("office").step == [sample.step]
        bus.step("office", 2)  # nobody answers; the policy does
        until(lambda: bus.status("office").step == [sample.step + 2], "two timesteps have gone by the policy")
        round_trips(bus)
        assert bus.status("office").step == [sample.step + 2]
        bus.resume("office")
        until(lambda: bus.status("office").step[0] > sample.step + 4, "it goes on by the policy")


def test_node__publishes_its_changes_of_pace(bus: Bus) -> None:
    from zenostat.topics import codec, keys
    from zenostat.topics.messages import Event

    with bus.session.declare_subscriber(keys.EVENT.at("office")) as events:
        bus.pause("office", source="me")
        bus.pace("office", 60)
        bus.step("office", 1)
        bus.resume("office")
        received = [codec.decode(Event, events.recv().payload.to_bytes()) for _ in range(4)]
    assert {event.kind for event in received} == {EventKind.PACE}
    assert [event.text for event in received] == ["paused", "60 times the wall clock", "steps left: 1", "resumed"]
    assert received[0].source == "me"


@pytest.mark.parametrize(
    ("ask", "error", "words"),
    [
        (lambda bus: bus.pace("office", 0), InvalidConfig, "speed.*greater than or equal to 0.000001"),
        (lambda bus: bus.pace("office", -60.0), InvalidConfig, "speed.*greater than or equal to 0.000001"),
        (lambda bus: bus.pace("office", float("nan")), InvalidConfig, "speed.*finite"),
        (lambda bus: bus.pace("office", 2e9), InvalidConfig, "speed.*less than or equal to 1000000000"),
        (lambda bus: bus.pace("office", 5e-324), InvalidConfig, "speed.*greater than or equal to 0.000001"),
        (lambda bus: bus.pace("office", mode="quick"), InvalidConfig, "mode.*'lockstep', 'paced' or 'free'"),
        (lambda bus: bus.pace("office"), RequestRejected, "only the mode 'paced' has a speed, and needs one"),
        (lambda bus: bus.pace("office", 60, mode="free"), RequestRejected,
            "only the mode 'paced' has a speed, and needs one"),
        (lambda bus: bus.step("office", 4), RequestRejected, "not paused; pause it first"),
        (lambda bus: bus.step("office", 0), InvalidConfig, "steps.*greater than or equal to 1"),
    ],
)  # fmt: skip
def test_invalid_requests__refused_with_the_reason(bus: Bus, ask: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        ask(bus)
    status = bus.status("office")
    assert (status.step, status.mode, status.speed, status.paused) == ([0], Mode.LOCKSTEP, 1.0, False)


@pytest.mark.slow
def test_pacing__episode_that_is_over_takes_no_steps_and_no_writes(scratch: Path) -> None:
    with NodeProgram(scratch / "n", **SMALL, mode="free") as node, zenostat.connect(node.endpoint) as bus:
        until(lambda: bus.status("office").state is State.ENDED, "the day is over")
        bus.pause("office")
        with pytest.raises(RequestRejected, match="the episode is over; reset it first"):
            bus.step("office", 1)
        with pytest.raises(RequestRejected, match="the episode is over"):
            bus.write("office", "core_zn_cooling_setpoint", 26.0)
        assert bus.status("office").step == [96]


# The command line


def run_zenostat(*arguments: str) -> str:
    return " ".join(output_of(*arguments).split())


def test_commands__pause_pace_step_and_inject_faults(bus: Bus, tmp_path: Path) -> None:
    at = ("--connect", bus.endpoint)
    plan = tmp_path / "faults.yaml"
    plan.write_text("faults: [{name: off by one, kind: bias, points: core_zn_air_temperature, offset: 1.0}]")
    assert run_zenostat("pause", "office", *at) == "office: lockstep; paused; step 0 of 96, 2017-07-03T00:00:00"
    assert "paced, 60 times the wall clock; paused; step 0" in run_zenostat("pace", "office", "60", *at)
    assert "step 4 of 96" in run_zenostat("step", "office", "4", *at)
    assert bus.status("office").step == [4]
    run_zenostat("faults", "office", str(plan), *at)
    run_zenostat("step", "office", *at)
    until(lambda: bus.status("office").faults == ["off by one"], "the fault is on")
    assert "faults" not in run_zenostat("faults", "office", "--clear", *at)
    assert "office: lockstep; paused; step 5 of 96" in run_zenostat("pace", "office", "lockstep", *at)
    assert "paused" not in run_zenostat("resume", "office", *at)


def test_commands__refuse_invalid_arguments() -> None:
    for arguments, words in {
        ("pace", "office", "quick"): "'quick' is not a pace",
        ("faults", "office"): "expected either a file with a fault plan, or --clear",
        ("faults", "office", "nowhere.yaml", "--clear"): "expected either a file with a fault plan, or --clear",
        ("node", "--building", "x", "--weather", "y", "--speed", "5"): "--speed 5 needs --mode paced",
    }.items():
        assert words in error_of(*arguments)


@pytest.mark.slow
def test_paced_node__reports_its_overruns_at_the_end(scratch: Path) -> None:
    (scratch / "faults.yaml").write_text("faults: [{kind: drop, points: core_zn_air_temperature}]")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    options = ["--building", "ref-small-office", "--weather", "USA_CO_Denver", "--begin", "07-03", "--end", "07-03"]
    options += ["--mode", "paced", "--speed", "1e9", "--faults", str(scratch / "faults.yaml")]
    options += ["--name", "office", "--listen", endpoint, "--affinity", "off", "--steps-per-hour", "4"]
    program = subprocess.Popen([*ZENOSTAT, "node", *options], stdout=subprocess.PIPE, text=True, cwd=scratch)
    try:
        output = program.stdout.readline()
        while "Ctrl-C" not in output:
            output += program.stdout.readline()
        with zenostat.connect(endpoint, affinity="off") as bus:
            until(lambda: bus.status("office").state == "ended", "the day is over")
            assert bus.status("office").faults == ["drop 1"]
            assert bus.manifest("office").faults_injected
    finally:
        program.send_signal(signal.SIGINT)
        output, _ = program.communicate(timeout=60)
    assert program.returncode == 0
    output = " ".join(output.split())
    assert re.search(r"step 96 [\d.e+]+", output)
    counts = r"0 late, 0 rejected, 0 duplicate, 0 rate limited, 0 missed, 96 overruns \(at most [\d.]+ s behind"
    assert re.search(counts, output)


# A gateway


def test_pacing__gateways_command_in_a_pause_is_answered_though_no_sample_comes(bus: Bus) -> None:
    pytest.importorskip("zmq", reason="pyzmq is not installed")
    from support.zeromq import GatewayProgram, Peer, keeping

    bus.pause("office")
    with GatewayProgram(bus.endpoint) as gateway, Peer(gateway) as peer:
        peer.listen("sample")
        sample = peer.hear(Sample)
        assert peer.ask("rpc/claim/c", controller="c")[0] == "Ack"
        for steps in range(3):
            assert peer.ask("command/c", **keeping(sample))[0] == "Ack"
            assert bus.status("office").step == [steps]
            bus.step("office", 1)
            sample = peer.after(sample)
        bus.resume("office")
        assert peer.ask("command/c", **keeping(sample))[0] == "Ack"
        sample = peer.after(sample)
        bus.pause("office")
        assert peer.ask("command/c", **keeping(sample))[0] == "Ack"
