"""Bad input and failures: a clear error, nothing lost, nothing left behind.

`scratch` is in each of these tests: it counts the processes, sockets and folders that are left.
"""

import json
import os
import signal
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import psutil
import pytest
from support.nodes import (
    PATIENCE_S,
    SMALL,
    WEATHER,
    NodeProgram,
    Program,
    engine_of,
    free_port,
    node_on_bus,
    nothing_left,
    programs_of,
    until,
)
from support.run_cli import run_python

import zenostat
from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import plan
from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building
from zenostat.topics.errors import (
    AddressInUse,
    EngineDied,
    EpisodeChanged,
    InvalidAction,
    InvalidConfig,
    ModelError,
    NameInUse,
    NodeLost,
    NodeNotFound,
    SimulatorError,
    UnknownName,
    ZenostatError,
)
from zenostat.topics.messages import State

pytestmark = pytest.mark.usefixtures("scratch")

NOTICED_WITHIN_S = 5.0
"""Of a death, told by the link's end: half of the lease after which Zenoh gives up whoever is silent."""

ENDED = r"node 'office' (was stopped|is gone) \(last sample: episode 1, step {step}\)"
"""Its last word and the news of its end travel side by side; either may be the first."""


def make(**arguments: Any) -> gym.Env[Any, Any]:
    return gym.make("zenostat/Building-v1", **{**SMALL, "affinity": "off", **arguments})


@pytest.fixture(scope="module")
def env(module_folder: Path) -> Iterator[gym.Env[Any, Any]]:
    """An environment for the tests that its node outlives; each begins with a reset."""
    folder = module_folder / "environment"
    folder.mkdir()
    with nothing_left(folder):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("TMPDIR", str(folder))
            patch.setattr(tempfile, "tempdir", None)
            opened = make()
        with opened:
            yield opened


@contextmanager
def node_and_bus(folder: Path) -> Iterator[tuple[NodeProgram, zenostat.Bus]]:
    with node_on_bus(folder / "node", **SMALL) as (node, bus):
        yield node, bus


@contextmanager
def during_a_timestep(env: gym.Env[Any, Any], do: Callable[[psutil.Process, psutil.Process], None]) -> Iterator[None]:
    """Freezes the engine, lets the body step, and calls `do(node, engine)` once the node waits for the engine."""
    own = env.unwrapped.local_node
    node, engine = psutil.Process(own.pid), engine_of(own.pid)
    faults: list[BaseException] = []

    def act() -> None:
        try:
            with zenostat.connect(own.endpoint, affinity="off") as bus:
                until(lambda: bus.status("building").state is State.RUNNING, "the node simulates a timestep")
                do(node, engine)
        except BaseException as error:
            faults.append(error)

    engine.suspend()
    thread = threading.Thread(target=act)
    thread.start()
    try:
        yield
    finally:
        thread.join()
    assert not faults, faults


# Names and settings


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"building": "ofice-small"}, r"no building 'ofice-small'; did you mean .*'office-small'"),
        ({"building": "office"}, r"building 'office' matches several: office-large, office-medium, office-small"),
        ({"building": "gone/model.idf"}, r"no building file at /.*/gone/model\.idf"),
        ({"weather": "USA_CO_Denvr"}, r"no weather 'USA_CO_Denvr'; did you mean 'USA_CO_Denver'"),
        ({"weather": "gone.epw"}, r"no weather file at /.*/gone\.epw"),
    ],
)
def test_failures__unknown_building_or_weather(arguments: dict[str, str], message: str) -> None:
    with pytest.raises(UnknownName, match=message):
        plan(read_config(SMALL | arguments))


def test_failures__all_unknown_points_are_named_at_once_with_near_names() -> None:
    with pytest.raises(UnknownName) as raised:
        make(
            sensors={
                "inside": ("Zone Air Temprature", "CORE_ZN"),
                "outside": ("Zone Air Temperature", "CORE_ZONE"),
                "good": ("Zone Air Temperature", "CORE_ZN"),
            },
            meters={"all": "Electricity:Facilities"},
            actuators={
                "cooling": ("Zone Temperature Control", "Cooling Setpoint", "CORE_ZM"),
                "heating": ("Zone Temperature Control", "Heat Setpoint", "CORE_ZN"),
                "fan": ("Zone Temperatur Control", "Heating Setpoint", "CORE_ZN"),
            },
        )
    lines = str(raised.value).splitlines()
    expected = {
        "sensor 'inside': the model has no variable 'Zone Air Temprature'": "'Zone Air Temperature'",
        "sensor 'outside': 'Zone Air Temperature' has no key 'CORE_ZONE'": "'CORE_ZN'",
        "meter 'all': the model has no meter 'Electricity:Facilities'": "'Electricity:Facility'",
        "actuator 'cooling': 'Zone Temperature Control', 'Cooling Setpoint' has no key 'CORE_ZM'": "'CORE_ZN'",
        "actuator 'heating': 'Zone Temperature Control' has no control type 'Heat Setpoint'": "'Heating Setpoint'",
        "actuator 'fan': the model has no component type 'Zone Temperatur Control'": "'Zone Temperature Control'",
    }
    assert len(lines) == len(expected)
    for line, (fault, near) in zip(lines, expected.items(), strict=True):
        assert line.startswith(f"{fault}; did you mean ")
        assert near in line.partition("did you mean ")[2]


