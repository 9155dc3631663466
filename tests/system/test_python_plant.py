"""A Python class as a plant, in real processes: exact, repeatable, copied to the bit, and named when it fails."""

import json
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from math import nan
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray
from support.nodes import NodeProgram, hosts_of, node_on_bus, nothing_left, runs, until

import zenostat
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.bridge.client.trials import trial_message
from zenostat.bridge.python_plant.class_plan import plan_class
from zenostat.bridge.python_plant.node import read_settings
from zenostat.bridge.python_plant.plant import PythonEngines
from zenostat.topics.errors import (
    BusError,
    EngineDied,
    EngineUnresponsive,
    ForkFailed,
    InvalidConfig,
    PlantFailed,
    RequestRejected,
    SimulatorError,
    ZenostatError,
)
from zenostat.topics.messages import CreateBranch, State

TANK = '''
import os, random, signal, sys, threading, time
from helper import LOSS

class Tank:
    """A tank with a heater, a valve, and deeds that no plant should do."""

    step_s = 60.0
    duration_s = 600.0
    sensors = {"temperature": ("degC", 0.0, 100.0), "noise": "1"}
    meters = {"electricity": "J"}
    actuators = {"heater": ("W", 0.0, 3000.0), "valve": ("1", 0.0, 1.0, 0.25), "deed": ("1", 0.0, 22.0)}

    def __init__(self, loss=LOSS, deed=""):
        self.loss = loss
        self.do(deed)

    def reset(self, seed):
        self.random = random.Random(seed)
        self.temperature = 20.0
        if seed == 13:
            raise ValueError("thirteen")
        return {"temperature": self.temperature, "noise": self.random.random(), "electricity": 0.0}

    def step(self, commands):
        heat = commands.get("heater", 0.0)
        self.temperature += heat / 1000.0 - commands["valve"] - self.loss * (self.temperature - 20.0)
        values = {"temperature": self.temperature, "noise": self.random.random(), "electricity": heat * 60.0}
        return self.do(DEEDS[int(commands.get("deed", 0.0))], values)

    def do(self, deed, values=None):
        if deed == "raise":
            self.cool()
        if deed == "exit":
            sys.exit("enough")
        if deed == "interrupt":
            raise KeyboardInterrupt
        if deed == "leave":
            os._exit(3)
        if deed == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if deed == "hang":
            time.sleep(1e6)
        if deed == "compute":
            until_s = time.process_time() + 2.5
            while time.process_time() < until_s:
                pass
        while deed == "compute for ever":
            pass
        if deed == "print":
            print("printed by the tank")
            print("logged by the tank", file=sys.stderr)
        if deed == "thread":
            threading.Thread(target=time.sleep, args=(1e6,), daemon=True).start()
        if deed == "keep":
            self.kept = threading.Lock()
        if deed == "keep unreadable":
            self.kept = Unreadable()
        if deed == "break":
            self.broken = True
        if deed in WRONG:
            values["temperature"] = WRONG[deed]
        if deed == "missing":
            del values["temperature"]
        if deed == "unknown":
            values["temprature"] = 0.0
        return [1.0] if deed == "list" else values

    def cool(self):
        raise RuntimeError("the tank leaks")

    def save(self):
        return self.__dict__

    def restore(self, state):
        if "broken" in state:
            self.cool()
        self.__dict__.update(state)

WRONG = {"nan": float("nan"), "inf": float("inf"), "text": "20.0", "none": None, "huge": 10**400}
DEEDS = ["", "raise", "exit", "leave", "kill", "hang", "compute", "print", "thread", "keep", "break", *WRONG]
DEEDS += ["compute for ever"]
DEEDS += ["missing", "unknown", "list", "keep unreadable", "interrupt"]

class Unreadable:
    def __reduce__(self):
        return int, ("no number",)

class Forkable(Tank):
    forkable = True
    save = restore = None

class Neither(Tank):
    save = restore = None

class HangingSave(Tank):
    def save(self):
        time.sleep(1e6)

class HangingRestore(Tank):
    def restore(self, state):
        time.sleep(1e6)

class NoActuators(Neither):
    actuators = {}
    step_s = 0.1
    duration_s = 1.0

    def step(self, commands):
        return super().step({"valve": 0.25})

class Daily(Tank):
    step_s = 86400.0
    duration_s = 10 * 86400.0
'''
DEEDS = ["", "raise", "exit", "leave", "kill", "hang", "compute", "print", "thread", "keep", "break"]
DEEDS += [
    "nan",
    "inf",
    "text",
    "none",
    "huge",
    "compute for ever",
    "missing",
    "unknown",
    "list",
    "keep unreadable",
    "interrupt",
]
SOON = {"unresponsive_s": 2.0}


