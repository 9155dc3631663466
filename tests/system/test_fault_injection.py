"""Faults on purpose at a real node: what the bus is told, what the building is told, and what stays as it is."""

import time
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml
from support.nodes import SMALL, WEATHER, node_on_bus, until

from zenostat import Bus
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.faults import LinkFaults
from zenostat.bridge.node.fault_injection import FaultInjection
from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import describe, plan
from zenostat.lab.evaluate import evaluate
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import CreateBranch, Event, EventKind, Flag, PointValue, Sample

CORE, NORTH, EAST, SOUTH = (
    f"{zone}_air_temperature" for zone in ("core_zn", "perimeter_zn_3", "perimeter_zn_2", "perimeter_zn_1")
)
SETPOINT = "core_zn_cooling_setpoint"
LAST = 96


def command(step: int) -> float:
    """Return a controller's command at a sample: another value each hour, within the bounds."""
    return 24.0 + (step // 4) % 5


def day(
    link: ControllerLink,
    at: Callable[[int], float] = command,
    between: Callable[[int], object] | None = None,
    **reset: Any,
) -> list[Sample]:
    """An episode; all its samples. `between` is done at each sample before it is answered."""
    sample = link.reset(**reset)
    messages = [sample.message]
    while not sample.truncated:
        if between is not None:
            between(sample.step)
        sample.send({SETPOINT: at(sample.step)})
        sample = link.receive()
        messages.append(sample.message)
    return messages


class Stage:
    """A node, a bus and a controller.

    Attributes:
        clean: a day without faults.
    """

    def __init__(self, bus: Bus, link: ControllerLink) -> None:
        self.bus, self.link = bus, link
        manifest = link.manifest
        self.names, self.actuators = list(manifest.names), [a.name for a in manifest.actuators]
        self.clean = day(link, seed=1)

    def faulty(self, *faults: dict[str, Any], seed: int = 0, **settings: Any) -> list[Sample]:
        """A day with faults from its begin on, and none afterwards."""
        self.bus.faults("office", {"seed": seed, "faults": faults})
        try:
            return day(self.link, **{"seed": 1, **settings})
        finally:
            self.bus.faults("office", None)

    def column(self, samples: Sequence[Sample], name: str, raw: str = "values") -> np.ndarray:
        """A point's values, or an actuator's applied ones, of each sample."""
        names = self.actuators if raw == "effective" else self.names
        return np.array([np.frombuffer(getattr(sample, raw))[names.index(name)] for sample in samples])


@pytest.fixture(scope="module")
def stage(module_folder: Path) -> Iterator[Stage]:
    with node_on_bus(module_folder / "n", **SMALL) as (_, bus), bus.controller("office") as link:
        yield Stage(bus, link)


def same(one: Sequence[Sample], other: Sequence[Sample], *names: str) -> bool:
    """Whether these fields agree to the bit in all samples."""
    fields = names or ("step", "time", "elapsed_s", "flags", "values", "effective", "source_index")
    return [[getattr(s, f) for f in fields] for s in one] == [[getattr(s, f) for f in fields] for s in other]


def true(samples: Sequence[Sample], clean: Sequence[Sample]) -> bool:
    """Whether the building went as it does without faults, to the bit."""
    return [s.fault_free_values for s in samples] == [s.values for s in clean] and same(
        samples, clean, "effective", "source_index"
    )


# The undisturbed run


@pytest.mark.slow
def test_fault_injection__empty_plan_leaves_all_as_it_is(scratch: Path, stage: Stage) -> None:
    (scratch / "none.yaml").write_text("seed: 5\nfaults: []\n")
    with (
        node_on_bus(scratch / "n", **SMALL, faults=str(scratch / "none.yaml")) as (_, bus),
        bus.controller("office") as link,
    ):
        assert not link.manifest.faults_injected
        ran = day(link, seed=1)
    assert same(ran, stage.clean)
    assert {s.fault_free_values for s in ran} == {b""}


NEVER = {"probability": 1e-300}


@pytest.mark.slow
def test_fault_injection__windows_that_never_come_leave_all_as_it_is(stage: Stage) -> None:
    ran = stage.faulty(
        {"kind": "bias", "points": "*", "actuators": "*", "offset": 5.0, "when": NEVER},
        {"kind": "drop", "points": "*", "actuators": "*", "when": NEVER},
        {"kind": "delay", "points": "*", "actuators": "*", "steps": 3, "when": NEVER},
        {"kind": "noise", "points": "*", "actuators": "*", "sigma": 1.0, "when": NEVER},
        {"kind": "loss", "samples": True, "commands": "*", "probability": 1.0, "when": NEVER},
    )
    assert same(ran, stage.clean)
    assert [s.fault_free_values for s in ran] == [s.values for s in ran]


@pytest.mark.slow
def test_fault_injection__without_faults_again_nothing_is_left_of_them(stage: Stage) -> None:
    stage.faulty({"kind": "bias", "points": "*", "offset": 1.0})
    assert not stage.bus.manifest("office").faults_injected
    ran = day(stage.link, seed=1)
    assert same(ran, stage.clean)
    assert {s.fault_free_values for s in ran} == {b""}


# Sensors and meters


def test_faults__change_the_planned_values_and_nothing_else(stage: Stage) -> None:
    ran = stage.faulty(
        {"kind": "bias", "points": CORE, "offset": 1.5, "when": {"from_step": 10, "to_step": 20}},
        {"kind": "freeze", "points": NORTH, "when": {"from_step": 30, "to_step": 40}},
        {"kind": "drift", "points": EAST, "rate_per_h": 0.5, "when": {"from_s": 9000.0}},
        {"kind": "quantize", "points": SOUTH, "resolution": 0.5},
        {"kind": "gain", "points": "electricity_facility", "factor": 2.0, "when": {"from_time": "07-03T12:00"}},
    )
    assert true(ran, stage.clean)
    k = np.arange(LAST + 1)
    was = {name: stage.column(stage.clean, name) for name in stage.names}
    meter = was["electricity_facility"]
    expected = was | {
        CORE: np.where((k >= 10) & (k < 20), was[CORE] + 1.5, was[CORE]),
        NORTH: np.where((k >= 30) & (k < 40), was[NORTH][30], was[NORTH]),
        EAST: np.where(k >= 10, was[EAST] + 0.5 * ((k - 10) * 0.25), was[EAST]),
        SOUTH: np.rint(was[SOUTH] / 0.5) * 0.5,
        "electricity_facility": np.where(k >= 48, meter * 2.0, meter),
    }
    for name, values in expected.items():
        assert stage.column(ran, name).tobytes() == values.tobytes(), name


def test_fault_injection__dropped_point_is_nan_in_the_frame_and_silent_by_itself(stage: Stage) -> None:
    steps: list[int] = []

    def on_point(message: Any) -> None:
        steps.append(codec.decode(PointValue, message.payload.to_bytes()).step)

    def wait_for_it(step: int) -> None:  # each message comes before the sample that follows it
        if step == LAST - 1:
            until(lambda: steps and steps[-1] == step, "the single point was told")

    bus = stage.bus
    topic = keys.SENSOR.at("office", name=CORE)
    with bus.session.declare_subscriber(topic, on_point):
        until(lambda: day(stage.link, seed=1) and steps, "the node knows that somebody listens")
        until(lambda: steps[-1] == LAST, "all is heard")
        steps.clear()
        ran = stage.faulty(
            {"kind": "drop", "points": CORE, "when": {"from_step": 10, "to_step": 20}}, between=wait_for_it
        )
        until(lambda: steps[-1] == LAST, "all is heard")
    assert true(ran, stage.clean)
    assert np.flatnonzero(np.isnan(stage.column(ran, CORE))).tolist() == [*range(10, 20)]
    assert steps == [*range(10), *range(20, LAST + 1)]


# Actuators


def test_fault_injection__disturbed_command_is_what_the_building_gets(stage: Stage) -> None:
    ran = stage.faulty({"kind": "bias", "actuators": SETPOINT, "offset": 0.5, "when": {"from_step": 40, "to_step": 60}})
    got = stage.column(ran, SETPOINT, "effective")[1:]
    # The command that answers sample k rules timestep k + 1.
    assert got.tolist() == [command(k) + (0.5 if 40 <= k < 60 else 0.0) for k in range(LAST)]
    truth = [s.fault_free_values for s in ran]
    assert truth[:41] == [s.values for s in stage.clean[:41]]
    assert truth[41:] != [s.values for s in stage.clean[41:]]
    assert [s.values for s in ran] == truth  # no sensor is disturbed


def test_fault_injection__command_that_is_not_heard_leaves_the_former_one_in_force(stage: Stage) -> None:
    ran = stage.faulty({"kind": "drop", "actuators": SETPOINT, "when": {"from_step": 41, "to_step": 50}})
    got = stage.column(ran, SETPOINT, "effective")[1:]
    assert got.tolist() == [command(40 if 41 <= k < 50 else k) for k in range(LAST)]


def test_fault_injection__fault_that_is_set_amid_an_episode_knows_what_was_heard_before(stage: Stage) -> None:
    def cut(step: int) -> None:
        if step == 53:
            stage.bus.faults("office", {"faults": [{"kind": "drop", "actuators": SETPOINT}]})
        elif step == 62:
            stage.bus.faults("office", None)

    assert command(52) == 27.0  # not what the building's own control would set
    got = stage.column(day(stage.link, between=cut, seed=1), SETPOINT, "effective")[1:]
    assert got.tolist() == [command(52 if 53 <= k < 62 else k) for k in range(LAST)]


@pytest.mark.parametrize("place", ["snapshot", "branch"])
def test_fault_injection__fault_after_a_snapshot_or_in_a_branch_knows_what_was_heard_before(
    stage: Stage, place: str
) -> None:
    sample = stage.link.reset(seed=1)
    for step in range(53):
        sample.send({SETPOINT: command(step)})
        sample = stage.link.receive()
    drop = {"faults": [{"kind": "drop", "actuators": SETPOINT}]}
    if place == "branch":
        name = stage.bus.branch("office", CreateBranch())
        stage.bus.faults(name, drop)
        with stage.bus.controller(name) as link:
            link.current().send({SETPOINT: 23.0})
            effective = stage.column([link.receive().message], SETPOINT, "effective")
        stage.bus.stop(name)
    else:
        snapshot = stage.bus.snapshot("office").snapshot
        for _ in range(2):
            sample.send({SETPOINT: 24.0})
            sample = stage.link.receive()
        sample = stage.link.reset(snapshot=snapshot)
        stage.bus.faults("office", drop)
        sample.send({SETPOINT: 23.0})
        effective = stage.column([stage.link.receive().message], SETPOINT, "effective")
        stage.bus.faults("office", None)
    assert effective.tolist() == [command(52)] == [27.0]
    day(stage.link)  # the next test begins after an episode


# What is told, and requests


def test_events__report_when_a_fault_begins_and_ends(stage: Stage) -> None:
    reported: list[Event] = []

    def on_event(message: Any) -> None:
        reported.append(codec.decode(Event, message.payload.to_bytes()))

    with stage.bus.session.declare_subscriber(keys.EVENT.at("office"), on_event):
        stage.faulty(
            {"name": "sun", "kind": "bias", "points": CORE, "offset": 1.0, "when": {"hours": [6.0, 8.0]}},
            {"name": "radio", "kind": "latency", "samples": True, "delay_ms": 0.1, "when": {"from_step": 90}},
        )
        until(lambda: reported and reported[-1].text == "faults are set: none", "all is heard")
    assert [(e.text, e.step) for e in reported if e.kind is EventKind.FAULT] == [
        ("faults are set: sun, radio", LAST),
        ("sun begins", 24),
        ("sun ends", 32),
        ("radio begins", 90),
        ("faults are set: none", LAST),
    ]


def test_fault_injection__faults_are_set_and_ended_while_it_runs(stage: Stage) -> None:
    seen = {}

    def change(step: int) -> None:
        if step == 10:
            stage.bus.faults("office", {"faults": [{"kind": "stuck", "points": CORE, "value": 50.0}]})
            seen["manifest"] = stage.bus.manifest("office").faults_injected
        elif step == 15:
            seen["on"] = stage.bus.status("office").faults
            stage.bus.faults("office", None)

    ran = day(stage.link, between=change, seed=1)
    assert seen == {"manifest": True, "on": ["stuck 1"]}
    assert np.flatnonzero(stage.column(ran, CORE) == 50.0).tolist() == [*range(11, 16)]
    assert [bool(s.fault_free_values) for s in ran] == [11 <= k < 16 for k in range(LAST + 1)]
    assert same(ran, stage.clean, "effective", "source_index")


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"kind": "bias", "points": "core_zn_air_temprature", "offset": 1.0}, "no sensor or meter .*core_zn_air_temp"),
        ({"kind": "stuck", "actuators": SETPOINT, "value": 99.0}, "cannot be stuck at 99"),
        ({"kind": "drop", "points": "*", "when": {"from_step": 97}}, "is never active"),
        ({"kind": "bios", "points": "*"}, "no kind 'bios'.*'bias'"),
        ({"kind": "noise", "points": "*", "sigma": -1.0}, "sigma.*greater than 0"),
    ],
)
def test_fault_injection__plan_that_cannot_be_is_refused_and_changes_nothing(
    stage: Stage, fault: dict[str, Any], words: str
) -> None:
    stage.bus.faults("office", {"faults": [{"name": "stays", "kind": "drop", "points": CORE}]})
    stage.link.reset(seed=1)
    with pytest.raises(InvalidConfig, match=words):
        stage.bus.faults("office", {"faults": [fault]})
    assert stage.bus.status("office").faults == ["stays"]
    stage.bus.faults("office", None)