def test_failures__unknown_building_and_weather_are_named_at_once() -> None:
    with pytest.raises(UnknownName) as raised:
        make(building="ofice-small", weather="USA_CO_Denvr")
    assert "no building 'ofice-small'" in str(raised.value)
    assert "no weather 'USA_CO_Denvr'" in str(raised.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"begin": "02-30"}, r"begin '02-30' is not a calendar date"),
        ({"begin": "1 July"}, r"begin '1 July' is not a date; write it as MM-DD or YYYY-MM-DD"),
        ({"begin": "07-02", "end": "07-01"}, r"the run period ends \(.*07-01\) before it begins \(.*07-02\)"),
        ({"steps_per_hour": 7}, r"steps_per_hour 7 does not divide the hour"),
        ({"sensors": {"a b": ("Zone Air Temperature", "CORE_ZN")}}, r"the point name 'a b' is not valid in a topic"),
        (
            {"sensors": {"inside": ("Zone Air Temperature", "CORE_ZN", "avg")}},
            r"sensors.inside.aggregation: .*'mean', 'sum' or 'instant', got 'avg'",
        ),
    ],
)
def test_settings__refused_by_the_node(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidConfig, match=message):
        plan(read_config(SMALL | arguments))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"begin": "02-30"}, r"begin '02-30' is not a calendar date"),  # by its own node
        ({"sensors": {"inside": "Zone Air Temperature"}}, r"sensors 'inside': a tuple of EnergyPlus's names expected"),
        ({"building": None}, r"name a building and a weather, a scenario, a file .file=., a class of your own"),
    ],
)
def test_settings__refused_by_the_environment(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidConfig, match=message):
        make(**arguments)


# Models


def _broken(folder: Path, break_: Callable[[dict[str, Any]], None]) -> Path:
    """A copy of the small building with a fault in it."""
    objects = json.loads(json.dumps(read_building(find_building(SMALL["building"])).objects))
    break_(objects)
    path = folder / "broken.epJSON"
    path.write_text(json.dumps(objects))
    return path


@pytest.mark.slow
def test_model__refused_by_energyplus(scratch: Path) -> None:
    """A fan that names a schedule which is not there."""

    def break_(objects: dict[str, Any]) -> None:
        fans = next(items for kind, items in objects.items() if kind.startswith("Fan:"))
        next(iter(fans.values()))["availability_schedule_name"] = "Unobtainium 20cm"

    with pytest.raises(ModelError) as raised:
        make(building=_broken(scratch, break_))
    message = str(raised.value)
    assert "EnergyPlus reports:" in message
    assert "** Severe **" in message
    assert "UNOBTAINIUM 20CM" in message.upper()
    assert "** Fatal **" in message


@pytest.mark.slow
def test_model__refused_if_it_is_no_building(scratch: Path) -> None:
    path = scratch / "empty.epJSON"
    for text, message in (("{", "is not an epJSON"), ("{}", "it has no 'Building' object")):
        path.write_text(text)
        with pytest.raises(InvalidConfig, match=message):
            make(building=path)


@pytest.mark.slow
def test_failures__energyplus_gives_up_in_mid_episode() -> None:
    """A heating setpoint above the cooling setpoint ends the run; the words are EnergyPlus's."""
    actuators = {
        "heating": ("Zone Temperature Control", "Heating Setpoint", "CORE_ZN", 10, 40),
        "cooling": ("Zone Temperature Control", "Cooling Setpoint", "CORE_ZN", 10, 40),
    }
    with make(actuators=actuators) as env:
        env.reset(seed=1)
        env.step(np.array([20, 25], np.float32))
        with pytest.raises(SimulatorError) as raised:
            env.step(np.array([30, 20], np.float32))
        assert "DualSetPointWithDeadBand" in str(raised.value)
        assert "** Severe **" in str(raised.value)
        with pytest.raises(ZenostatError):
            env.step(np.array([20, 25], np.float32))
        env.reset(seed=1)
        *_, info = env.step(np.array([20, 25], np.float32))
        assert info["step"] == 1, "a reset begins a good episode again"