@pytest.fixture(scope="module")
def tank(module_folder: Path) -> Path:
    """The file of the class; beside it modules of the user's with the names of the product's packages."""
    folder = module_folder / "mine"
    folder.mkdir()
    (folder / "tank.py").write_text(TANK)
    (folder / "helper.py").write_text("from models import LOSS\n")
    (folder / "models.py").write_text("LOSS = 0.125\n")
    for name in ("bridge", "topics"):
        (folder / f"{name}.py").write_text("raise AssertionError\n")
    return folder / "tank.py"


@pytest.fixture(scope="module")
def own(module_folder: Path, tank: Path) -> Iterator[BuildingEnv]:
    """An environment whose plant is the tank, for all tests that reset it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(module_folder))
        patch.setattr("tempfile.tempdir", None)
        with nothing_left(module_folder):
            yield from plant_env(f"{tank}:Tank")


@pytest.fixture(scope="module")
def forkable(own: BuildingEnv, tank: Path) -> Iterator[BuildingEnv]:
    """One whose plant is copied by a fork."""
    yield from plant_env(f"{tank}:Forkable")


def plant_env(plant: str, **settings: Any) -> Iterator[BuildingEnv]:
    with gym.make("zenostat/Plant-v1", plant=plant, reward=None, affinity="off", **SOON | settings) as env:
        yield env.unwrapped


def action(heater: float = 0.0, valve: float = 0.25, deed: str = "") -> NDArray[np.float32]:
    return np.array([heater, valve, DEEDS.index(deed)], np.float32)


def trajectory(env: BuildingEnv, steps: int = 10) -> list[bytes]:
    """Return the tank's measurements in the next timesteps, with commands that depend on the step only."""
    seen = []
    for _ in range(steps):
        step = env.sample.step
        env.step(action(heater=100.0 * (step + 1), valve=step / 16.0))
        seen.append(env.sample.values.tobytes())
    return seen


def calculated(seed: int, steps: int, loss: float = 0.125) -> list[bytes]:
    """Return the tank's trajectory by its own equations, without the product."""
    draws = random.Random(seed)
    draws.random()
    temperature, seen = 20.0, []
    for step in range(steps):
        heat = 100.0 * (step + 1)
        temperature += heat / 1000.0 - step / 16.0 - loss * (temperature - 20.0)
        seen.append(np.array([temperature, draws.random(), heat * 60.0]).tobytes())
    return seen


# Trajectories


@pytest.mark.slow
def test_python_plant__episode_is_what_the_class_computes_to_the_bit(own: BuildingEnv) -> None:
    _, info = own.reset(seed=7)
    assert own.sample.values.tolist() == [20.0, random.Random(7).random(), 0.0]
    assert (info["time"], info["step"]) == ("2001-01-01T00:00:00", 0)
    assert trajectory(own) == calculated(7, 10)
    assert own.sample.truncated
    assert own.sample.time.isoformat() == "2001-01-01T00:10:00"
    assert own.manifest.building == "tank"
    assert (own.manifest.weather, own.manifest.location, own.manifest.latitude_deg) == ("", "", None)


@pytest.mark.slow
def test_python_plant__equal_seeds_give_equal_episodes_and_none_continues_their_sequence(own: BuildingEnv) -> None:
    def sequence(seed: int | None) -> list[bytes]:
        own.reset(seed=seed)
        return trajectory(own, 1)

    first = [sequence(seed) for seed in (5, None, None)]
    again = [sequence(seed) for seed in (5, None, None)]
    assert first == again
    assert len({episode[0] for episode in first}) == 3
    assert sequence(2**64 - 1) == calculated(2**64 - 1, 1)