# Chance

NOISE = {"kind": "noise", "points": "*_air_temperature", "sigma": 0.3}
BURST = {"kind": "bias", "points": CORE, "offset": 2.0, "when": {"probability": 0.2, "lasts_steps": 3}}


@pytest.mark.slow
def test_fault_injection__same_seed_gives_the_same_faults(stage: Stage) -> None:
    ran = stage.faulty(NOISE, BURST, seed=7)
    again = stage.faulty(NOISE, BURST, seed=7)
    assert same(ran, again)
    assert true(ran, stage.clean)
    assert not same(ran, stage.faulty(NOISE, BURST, seed=8), "values")
    noise = stage.column(ran, NORTH) - stage.column(stage.clean, NORTH)
    assert 0.5 * 0.3 < noise.std() < 1.5 * 0.3  # of 97 numbers; six standard deviations


@pytest.mark.slow
def test_fault_injection__episode_without_a_seed_has_faults_of_its_own(stage: Stage) -> None:
    stage.bus.faults("office", {"seed": 7, "faults": [NOISE]})
    first, second = day(stage.link, seed=1), day(stage.link)
    third, fourth = day(stage.link, seed=1), day(stage.link)
    stage.bus.faults("office", None)
    assert same(first, third)
    assert same(second, fourth)
    assert not same(first, second, "values")