# Deaths


@pytest.mark.slow
def test_failures__engine_is_killed_in_mid_step(env: gym.Env[Any, Any]) -> None:
    env.reset(seed=1)
    env.step(env.action_space.low)
    with during_a_timestep(env, lambda _, engine: engine.kill()):  # noqa: SIM117
        with pytest.raises(EngineDied, match="the engine process was killed by SIGKILL after sample 1"):
            env.step(env.action_space.low)
    env.reset(seed=1)
    *_, info = env.step(env.action_space.low)
    assert info["step"] == 1, "the node has outlived it"


@pytest.mark.slow
def test_failures__engine_is_killed_while_it_waits(env: gym.Env[Any, Any]) -> None:
    env.reset(seed=1)
    env.step(env.action_space.low)
    own = env.unwrapped.local_node
    engine_of(own.pid).kill()
    with pytest.raises(EngineDied, match="the engine process was killed by SIGKILL after sample 1"):
        env.step(env.action_space.low)


def test_failures__node_is_killed_in_mid_step() -> None:
    killed: list[float] = []

    def kill(node: psutil.Process, engine: psutil.Process) -> None:
        killed.append(time.monotonic())
        node.kill()
        engine.resume()

    with make() as env:
        env.reset(seed=1)
        for _ in range(3):
            env.step(env.action_space.low)
        with during_a_timestep(env, kill):
            with pytest.raises(NodeLost) as raised:
                env.step(env.action_space.low)
            noticed = time.monotonic()
        assert noticed - killed[0] < NOTICED_WITHIN_S
        assert "node 'building' is gone (last sample: episode " in str(raised.value)
        assert "step 3)" in str(raised.value)


@pytest.mark.slow
def test_failures__node_is_killed_between_steps() -> None:
    with make() as env:
        env.reset(seed=1)
        env.step(env.action_space.low)
        psutil.Process(env.unwrapped.local_node.pid).kill()
        started = time.monotonic()
        with pytest.raises(NodeLost, match=r"node 'building' is gone \(last sample: episode \d+, step 1\)"):
            env.step(env.action_space.low)
        assert time.monotonic() - started < NOTICED_WITHIN_S
        with pytest.raises(NodeLost):
            env.step(env.action_space.low)
        with pytest.warns(UserWarning, match="own node had ended"):
            env.reset()


@pytest.mark.slow
def test_failures__owner_is_killed(scratch: Path) -> None:
    """Nobody is left to end the node: it ends by itself, and its engine with it."""
    text = f"""
import sys
import gymnasium as gym, zenostat
env = gym.make("zenostat/Building-v1", **{SMALL!r}, affinity="off")
env.reset()
print(env.unwrapped.local_node.folder, flush=True)
sys.stdin.readline()
"""
    with Program(text) as program:
        program.line()
        assert len(programs_of(scratch)) == 4  # with the engine that waits to be forked
        program.process.kill()
        until(lambda: not programs_of(scratch), "node and engines have ended")


@pytest.mark.slow
def test_failures__node_is_stopped_by_a_request(folder: Path) -> None:
    with node_and_bus(folder) as (node, bus), bus.controller("office") as link:
        link.reset().send()
        link.receive()
        bus.stop("office")
        with pytest.raises(NodeLost, match=ENDED.format(step=1)):
            link.receive()
        assert node.process.wait() == 0


@pytest.mark.slow
def test_a_controller__raises_when_another_resets_its_node(episode_bus: zenostat.Bus) -> None:
    with (
        episode_bus.controller("office", name="one") as one,
        episode_bus.controller("office", name="two", priority=9) as two,
    ):
        one.reset()
        episode = two.reset().episode
        reset_by = rf"node 'office' was reset by {two.name} .*; it is now in episode {episode}"
        with pytest.raises(EpisodeChanged, match=reset_by):
            one.receive()


# Actions


