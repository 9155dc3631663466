"""Trial steps: the samples that commands would give, from copies of the plant that then end."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray
from support.engine_forks import FOUR, Faults, engines, make
from support.in_process_plant import COPIES
from support.nodes import NodeProgram, Program, hosts_of, node_on_bus, programs_of, until
from support.rooms_plant import FATAL

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.bridge.client.bus import Bus
from zenostat.topics import codec, keys
from zenostat.topics.errors import (
    BadMessage,
    EngineDied,
    EpisodeChanged,
    ForkFailed,
    InvalidAction,
    InvalidConfig,
    NodeNotFound,
    PlantFailed,
    RequestRejected,
    SimulatorError,
)
from zenostat.topics.messages import StepsTried, TrySteps

TESTS = Path(__file__).parents[1]
COOLING = "core_zn_cooling_setpoint"


@pytest.fixture(scope="module")
def office(module_scratch: Path) -> Iterator[BuildingEnv]:
    env = make(**FOUR)
    env.reset(seed=0)
    yield env
    env.close()


def actions_of(env: BuildingEnv, *shape: int, seed: int = 3) -> NDArray[np.float32]:
    space = env.action_space
    assert isinstance(space, gym.spaces.Box)
    return np.random.default_rng(seed).uniform(space.low, space.high, (*shape, *space.shape)).astype(np.float32)


def raw(samples: Any) -> list[bytes]:
    return [codec.encode(sample.message) for sample in samples]


def forks_of(env: BuildingEnv) -> int:
    """Number of the engines that are not the node's own."""
    return len(engines(env)) - 2  # one waits at sample 0


# To the bit