@pytest.mark.slow
def test_python_plant__slots_and_baseline_have_the_same_episodes(own: BuildingEnv, tank: Path) -> None:
    arguments = {"plant": f"{tank}:Tank", "reward": None, "affinity": "off"}
    envs = gym.make_vec("zenostat/Plant-v1", num_envs=2, baseline=True, plant_arguments={"loss": 0.5}, **arguments)
    try:
        envs.reset(seed=[3, 4])
        link = envs.unwrapped.link
        envs.step(np.array([action(heater=100.0, valve=0.0)] * 2))
        message = link.current().message
        values = np.frombuffer(message.values).reshape(2, 3)
        assert [row.tobytes() for row in values] == [calculated(seed, 1, 0.5)[0] for seed in (3, 4)]
        baseline = np.frombuffer(message.baseline).reshape(2, 3)
        assert baseline[:, 0].tolist() == [19.75, 19.75], "its valve has its default"
        assert baseline[:, 1].tolist() == values[:, 1].tolist(), "the same seeds"
    finally:
        envs.close()


# Commands


def test_python_plant__what_nobody_commands_has_its_default_or_is_missing(own: BuildingEnv) -> None:
    _, info = own.reset(seed=1)
    np.testing.assert_array_equal(info["effective"], [nan, 0.25, nan])
    sample = own.link.current()
    sample.send({"heater": 500.0, "valve": 1.0})
    sample = own.link.receive()
    np.testing.assert_array_equal(sample.effective, [500.0, 1.0, nan])
    assert [sample.value_source[name] for name in ("heater", "valve", "deed")] == [own.link.name] * 2 + [""]
    assert sample["temperature"] == 20.0 + 0.5 - 1.0
    sample.send({"heater": None, "valve": None})
    sample = own.link.receive()
    np.testing.assert_array_equal(sample.effective, [nan, 0.25, nan])
    assert sample["temperature"] == 19.5 - 0.25 + 0.125 * 0.5


# Failures


@pytest.mark.variants
@pytest.mark.parametrize(
    ("deed", "error", "texts"),
    [
        ("raise", PlantFailed, ["Tank.step() raised an error", "RuntimeError: the tank leaks", "in cool", "in step"]),
        ("exit", PlantFailed, ["Tank.step() raised an error", "SystemExit: enough"]),
        ("interrupt", PlantFailed, ["Tank.step() raised an error", "KeyboardInterrupt", "in step"]),
        ("nan", PlantFailed, ["Tank.step() returned nan for 'temperature' at step 2", "a finite number expected"]),
        ("inf", PlantFailed, ["returned inf for 'temperature' at step 2"]),
        ("text", PlantFailed, ["returned '20.0' for 'temperature' at step 2"]),
        ("none", PlantFailed, ["returned None for 'temperature' at step 2"]),
        ("huge", PlantFailed, ["for 'temperature' at step 2"]),
        ("missing", PlantFailed, ["step() at step 2 returned no value for 'temperature'"]),
        ("unknown", PlantFailed, ["returned 'temprature', which is neither a sensor", "did you mean 'temperature'"]),
        ("list", PlantFailed, ["returned list; a dict with the values of temperature, noise, electricity expected"]),
        ("leave", EngineDied, ["ended with code 3 after sample 1", "its output is in that of the node"]),
        ("kill", EngineDied, ["was killed by SIGKILL after sample 1"]),
    ],
)
def test_python_plant__failed_step_is_named_and_the_next_reset_starts_another_process(
    own: BuildingEnv, deed: str, error: type[ZenostatError], texts: list[str]
) -> None:
    own.reset(seed=2)
    own.step(action())
    (process,) = hosts_of(own.local_node.pid)
    with pytest.raises(error) as raised:
        own.step(action(deed=deed))
    assert type(raised.value) is error
    for text in texts:
        assert text in str(raised.value)
    assert "bridge/python_plant" not in str(raised.value), "the frames are the user's only"
    until(lambda: not runs(process), "the process has ended")
    _, info = own.reset(seed=2)
    assert str(info["engine_start"]) == "started"
    assert trajectory(own, 3) == calculated(2, 3)
    (successor,) = hosts_of(own.local_node.pid)
    assert successor.pid != process.pid