@pytest.mark.slow
def test_fault_injection__branch_and_a_snapshot_meet_the_same_faults(scratch: Path) -> None:
    plan_file = scratch / "faults.yaml"
    freeze = {"kind": "freeze", "points": EAST, "when": {"from_step": 15, "to_step": 25}}
    delay = {"kind": "delay", "points": SOUTH, "actuators": "*", "steps": 2}
    plan_file.write_text(yaml.safe_dump({"seed": 3, "faults": [NOISE, BURST, freeze, delay]}))
    env: Any = building(scratch, faults=plan_file, disable_env_checker=True)  # NaN is in no space
    try:
        env.reset(seed=4)
        steps = np.random.default_rng(0)
        actions = [
            env.action_space.low + (env.action_space.high - env.action_space.low) * steps.random() for _ in range(40)
        ]
        for action in actions[:20]:
            env.step(action)
        with env.unwrapped.snapshot() as snapshot, env.unwrapped.branch() as branch:
            parent_steps = [env.step(action) for action in actions[20:]]
            beside = [branch.step(action) for action in actions[20:]]
            env.reset(options={"snapshot": snapshot})
            back = [env.step(action) for action in actions[20:]]
        for other in (beside, back):
            assert [s[0].tobytes() for s in other] == [s[0].tobytes() for s in parent_steps]
            assert [s[-1]["fault_free_values"].tobytes() for s in other] == [
                s[-1]["fault_free_values"].tobytes() for s in parent_steps
            ]
            assert [s[1] for s in other] == [s[1] for s in parent_steps]
        assert parent_steps[0][0].tobytes() != parent_steps[0][-1]["fault_free_values"].astype(np.float32).tobytes()
    finally:
        env.close()