def test_failures__faulty_actions_change_nothing(env: gym.Env[Any, Any]) -> None:
    good = env.action_space.low
    env.reset(seed=1)
    undisturbed = env.step(good)[0]
    checked = env.unwrapped
    checked.reset(seed=1)
    too_hot, not_a_number = good.copy(), good.copy()
    too_hot[1], not_a_number[0] = 99.0, np.nan
    infinite = np.full_like(good, np.inf)
    names = [a.name for a in checked.manifest.actuators]
    for action, message in (
        (good[:-1], r"action of shape \(9,\); \(10,\) expected: core_zn_"),
        (np.float32(20), r"action of shape \(\); \(10,\) expected"),
        (good[None], r"action of shape \(1, 10\); \(10,\) expected"),
        (too_hot, rf"{names[1]} = 99; its bounds are "),
        (not_a_number, rf"{names[0]} = nan; its bounds are "),
        (infinite, rf"{names[0]} = inf; its bounds are .*{names[-1]} = inf"),
    ):
        with pytest.raises(InvalidAction, match=message):
            checked.step(action)
    observation, _, _, _, info = checked.step(good)
    assert info["step"] == 1
    assert observation.tobytes() == undisturbed.tobytes()


@pytest.mark.slow
def test_failures__faulty_values_of_a_controller(episode_bus: zenostat.Bus) -> None:
    with episode_bus.controller("office") as link:
        sample = link.reset()
        with pytest.raises(InvalidAction, match="no actuator 'core_zn_cooling'; did you mean 'core_zn_cooling_setp"):
            sample.send({"core_zn_cooling": 25.0})
        with pytest.raises(InvalidAction, match=r"core_zn_cooling_setpoint = nan; a finite number or None"):
            sample.send({"core_zn_cooling_setpoint": float("nan")})
        with pytest.raises(InvalidAction, match=r"values of shape \(3,\); \(10,\) expected"):
            sample.send(np.zeros(3))
        with pytest.raises(UnknownName, match=r"no sensor or meter 'core_zn_temperature'; did you mean .*'core_zn_air"):
            sample["core_zn_temperature"]
        sample.send({"core_zn_cooling_setpoint": 25.0})
        assert link.receive().step == 1


# Places on the bus