def test_python_plant__reset_that_fails_is_named_and_another_one_works(own: BuildingEnv) -> None:
    with pytest.raises(PlantFailed, match=r"(?s)Tank.reset\(\) raised an error.*ValueError: thirteen"):
        own.reset(seed=13)
    own.reset(seed=1)
    assert trajectory(own, 2) == calculated(1, 2)


@pytest.mark.variants
@pytest.mark.parametrize(
    ("number", "error", "text"),
    [
        (signal.SIGKILL, EngineDied, "was killed by SIGKILL after sample 1"),
        (signal.SIGSTOP, EngineUnresponsive, "neither answered nor used processor time for 2 s after sample 1"),
    ],
)
def test_python_plant__process_that_waits_may_be_killed_or_stopped(
    own: BuildingEnv, number: signal.Signals, error: type[ZenostatError], text: str
) -> None:
    own.reset(seed=2)
    own.step(action())
    hosts_of(own.local_node.pid)[0].send_signal(number)
    with pytest.raises(error, match=text):
        own.step(action())
    own.reset(seed=2)
    assert trajectory(own, 2) == calculated(2, 2)


@pytest.mark.slow
def test_python_plant__plant_that_computes_for_long_is_left_alone(own: BuildingEnv) -> None:
    own.reset(seed=1)
    own.step(action(deed="compute"))
    assert own.sample.step == 1


@pytest.mark.slow
def test_python_plant__what_a_class_prints_appears_at_once_in_the_nodes_standard_error(
    own: BuildingEnv, capfd: pytest.CaptureFixture[str], tank: Path
) -> None:
    for env in plant_env(f"{tank}:Tank"):  # its standard error is the one that is captured here
        env.reset(seed=1)
        env.step(action(deed="print"))
        seen = [""]

        def has_printed(seen: list[str] = seen) -> bool:
            seen[0] += capfd.readouterr().err
            return "printed by the tank\n" in seen[0] and "logged by the tank\n" in seen[0]

        until(has_printed, "the line has arrived")
        assert trajectory(env, 1)
        assert seen[0].count("printed by the tank") == 1


# Snapshots and branches


@pytest.fixture(params=["saved", "forked"])
def copied(request: pytest.FixtureRequest) -> BuildingEnv:
    """Environments whose plants are copied in either way."""
    env: BuildingEnv = request.getfixturevalue("own" if request.param == "saved" else "forkable")
    return env


@pytest.mark.slow
@pytest.mark.variants
def test_python_plant__copies_continue_to_the_bit(copied: BuildingEnv) -> None:
    copied.reset(seed=11)
    beginning = trajectory(copied, 4)
    snapshot = copied.snapshot()
    with copied.branch() as branch, copied.branch(snapshot=snapshot) as other:
        ends = [trajectory(env, 6) for env in (branch, copied, other)]
    copied.reset(options={"snapshot": snapshot})
    np.testing.assert_array_equal(copied.sample.effective, [400.0, 3.0 / 16.0, 0.0])
    ends.append(trajectory(copied, 6))
    copied.reset(options={"snapshot": snapshot})
    with copied.branch() as branch:
        ends.append(trajectory(branch, 6))
    assert [beginning + end for end in ends] == [calculated(11, 10)] * 5
    snapshot.close()
    until(lambda: len(hosts_of(copied.local_node.pid)) == 1, "the copies have ended")


@pytest.mark.slow
@pytest.mark.variants
def test_python_plant__copy_is_as_mortal_as_its_origin(copied: BuildingEnv) -> None:
    copied.reset(seed=1)
    with copied.branch() as branch:
        with pytest.raises(PlantFailed, match="the tank leaks"):
            branch.step(action(deed="raise"))
        assert trajectory(copied, 2) == calculated(1, 2)
    snapshot = copied.snapshot()
    with pytest.raises(EngineDied):
        copied.step(action(deed="leave"))
    copied.reset(options={"snapshot": snapshot})
    assert trajectory(copied, 1) == calculated(1, 3)[2:]
    snapshot.close()