def test_fault_injection__messages_after_a_snapshot_meet_the_same_faults_of_the_link() -> None:
    planned = plan(read_config(SMALL))
    faults = FaultPlan.model_validate({"seed": 1, "faults": [{"kind": "loss", "samples": True, "probability": 0.5}]})
    values = bytes(8 * (len(planned.points.sensors) + len(planned.points.meters)))

    def delays(injection: FaultInjection, first: int, last: int) -> list[list[float]]:
        drawn = []
        for step in range(first, last):
            injection.apply_to_sensors(values, [step])
            drawn.append(injection.link.outgoing(0.0))
        return drawn

    parent, branch = FaultInjection(faults, describe(planned), 1), FaultInjection(faults, describe(planned), 1)
    delays(parent, 0, 21)
    branch.restore(parent.state(), 0)
    delays(branch, 20, 21)  # a branch says the sample at which it stands
    parent_delays = delays(parent, 21, LAST + 1)
    assert delays(branch, 21, LAST + 1) == parent_delays
    assert [] in parent_delays
    assert [0.0] in parent_delays


# The link


@pytest.mark.slow
def test_fault_injection__lost_samples_are_missing_when_free(episode_bus: Bus) -> None:
    bus = episode_bus
    faults = {"seed": 2, "faults": [{"kind": "loss", "samples": True, "probability": 0.3, "when": {"to_step": LAST}}]}
    with bus.listen("office") as samples:
        bus.faults("office", faults)
        bus.pace("office", mode="free")
        received = [next(samples)]
        while not received[-1].truncated:
            received.append(next(samples))
    expected = LinkFaults(FaultPlan.model_validate(faults), step_s=900.0, begin=datetime(2017, 7, 3))
    arrive = []
    for step in range(1, LAST + 1):
        expected.move(step)
        arrive += [step] * len(expected.outgoing(0.0))
    assert [s.step for s in received] == arrive
    assert 20 < LAST - len(arrive) < 40
    bus.faults("office", None)