@pytest.mark.slow
def test_trial__equals_the_step_throughout_an_episode(office: BuildingEnv) -> None:
    """At sample 0, in the middle, and at the end, which the sample of a trial has as well."""
    office.reset(seed=0)
    last = office.manifest.steps
    for step in range(last):
        alternatives = actions_of(office, 3, seed=step)
        if step in (0, 1, last // 2, last - 1):
            tried = office.try_step(alternatives)
            office.step(alternatives[1])
            assert raw(tried)[1] == codec.encode(office.sample.message)
            assert len({sample.message.commanded for sample in tried}) == 3
            assert tried[1].truncated == (step == last - 1)
        else:
            office.step(alternatives[0])
    with pytest.raises(EpisodeChanged, match="no episode is running"):
        office.try_step(alternatives)
    with pytest.raises(RequestRejected, match="nothing to try: the episode is over"):
        office.link.bus.try_step("building", [{}])
    office.reset(seed=0)


def test_trial__sequences_equal_steps_and_end_with_the_episode(office: BuildingEnv) -> None:
    office.reset(seed=0)
    for action in actions_of(office, office.manifest.steps - 3):
        office.step(action)
    sequences = actions_of(office, 9, 5)
    tried = office.try_steps(sequences)
    assert [len(samples) for samples in tried] == [3] * 9
    assert raw(office.try_steps(sequences[8:])[0]) == raw(tried[8])
    for number in range(3):
        office.step(sequences[4, number])
        assert raw(tried[4])[number] == codec.encode(office.sample.message)
    assert tried[4][2].truncated
    office.reset(seed=0)


def test_trial__has_faults_and_writes(office: BuildingEnv) -> None:
    """A noisy sensor, a stuck actuator and an operator's value that expires in the second timestep."""
    office.reset(seed=0)
    office.step(actions_of(office, 1)[0])
    bus, zones = office.link.bus, office.manifest
    noise = {"name": "noise", "kind": "noise", "points": zones.sensors[0].name, "sigma": 0.5}
    stuck = {"name": "stuck", "kind": "freeze", "actuators": zones.actuators[-1].name}
    bus.faults("building", {"seed": 1, "faults": [noise, stuck]})
    try:
        bus.write("building", COOLING, 29.0, priority=4, duration_s=900.0)
        sequences = actions_of(office, 2, 3)
        tried = office.try_steps(sequences)
        for number in range(3):
            office.step(sequences[1, number])
            assert raw(tried[1])[number] == codec.encode(office.sample.message)
    finally:
        bus.faults("building", None)
    at = [actuator.name for actuator in zones.actuators].index(COOLING)
    commanded = [np.frombuffer(sample.message.commanded)[at] for sample in tried[1]]
    assert commanded == [29.0, sequences[1, 1, -1], sequences[1, 2, -1]]
    assert tried[1][0].message.fault_free_values


def test_trial__of_a_branch(office: BuildingEnv) -> None:
    office.reset(seed=0)
    actions = actions_of(office, 2)
    expected = office.try_step(actions)
    with office.branch() as branch:
        tried = branch.try_step(actions)
        branch.step(actions[1])
        assert raw(tried)[1] == codec.encode(branch.sample.message)
    assert [sample.message.values for sample in tried] == [sample.message.values for sample in expected]


# On the bus


def test_trial__needs_no_claim(office: BuildingEnv) -> None:
    """A guest's command acts at its priority: above the agent's it wins, below it has no effect."""
    office.reset(seed=0)
    office.step(actions_of(office, 1)[0])
    bus = office.link.bus
    held = float(office.sample.message.commanded and np.frombuffer(office.sample.message.commanded)[-1])
    names = [actuator.name for actuator in office.manifest.actuators]
    for priority, expected in ((3, 28.5), (12, held)):
        (sample,) = bus.try_step("building", [{names[-1]: 28.5}], name="guest", priority=priority)
        assert np.frombuffer(sample.message.commanded)[-1] == expected
        assert sample.step == office.sample.step + 1
    status = bus.status("building")
    assert [c.controller for c in status.controllers] == [office.link.name]
    assert (status.snapshots, status.branches, status.rejected) == ([], [], 0)
    (mine,) = office.link.try_step([{names[-1]: 28.5}])
    assert mine.value_source[names[-1]] == office.link.name


def test_trial__bad_requests(office: BuildingEnv) -> None:
    """Each is one error, before anything is simulated, and the node counts none of them."""
    office.reset(seed=0)
    bus, link = office.link.bus, office.link
    count = len(office.manifest.actuators)
    before = bus.latest("building")
    for bad, error, text in (
        ([{"attic": 20.0}], InvalidAction, "alternative 0, timestep 0: no actuator 'attic'"),
        ([{}, {COOLING: float("nan")}], InvalidAction, "alternative 1, timestep 0: .*nan"),
        ([np.full(count, np.nan)], InvalidAction, "alternative 0.*not finite"),
        ([np.zeros(count + 1)], InvalidAction, "alternative 0.* values of shape"),
        ([{COOLING: 99.0}], RequestRejected, f"alternative 0, timestep 0: {COOLING} = 99"),
        ([], InvalidConfig, "alternatives.* greater than or equal to 1"),
        ([{}] * 257, InvalidConfig, "alternatives.* less than or equal to 256"),
    ):
        for ask in (link.try_step, lambda commands: bus.try_step("building", commands)):
            with pytest.raises(error, match=text):
                ask(bad)
    for sequences, text in (
        ([[{}], [{}, {}]], "alternatives of 1 to 2 timesteps"),
        ([[]], "timesteps.* greater than or equal to 1"),
        ([[{}] * 2001], "timesteps.* less than or equal to 2000"),
    ):
        with pytest.raises(InvalidConfig, match=text):
            link.try_steps(sequences)
    with pytest.raises(RequestRejected, match="200 alternatives of 11 timesteps; a reply has room for"):
        link.try_steps([[{}] * 11] * 200)
    with pytest.raises(NodeNotFound):
        bus.try_step("attic", [{}])
    with pytest.raises(InvalidConfig, match="sender's name"):
        bus.try_step("building", [{}], name="a/b")
    row = bytes(8 * count)
    for fields, text in (
        ({"values": row[8:]}, rf"values has {8 * count - 8} bytes; {8 * count} expected"),
        ({"values": row, "operations": b"\1"}, "operations has 1 bytes"),
        ({"values": row, "operations": b"\7" * count}, "operations has 7"),
        ({"values": row, "step": [5]}, r"tries from step \[5\]; the present step is \[0\]"),
        ({"values": row, "episode": [99]}, r"tries from episode \[99\]"),
    ):
        with pytest.raises(RequestRejected, match=text):
            bus.ask(keys.TRY, "building", TrySteps(controller="guest", alternatives=1, **fields), StepsTried)
    assert bus.latest("building") == before
    assert bus.status("building").rejected == 0


def test_trial__bad_actions(office: BuildingEnv) -> None:
    office.reset(seed=0)
    good = actions_of(office, 2)
    bad = good.copy()
    bad[1, 0] = 99.0
    with pytest.raises(InvalidAction, match=r"alternative 1, timestep 0: .* = 99"):
        office.try_step(bad)
    for wrong in (good[0], good[:0], good[:, :1], 3.0):
        with pytest.raises(InvalidAction, match="shape"):
            office.try_step(wrong)
    bad[1, 0] = np.nan
    with pytest.raises(InvalidAction, match="alternative 1"):
        office.try_step(bad)


def test_request__larger_than_a_message_is_refused_at_once(office: BuildingEnv) -> None:
    """Zenoh drops what is larger than four such messages, so nobody would answer."""
    bus = office.link.bus
    for size in (codec.MAX_BYTES, 5 * codec.MAX_BYTES):
        request = TrySteps(alternatives=1, values=bytes(size))
        with pytest.raises(BadMessage, match=f"rpc/try/.* bytes; at most {codec.MAX_BYTES} are sent"):
            bus.trial("building", request)


# Failures


@pytest.mark.slow
def test_trial__engine_that_dies_takes_its_trial_only(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    faults = Faults(scratch, monkeypatch)
    env = make(**FOUR)
    try:
        env.reset(seed=0)
        actions = actions_of(env, 3)
        env.step(actions[0])
        expected = raw(env.try_step(actions))
        for what, error in ((Faults.CHILD_DIES, EngineDied), (Faults.NO_MEMORY, ForkFailed)):
            faults.set(what)
            with pytest.raises(error, match=r"^trial from step 1: "):
                env.try_step(actions)
            faults.clear()
            assert raw(env.try_step(actions)) == expected
        until(lambda: not forks_of(env), "the copies have ended")
        env.step(actions[2])
        assert codec.encode(env.sample.message) == expected[2]
    finally:
        env.close()


@pytest.mark.slow
def test_trial__plant_in_the_nodes_process(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is copied by assignment; one that fails in a trial is as it was, and each copy is closed."""
    copies = scratch / "copies"
    copies.mkdir()
    monkeypatch.setenv(COPIES, str(copies))
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}{os.pathsep}{TESTS.parent}")
    plain = {"module": "support.in_process_plant", "steps": 20}
    with node_on_bus(scratch / "a", **plain) as (_, bus), bus.controller("office") as link:
        link.reset(seed=4)
        tried = link.try_steps([[{"command": float(k)}, {"command": 2.0 * k}] for k in range(20)])
        assert [[s["measured"] for s in samples] for samples in tried] == [[k, 2.0 * k] for k in range(20)]
        with pytest.raises(PlantFailed, match=r"^trial from step 0: the command 1313 broke the plant$"):
            link.try_step([{"command": 1.0}, {"command": 1313.0}])
        assert not [*copies.iterdir()]
        link.send({"command": 3.0})
        assert link.receive()["measured"] == 3.0
    rooms = {"module": "support.rooms_plant", "slots": 2}
    with node_on_bus(scratch / "b", **rooms) as (_, bus), bus.controller("office") as link:
        link.reset(seed=4)
        row = np.array([[1.0, 2.0], [3.0, 4.0]])
        with pytest.raises(PlantFailed, match="the heater broke"):
            link.try_step([row, np.full((2, 2), FATAL)])
        (tried_sample,) = link.try_step([row])
        link.send(row)
        assert codec.encode(link.receive().message) == codec.encode(tried_sample.message)


def test_trial__plant_that_cannot_be_copied(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}{os.pathsep}{TESTS.parent}")
    plain = {"module": "support.in_process_plant", "steps": 20}
    with node_on_bus(scratch / "a", **plain) as (_, bus), bus.controller("office") as link:
        link.reset(seed=4)
        with pytest.raises(ForkFailed, match=r"^trial from step 0: this plant cannot be copied$"):
            link.try_step([{}])


CLASS = """
import os, signal, time

class Tank:
    step_s = 60.0
    duration_s = 6000.0
    sensors = {"level": "m"}
    actuators = {"valve": ("1", 0.0, 9.0, 0.0)}
    forkable = True

    def reset(self, seed):
        self.level = float(seed)
        return {"level": self.level}

    def step(self, commands):
        if commands["valve"] == 9.0:
            os.kill(os.getpid(), signal.SIGKILL)
        if commands["valve"] == 8.0:
            raise RuntimeError("the valve is stuck")
        if commands["valve"] == 7.0:
            time.sleep(1e6)
        self.level += commands["valve"]
        return {"level": self.level}
"""


@pytest.fixture
def tank(scratch: Path, request: pytest.FixtureRequest) -> Iterator[tuple[NodeProgram, Bus]]:
    """A node of the class, which kills a copy that hangs after a second, or after the parameter, in s."""
    file = scratch / "tank.py"
    file.write_text(CLASS)
    limit_s = getattr(request, "param", 1.0)
    with node_on_bus(scratch / "node", plant=f"{file}:Tank", unresponsive_s=limit_s) as pair:
        yield pair


@pytest.mark.slow
def test_trial__class_that_fails_takes_its_trial_only(tank: tuple[NodeProgram, Bus]) -> None:
    node, bus = tank
    with bus.controller("office") as link:
        link.reset(seed=5)
        for valve, error, text in (
            (9.0, EngineDied, "SIGKILL"),
            (8.0, PlantFailed, "the valve is stuck"),
            (7.0, SimulatorError, "neither answered nor used processor time"),
        ):
            with pytest.raises(error, match=rf"^trial from step 0: (.|\n)*{text}"):
                link.try_step([{"valve": 1.0}, {"valve": valve}, {"valve": 2.0}])
        tried = link.try_step([{"valve": 1.0}, {"valve": 2.0}])
        assert [sample["level"] for sample in tried] == [6.0, 7.0]
        link.send({"valve": 2.0})
        assert codec.encode(link.receive().message) == codec.encode(tried[1].message)
        until(lambda: len(hosts_of(node.pid)) == 1, "the copies have ended")


HANGING = """
import sys, zenostat
with zenostat.connect(sys.argv[1], affinity="off") as bus:
    print("trying")
    bus.try_step("office", [{"valve": 1.0}, {"valve": 7.0}])
"""


@pytest.mark.slow
@pytest.mark.parametrize("tank", [10.0], indirect=True)  # so that the copies are seen on a loaded machine
def test_trial__requester_is_killed_in_the_middle(tank: tuple[NodeProgram, Bus]) -> None:
    """The copy that hangs is killed in time, and the node answers the next request."""
    node, bus = tank
    with bus.controller("office") as link:
        link.reset(seed=5)
        with Program(HANGING, node.endpoint) as program:
            assert program.line() == "trying"
            until(lambda: len(hosts_of(node.pid)) == 3, "the trial has begun")
            program.process.kill()
        (sample,) = link.try_step([{"valve": 2.0}])
        assert sample["level"] == 7.0
        until(lambda: len(hosts_of(node.pid)) == 1, "the copies have ended")
        until(lambda: not [*(node.folder / "run").rglob("trials/*")], "their files are removed")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("end", ["stop", "kill"])
def test_trial__node_ends_in_the_middle(scratch: Path, end: str) -> None:
    """Nothing is left of it: a stop request interrupts the trial, and the copies of a killed node end with it."""
    file = scratch / "tank.py"
    file.write_text(CLASS)
    with node_on_bus(scratch / "node", plant=f"{file}:Tank", unresponsive_s=600.0) as (node, bus):
        bus.controller("office").reset(seed=5)
        with Program(HANGING, node.endpoint) as program:
            assert program.line() == "trying"
            until(lambda: len(hosts_of(node.pid)) == 3, "the trial has begun")
            if end == "stop":
                bus.stop("office")
                assert node.process.wait() == 0
            else:
                node.kill()
            program.process.wait()
            reason = program.process.stderr.read()
        assert re.search(r"(EngineDied|NodeLost): .*(the node ends|node 'office' is gone)", reason)
    until(lambda: not programs_of(scratch), "all processes have ended")


@pytest.mark.slow
def test_trial__reset_ends_a_trial_that_hangs(scratch: Path) -> None:
    file = scratch / "tank.py"
    file.write_text(CLASS.replace("time.sleep(1e6)", "exec('while True: pass')"))
    settings = {"plant": f"{file}:Tank", "unresponsive_s": 1.0}
    with node_on_bus(scratch / "node", **settings) as (node, bus), bus.controller("office") as link:
        link.reset(seed=5)
        with Program(HANGING, node.endpoint) as program:
            assert program.line() == "trying"
            until(lambda: len(hosts_of(node.pid)) == 3, "the trial has begun")
            assert link.reset(seed=6)["level"] == 6.0
            program.process.wait()
            assert "a reset had waited for 1 s for the end of a trial" in program.process.stderr.read()