def test_python_plant__trials_of_a_saved_state_use_the_same_processes(own: BuildingEnv) -> None:
    """They are the steps that follow, to the bit; a process that fails in one is replaced."""
    own.reset(seed=3)
    node, beginning, kept = own.local_node.pid, trajectory(own, 2), set()
    for step in range(2, 5):
        alternatives = [action(heater=0.0), action(heater=100.0 * (step + 1), valve=step / 16.0)]
        other, tried = own.try_step(alternatives)
        assert other.values.tobytes() != tried.values.tobytes()
        beginning += trajectory(own, 1)
        assert tried.values.tobytes() == beginning[-1]
        kept.add(frozenset(hosts_of(node)))
        if step == 2:
            with pytest.raises(PlantFailed, match=r"(?s)trial from step 3: .*the tank leaks"):
                own.try_step([action(deed="raise")])
            kept.clear()
    assert beginning == calculated(3, 5)
    assert [len(hosts) for hosts in kept] == [3]  # the node's own, and one for each alternative


@pytest.mark.slow
def test_python_plant__pending_trial_can_be_cancelled(own: BuildingEnv) -> None:
    """The client gives up a trial that does not end; the node goes on once it has noticed that itself."""
    own.reset(seed=3)
    bus, values = own.link.bus, action(deed="hang").astype(np.float64).tobytes()
    request = trial_message(1, 1, values, None, at=own.sample.message)
    pending = bus.begin_trial(own.manifest.node, request.model_copy(update={"controller": own.link.name}))
    timer = threading.Timer(0.2, pending.cancel)
    timer.start()
    with pytest.raises(BusError, match=r"the trial of node '.*' was cancelled"):
        bus.finish_trial(own.manifest.node, pending)
    timer.join()
    assert trajectory(own, 2) == calculated(3, 2)


@pytest.mark.slow
def test_python_plant__state_that_cannot_be_loaded_again_is_named(own: BuildingEnv) -> None:
    own.reset(seed=1)
    own.step(action(valve=0.0, heater=100.0, deed="keep unreadable"))
    with pytest.raises(
        SimulatorError, match=r"the state of Tank.save\(\) cannot be loaded again: ValueError\(.*no number"
    ):
        own.snapshot()
    assert trajectory(own, 1) == calculated(1, 2)[1:]
    with pytest.raises(EngineDied):
        own.step(action(deed="kill"))  # what it has would outlive the episode


@pytest.mark.slow
def test_python_plant__class_that_can_no_longer_be_copied_goes_on(own: BuildingEnv, forkable: BuildingEnv) -> None:
    own.reset(seed=1)
    own.step(action(valve=0.0, heater=100.0, deed="keep"))
    with pytest.raises(ForkFailed, match=r"the state of Tank cannot be saved: .*cannot pickle '_thread.lock'"):
        own.snapshot()
    forkable.reset(seed=1)
    forkable.step(action(valve=0.0, heater=100.0, deed="thread"))
    with pytest.raises(ForkFailed, match=r"its process has threads, which a fork would lose"):
        forkable.branch()
    for env in (own, forkable):
        assert trajectory(env, 1) == calculated(1, 2)[1:]
        with pytest.raises(EngineDied):
            env.step(action(deed="kill"))  # what it has would outlive the episode


@pytest.mark.slow
def test_python_plant__class_that_cannot_be_copied_states_what_it_lacks(own: BuildingEnv, tank: Path) -> None:
    plan = plan_class(f"{tank}:Neither", {}, unresponsive_s=10.0)
    with pytest.raises(ForkFailed, match=r"save\(\) and restore\(state\), or forkable = True"):
        PythonEngines(plan, ()).fork([], tank.parent / "never")
    own.reset(seed=1)
    own.step(action(valve=0.0, heater=100.0, deed="break"))
    with pytest.raises(PlantFailed, match=r"(?s)Tank.restore\(\) raised an error.*the tank leaks"):
        own.snapshot()
    assert trajectory(own, 1) == calculated(1, 2)[1:]
    until(lambda: len(hosts_of(own.local_node.pid)) == 1, "the copy has ended")
    with pytest.raises(EngineDied):
        own.step(action(deed="kill"))