@pytest.mark.slow
def test_fault_injection__delayed_samples_come_later_when_paced(episode_bus: Bus) -> None:
    bus = episode_bus
    bus.faults("office", {"faults": [{"kind": "latency", "samples": True, "delay_ms": 400.0}]})
    with bus.listen("office") as samples:
        asked_s = time.monotonic()
        bus.pace("office", 90_000.0)  # 10 ms a timestep
        arrivals = [(next(samples).step, time.monotonic()) for _ in range(20)]
    assert [step for step, _ in arrivals] == [*range(1, 21)]
    assert all(now_s >= asked_s + 0.01 * step + 0.4 for step, now_s in arrivals)


def test_fault_injection__duplicates_do_not_disturb_a_controller(stage: Stage) -> None:
    before = stage.bus.status("office")
    ran = stage.faulty({"kind": "duplicate", "samples": True, "commands": "*", "probability": 1.0})
    after = stage.bus.status("office")
    assert true(ran, stage.clean)
    assert same(ran, stage.clean)
    assert (after.duplicate - before.duplicate, after.accepted - before.accepted) == (LAST, LAST)
    assert (after.late, after.rejected) == (before.late, before.rejected)


@pytest.mark.parametrize(
    ("settings", "warned"),
    [
        ({}, True),
        ({"deadline_s": 0.5}, True),
        ({"policy": "hold"}, True),
        ({"deadline_s": 0.5, "policy": "hold"}, False),
        ({"mode": "free"}, False),
    ],
)
def test_plan_that_loses_awaited_messages__warns(scratch: Path, settings: dict[str, Any], warned: bool) -> None:
    file = scratch / "faults.yaml"
    file.write_text(yaml.safe_dump({"faults": [{"kind": "loss", "samples": True, "probability": 0.5}]}))
    warning_texts = plan(read_config({**SMALL, "faults": str(file), **settings})).warnings
    assert [("loses messages" in text) for text in warning_texts] == [True] * warned