def test_failures__port_that_is_taken(folder: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(AddressInUse, match=f"another program listens on {endpoint}; name another port"):
            NodeProgram(folder / "node", **SMALL, listen=[endpoint])


@pytest.mark.slow
def test_failures__port_that_a_node_has_taken(folder: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with NodeProgram(folder / "one", **SMALL, listen=[endpoint]) as node:
        with pytest.raises(AddressInUse, match=f"another program listens on {endpoint}"):
            NodeProgram(folder / "two", **SMALL, name="other", listen=[endpoint])
        with zenostat.connect(endpoint, affinity="off") as bus:
            assert bus.nodes() == ["office"]
        assert node.process.poll() is None


@pytest.mark.slow
def test_failures__socket_that_is_taken(folder: Path, episode_bus: zenostat.Bus) -> None:
    with pytest.raises(AddressInUse, match="already exists; name another path"):
        NodeProgram(folder / "two", **SMALL, name="other", listen=[episode_bus.endpoint])
    assert episode_bus.nodes() == ["office"]


def test_failures__two_nodes_of_one_name(folder: Path, episode_bus: zenostat.Bus) -> None:
    with pytest.raises(NameInUse, match=r"a node named 'office' is on this bus already \(instance [0-9a-f]+\)"):
        NodeProgram(folder / "two", **SMALL, connect=[episode_bus.endpoint])
    with episode_bus.controller("office") as link:
        link.reset().send()
        assert link.receive().step == 1, "the first goes on"


@pytest.mark.slow
def test_connect__names_what_is_missing(shared_node: NodeProgram) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(NodeNotFound, match=f"nobody listens on {endpoint}; start a node there"):
        zenostat.connect(endpoint)
    with pytest.raises(NodeNotFound, match=r"no node 'ofice' on .*; did you mean 'office'"):
        gym.make("zenostat/Building-v1", connect=shared_node.endpoint, node="ofice")


def test_node__listens_to_other_machines_only_with_the_option(folder: Path) -> None:
    with pytest.raises(InvalidConfig, match="can be reached from other machines, without encryption"):
        NodeProgram(folder / "node", **SMALL, listen=[f"tcp/0.0.0.0:{free_port()}"])


# Ctrl-C


@pytest.mark.slow
def test_failures__ctrl_c_in_a_node_that_waits(folder: Path) -> None:
    with node_and_bus(folder) as (node, bus), bus.controller("office") as link:
        link.reset().send()
        link.receive()
        assert node.interrupt() == 0
        with pytest.raises(NodeLost, match=ENDED.format(step=1)):
            link.receive()


@pytest.mark.slow
def test_failures__ctrl_c_in_a_node_that_simulates(folder: Path) -> None:
    with node_and_bus(folder) as (node, bus), bus.controller("office") as link:
        sample = link.reset()
        node.engine.suspend()
        sample.send()
        until(lambda: bus.status("office").state is State.RUNNING, "the node simulates a timestep")
        assert node.interrupt() == 0
        with pytest.raises(NodeLost, match=ENDED.format(step=0)):
            link.receive()


ENVIRONMENT = f"""
import gymnasium as gym, zenostat
env = gym.make("zenostat/Building-v1", **{SMALL!r}, affinity="off")
"""

STEPS = """
while True:
    env.reset()
    print("steps", flush=True)
    truncated = False
    while not truncated:
        *_, truncated, info = env.step(env.action_space.low)
"""

WITH = "with env:" + STEPS.replace("\n", "\n    ")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("text", [ENVIRONMENT + WITH, ENVIRONMENT + STEPS], ids=["with", "bare"])
def test_failures__ctrl_c_in_a_script_with_an_environment(text: str) -> None:
    """The terminal sends the signal so; the script may have no `with`."""
    with Program(text) as program:
        assert program.line() == "steps"
        program.process.send_signal(signal.SIGINT)
        code, _, stderr = program.end()
        assert code in (-signal.SIGINT, 128 + signal.SIGINT, 1)
        assert stderr.strip().splitlines()[-1] == "KeyboardInterrupt"


def test_failures__ctrl_c_in_a_controller_leaves_the_node_running(episode_bus: zenostat.Bus) -> None:
    text = """
import sys
import zenostat
with zenostat.connect(sys.argv[1], affinity="off") as bus, bus.controller("office", name="script") as link:
    while True:
        link.reset()
        print("steps", flush=True)
        for sample in link:
            sample.send({"core_zn_cooling_setpoint": 26.0})
"""
    with Program(text, episode_bus.endpoint) as program:
        assert program.line() == "steps"
        program.process.send_signal(signal.SIGINT)
        code, _, stderr = program.end()
        assert code in (-signal.SIGINT, 128 + signal.SIGINT, 1)
        assert stderr.strip().splitlines()[-1] == "KeyboardInterrupt"
    until(lambda: episode_bus.controllers() == [], "the script's controller has gone")
    with episode_bus.controller("office", name="next") as link:
        link.reset().send()
        assert link.receive().step == 1


@pytest.mark.slow
def test_failures__ctrl_c_while_a_node_starts(folder: Path) -> None:
    """It may come at any moment; whatever the node had by then is cleared."""
    text = f"""
import gymnasium as gym, zenostat
print("starts", flush=True)
gym.make("zenostat/Building-v1", building="office-medium", weather={WEATHER!r}, affinity="off")
"""
    with Program(text) as program:
        assert program.line() == "starts"
        until(lambda: psutil.Process(program.pid).children(), "it has started a node")
        program.process.send_signal(signal.SIGINT)
        code, _, stderr = program.end()
        assert code != 0
        assert stderr.strip().splitlines()[-1] == "KeyboardInterrupt"


@pytest.mark.slow
def test_environment__ends_its_node_if_it_is_never_closed(scratch: Path) -> None:
    """The next weather's engine is being prepared when the program ends."""
    text = """
import gymnasium as gym, zenostat
env = gym.make("zenostat/ref-small-office-USA_CO_Denver-continuous-stochastic-v1", begin="07-03", end="07-03",
               affinity="off")
env.reset(seed=0)
"""
    done = run_python("-c", text, timeout=PATIENCE_S)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.slow
def test_environment__refuses_steps_and_resets_once_closed(scratch: Path) -> None:
    env = gym.make("zenostat/Building-v1", **SMALL, affinity="off").unwrapped
    env.reset(seed=0)
    env.close()
    for use in (lambda: env.step(env.action_space.low), env.reset):
        with pytest.raises(EpisodeChanged, match="closed"):
            use()


@pytest.mark.slow
def test_node__ends_quietly_when_stopped_twice(folder: Path) -> None:
    """By a request and, at once, by its owner's end."""
    for number in range(3):
        with node_and_bus(folder / str(number)) as (node, bus):
            bus.stop("office")
            os.kill(node.pid, signal.SIGTERM)
            node.process.wait(timeout=PATIENCE_S)
            assert node.process.returncode == 0