@pytest.mark.slow
def test_python_plant__save_that_hangs_ends_the_episode_with_its_reason(own: BuildingEnv, tank: Path) -> None:
    reason = r"neither answered the order to save its state nor used processor time for 2 s after sample 1, and was"
    for env in plant_env(f"{tank}:HangingSave"):
        env.reset(seed=1)
        env.step(action())
        with pytest.raises(EngineUnresponsive, match=rf"trial from step 1: the engine process {reason} killed"):
            env.try_step([action()])
        with pytest.raises(EngineUnresponsive, match=rf"^the engine process {reason} killed"):
            env.step(action())
        env.reset(seed=1)
        assert trajectory(env, 2) == calculated(1, 2)


@pytest.mark.slow
def test_python_plant__restore_that_hangs_is_named_and_the_episode_continues(own: BuildingEnv, tank: Path) -> None:
    for env in plant_env(f"{tank}:HangingRestore"):
        env.reset(seed=1)
        beginning = trajectory(env, 1)
        with pytest.raises(EngineUnresponsive, match="the order to restore a state nor used processor time for 2 s, "):
            env.snapshot()
        assert beginning + trajectory(env, 1) == calculated(1, 2)


# Starting


@pytest.mark.variants
@pytest.mark.parametrize(
    ("deed", "error", "text"),
    [
        ("raise", PlantFailed, r"(?s)tank.py:Tank' cannot be created.*in __init__.*RuntimeError: the tank leaks"),
        ("exit", PlantFailed, r"(?s)cannot be created.*SystemExit: enough"),
        ("interrupt", PlantFailed, r"(?s)cannot be created.*KeyboardInterrupt"),
        ("leave", EngineDied, r"could not be created: its process ended with code 3"),
        ("kill", EngineDied, r"could not be created: its process was killed by SIGKILL"),
        ("hang", EngineUnresponsive, r"could not be created: its process used no processor time for 2 s"),
    ],
)
def test_python_plant__class_that_cannot_be_created_is_named(
    tank: Path, deed: str, error: type[ZenostatError], text: str
) -> None:
    with pytest.raises(error, match=text) as raised:
        plan_class(f"{tank}:Tank", {"deed": deed}, **SOON)
    assert type(raised.value) is error


def test_python_plant__file_that_is_no_python_is_named_with_its_line(tank: Path) -> None:
    (tank.parent / "broken.py").write_text("class Tank:\n    step_s = = 60\n")
    with pytest.raises(InvalidConfig, match=r"^loading .*/broken\.py failed: SyntaxError: .* \(broken\.py, line 2\)$"):
        plan_class(f"{tank.parent}/broken.py:Tank", {}, unresponsive_s=10.0)


def test_python_plant__threads_of_a_class_do_not_delay_its_check(tank: Path) -> None:
    (tank.parent / "threads.py").write_text(
        "import threading, time\nfrom tank import Tank as Base\nclass Tank(Base): pass\n"
        "threading.Thread(target=time.sleep, args=(1e6,)).start()\n"
    )
    assert plan_class(f"{tank.parent}/threads.py:Tank", {}, unresponsive_s=1e6).has_state


@pytest.mark.slow
def test_python_plant__settings_of_a_building_and_unknown_arguments_are_refused(scratch: Path, tank: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"(?s)no setting 'steps_per_hour'; its class.*no setting 'weather'; its"):
        read_settings({"plant": f"{tank}:Tank", "steps_per_hour": 4, "weather": "USA_CO_Denver"})
    with pytest.raises(InvalidConfig, match=r"has no setting 'slot'; did you mean 'slots'"):
        read_settings({"plant": f"{tank}:Tank", "slot": 4})
    with pytest.raises(InvalidConfig, match=r"losses.*its arguments: \(loss=0.125, deed=''\)"):
        gym.make("zenostat/Plant-v1", plant=f"{tank}:Tank", plant_arguments={"losses": 1.0})
    with pytest.raises(InvalidConfig, match=r"a plant of your own has no setting 'weather'"):
        gym.make("zenostat/Plant-v1", plant=f"{tank}:Tank", weather="USA_CO_Denver")


# Nodes