@pytest.mark.slow
def test_fault_injection__lockstep_with_lost_commands_goes_on_by_its_deadline(scratch: Path) -> None:
    cut = {"kind": "loss", "commands": "*", "probability": 1.0, "when": {"from_step": 20, "to_step": 30}}
    (scratch / "faults.yaml").write_text(yaml.safe_dump({"faults": [cut]}))
    settings = SMALL | {"faults": str(scratch / "faults.yaml"), "policy": "hold", "deadline_s": 1.0}
    with node_on_bus(scratch / "n", **settings) as (_, bus), bus.controller("office") as link:
        ran = day(link)
        missed = bus.status("office").statistics.missed
        index = [a.name for a in link.manifest.actuators].index(SETPOINT)
    fell = [k for k, s in enumerate(ran) if s.flags[0] & Flag.FALLBACK]
    assert set(range(21, 31)) <= set(fell)
    assert missed == len(fell)
    got = [np.frombuffer(s.effective)[index] for s in ran[1:]]
    assert got[20:30] == [command(19)] * 10
    assert [s.step for s in ran] == [[k] for k in range(LAST + 1)]


# Environments


def building(folder: Path, **settings: Any) -> gym.Env[Any, Any]:
    """The small building for a day."""
    return gym.make(
        "zenostat/Building-v1",
        building="ref-small-office", weather=WEATHER, begin="07-03", end="07-03", steps_per_hour=4,
        actuators={"cooling": ("Zone Temperature Control", "Cooling Setpoint", "Core_ZN")},
        reward="linear", affinity="off", **settings,
    )  # fmt: skip


@pytest.mark.slow
def test_agent__observes_faulty_values_and_is_rewarded_by_fault_free_ones(scratch: Path) -> None:
    file = scratch / "faults.yaml"
    file.write_text(yaml.safe_dump({"faults": [{"kind": "bias", "points": "*_air_temperature", "offset": 10.0}]}))
    ran = {}
    for name, faults in (("clean", None), ("faulty", file)):
        env: Any = building(scratch, faults=faults)
        try:
            first, info = env.reset(seed=0)
            ran[name] = [(first, 0.0, False, False, info)]
            ran[name] += [env.step(env.action_space.high) for _ in range(40)]
            columns = [n.endswith("_air_temperature") for n in env.unwrapped.observation_names]
            tail = len(env.unwrapped.manifest.names)
        finally:
            env.close()
    assert any(columns)
    assert any(step[1] != 0.0 for step in ran["clean"])
    for clean, faulty in zip(ran["clean"], ran["faulty"], strict=True):
        assert "fault_free_values" not in clean[-1]
        truth = faulty[-1]["fault_free_values"]
        assert truth.astype(np.float32).tobytes() == clean[0][-tail:].tobytes()
        assert faulty[1] == clean[1]
        expected = np.where(columns[-tail:], truth + 10.0, truth).astype(np.float32)
        assert faulty[0][-tail:].tobytes() == expected.tobytes()
        assert faulty[0][:-tail].tobytes() == clean[0][:-tail].tobytes()


def test_evaluate__faults_of_actuators_act_under_baseline_control_too(tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text("faults: [{kind: stuck, actuators: core_zn_cooling_setpoint, value: 30.0}]\n")
    scenario = {**SMALL, "affinity": "off"}
    evaluation = evaluate({**scenario, "faults": plan}, ["baseline"], seed=1)
    plain = evaluate(scenario, ["baseline"], seed=1)
    stuck, free = (each.rows[0].result.hvac_electricity_kwh for each in (evaluation, plain))
    assert stuck is not None
    assert free is not None
    assert stuck < free  # the core is not cooled below 30 degC