@pytest.mark.slow
def test_python_plant__node_serves_a_plant_as_any_other(scratch: Path, tank: Path) -> None:
    """Two slots, timesteps of a day, a branch, a write with an expiry, faults."""
    with (
        node_on_bus(scratch / "node", plant=f"{tank}:Daily", slots=2, name="tank") as (_, bus),
        bus.controller("tank", name="first") as link,
    ):
        link.reset(seed=1)
        branch = bus.branch("tank", CreateBranch(controller=link.name, slot=1))
        assert bus.latest(branch).values == bus.latest("tank").values[24:]
        bus.write("tank", "heater", 500.0, priority=5, source="person", duration_s=86400.0)
        link.send()
        sample = link.receive()
        assert sample.value_source["heater"] == "person"
        assert sample.effective.tolist()[:2] == [500.0, 0.25]
        assert sample.time.isoformat() == "2001-01-02T00:00:00"
        bus.faults("tank", {"faults": [{"kind": "bias", "points": "temperature", "offset": 5.0}]})
        link.send()
        sample = link.receive()
        assert sample.value_source["heater"] == ""
        assert sample["temperature"] == sample.fault_free_values[0] + 5.0
        with pytest.raises(RequestRejected, match="this plant has no weather"):
            bus.weather("tank", ["Dry Bulb Temperature"])


@pytest.mark.slow
def test_python_plant__plant_without_actuators_is_watched(scratch: Path, tank: Path) -> None:
    with node_on_bus(scratch / "node", plant=f"{tank}:NoActuators", mode="free", name="tank") as (_, bus):
        until(lambda: bus.status("tank").state is State.ENDED, "it runs freely")
        latest = bus.latest("tank")
        assert (latest.step, latest.time, latest.elapsed_s) == ([10], ["2001-01-01T00:00:01"], [1.0])


ENDS_WITHIN_S = 15.0
"""Several times as long as it may take on a quiet machine."""
NEVER = {"unresponsive_s": 1e6}


def stop(node: NodeProgram) -> None:
    with suppress(ZenostatError), zenostat.connect(node.endpoint, affinity="off") as bus:
        bus.stop(node.name)


SHUTDOWNS: dict[str, Callable[[NodeProgram], object]] = {
    "SIGTERM": lambda node: node.process.send_signal(signal.SIGTERM),
    "SIGINT": lambda node: node.process.send_signal(signal.SIGINT),
    "stop": stop,
}


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(("time", "number"), [("described", signal.SIGINT), ("started", signal.SIGTERM)])
def test_python_plant__node_ends_while_its_plant_is_created(
    scratch: Path, tank: Path, time: str, number: signal.Signals
) -> None:
    (scratch / "slow.py").write_text(SLOW)
    if time == "described":
        (scratch / "described").touch()
    settings = {"name": "slow", "plant": f"{scratch}/slow.py:Slow", "listen": [f"unixsock-stream/{scratch}/bus"]}
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "zenostat.bridge.python_plant"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    with process:
        process.stdin.write(json.dumps(settings | NEVER | {"folder": str(scratch / "run")}).encode() + b"\n")
        process.stdin.flush()
        until((scratch / "hangs").exists, "the class hangs")
        process.send_signal(number)
        assert process.wait(ENDS_WITHIN_S) == 0
        assert process.stdout.read() == b""


SLOW = """
import pathlib, time
folder = pathlib.Path(__file__).parent

class Slow:
    step_s = 60.0
    sensors = {"temperature": "degC"}
    actuators = {}

    def __init__(self):
        if (folder / "described").exists():
            (folder / "hangs").touch()
            time.sleep(1e6)
        (folder / "described").touch()

    def reset(self, seed):
        return {}

    def step(self, commands):
        return {}
"""


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(("deed", "shutdown"), [("hang", "SIGTERM"), ("hang", "stop"), ("compute for ever", "SIGINT")])
def test_python_plant__node_ends_while_its_plant_steps(scratch: Path, tank: Path, shutdown: str, deed: str) -> None:
    with (
        node_on_bus(scratch / "node", plant=f"{tank}:Tank", slots=2, name="tank", **NEVER) as (node, bus),
        bus.controller("tank") as link,
    ):
        link.current().send({"deed": float(DEEDS.index(deed))})
        until(lambda: bus.status("tank").state is State.RUNNING, "it steps")
        SHUTDOWNS[shutdown](node)
        assert node.process.wait(ENDS_WITHIN_S) == 0
