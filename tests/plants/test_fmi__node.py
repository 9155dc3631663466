"""An FMU as the plant of a node: resets, snapshots and branches by forks, its failures, recordings."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray
from support.fmus import build_tank, download_fmus
from support.nodes import hosts_of, until
from support.run_cli import run_in_process

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.bridge.python_plant.node import read_settings
from zenostat.eplus_node.verify_recording import verify
from zenostat.topics.errors import (
    EngineDied,
    EngineUnresponsive,
    ForkFailed,
    InvalidConfig,
    InvalidRecording,
    PlantFailed,
    RequestRejected,
)

pytest.importorskip("fmpy")
pytestmark = pytest.mark.process

CRASH, WAIT, ERROR = 1.0, 2.0, 3.0


@pytest.fixture(scope="module")
def tank(module_scratch: Path) -> Path:
    return build_tank(module_scratch)


def tank_env(path: Path, **settings: Any) -> gym.Env[Any, Any]:
    settings = {"reward": None, "affinity": "off", "unresponsive_s": 2.0, **settings}
    return gym.make("zenostat/Plant-v1", fmu=path, **settings)


@pytest.fixture(scope="module")
def env(tank: Path) -> Iterator[BuildingEnv]:
    with tank_env(tank) as created:
        yield created.unwrapped


def action(heat: float = 0.0, extra: float = 0.0, deed: float = 0.0) -> NDArray[np.float32]:
    return np.array([heat, extra, deed, 1.0], np.float32)


def trajectory(env: BuildingEnv, steps: int) -> list[list[float]]:
    rows = []
    for _ in range(steps):
        env.step(action(heat=25.0 * env.sample.step))
        rows.append(env.sample.values.tolist())
    return rows


@pytest.mark.slow
def test_fmu__manifest_has_its_points(env: BuildingEnv) -> None:
    env.reset()
    manifest = env.manifest
    assert (manifest.building, manifest.steps, manifest.step_s) == ("Tank", 100, 60.0)
    assert [(s.name, s.unit, s.low) for s in manifest.sensors] == [
        ("T", "degC", -50.0), ("steps", "1", None), ("power", "W", None)
    ]  # fmt: skip
    assert [(a.name, a.low, a.high, a.default) for a in manifest.actuators] == [
        ("heat", 0.0, 3000.0, 0.0), ("extra", 0.0, 500.0, None), ("deed", 0.0, 9.0, 0.0), ("mode", 1.0, 2.0, 1.0)
    ]  # fmt: skip


@pytest.mark.slow
def test_fmu__reset_is_a_fork_at_the_first_sample(env: BuildingEnv) -> None:
    """Also what the FMU keeps in static variables begins again: the number of steps."""
    env.reset()
    first = trajectory(env, 5)
    _, info = env.reset()
    assert str(info["engine_start"]) == "forked"
    assert trajectory(env, 5) == first
    assert first[-1][1] == 5.0


def test_fmu__snapshot_and_branch_continue_to_the_bit(env: BuildingEnv) -> None:
    env.reset()
    trajectory(env, 3)
    with env.snapshot() as snapshot:
        onward = trajectory(env, 4)
        env.reset(options={"snapshot": snapshot})
        assert trajectory(env, 4) == onward


def test_fmu__trial_is_a_fork_and_fails_alone(env: BuildingEnv) -> None:
    env.reset()
    trajectory(env, 2)
    alternatives = [action(heat=100.0), action(heat=700.0)]
    tried = env.try_step(alternatives)
    with pytest.raises(EngineDied, match=r"^trial from step 2: .* SIGSEGV"):
        env.try_step([action(deed=CRASH)])
    env.step(alternatives[1])
    assert env.sample.message == tried[1].message
    assert tried[0].message != tried[1].message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("deed", "error", "text"),
    [
        (CRASH, EngineDied, "was killed by SIGSEGV after sample 1"),
        (WAIT, EngineUnresponsive, "neither answered nor used processor time for 2 s after sample 1"),
        (ERROR, PlantFailed, r"FMU Tank: it failed after 60 s: fmi2DoStep failed with status 3 \(error\)"),
    ],
)
def test_fmu__failure_ends_its_own_process_only(
    env: BuildingEnv, deed: float, error: type[Exception], text: str
) -> None:
    env.reset()
    first = trajectory(env, 1)
    with pytest.raises(error, match=text):
        env.step(action(deed=deed))
    env.reset()
    assert trajectory(env, 1) == first


@pytest.mark.slow
def test_fmu__process_that_waits_at_sample_0_may_be_killed(tank: Path) -> None:
    with tank_env(tank) as created:
        env = created.unwrapped
        env.reset()
        first = trajectory(env, 2)
        for process in hosts_of(env.local_node.pid):
            process.kill()
        until(lambda: not hosts_of(env.local_node.pid), "they have ended")
        env.reset()
        assert trajectory(env, 2) == first


@pytest.mark.slow
def test_fmu__slots_and_baseline_are_forks_of_the_same_start(tank: Path) -> None:
    settings = {"reward": None, "affinity": "off", "fmu": tank, "baseline": True}
    envs = gym.make_vec("zenostat/Plant-v1", num_envs=2, **settings)
    try:
        for _ in range(2):
            envs.reset(seed=[3, 4])
            envs.step(np.array([action(heat=1000.0), action(heat=500.0)]))
            message = envs.unwrapped.link.current().message
            powers = np.frombuffer(message.values).reshape(2, 3)[:, 2]
            assert powers.tolist() == [1000.0, 500.0]
            assert np.frombuffer(message.baseline).reshape(2, 3)[:, 2].tolist() == [50.0, 50.0]
    finally:
        envs.close()


@pytest.mark.slow
def test_fmu__with_threads_has_no_copies_but_new_processes(tank: Path) -> None:
    with pytest.warns(UserWarning, match="the FMU has threads of its own"):
        created = tank_env(tank, plant_arguments={"set": {"threaded": True}})
    with created:
        env = created.unwrapped
        env.reset()
        first = trajectory(env, 2)
        with pytest.raises((ForkFailed, RequestRejected), match="its process has threads, which a fork would lose"):
            env.snapshot()
        env.reset()
        assert trajectory(env, 2) == first


@pytest.mark.slow
def test_fmu__that_crashes_when_it_is_loaded_is_named(tank: Path, module_scratch: Path) -> None:
    with pytest.raises(EngineDied, match="was killed by SIGSEGV"):
        tank_env(build_tank(module_scratch, "crash.fmu", crashes=True)).reset()


def test_fmu__conflicting_plants_are_one_sentence(tank: Path) -> None:
    with pytest.raises(InvalidConfig, match="plant and fmu both define the simulation"):
        tank_env(tank, plant="tank.py:Tank")
    with pytest.raises(InvalidConfig, match=r"needs a plant: plant='FILE.py:CLASS', fmu='FILE.fmu'"):
        read_settings({})
    with pytest.raises(InvalidConfig, match=r"file = 'b.fmu' conflicts with fmu"):
        _ = read_settings({"fmu": "a.fmu", "plant_arguments": {"file": "b.fmu"}}).plant_class


def test_fmu__command_line_needs_one_for_start_values() -> None:
    done = run_in_process("node", "--plant", "tank.py:Tank", "--set", "T=1")
    assert done.returncode != 0
    assert "--set needs --fmu FILE.fmu" in done.stderr


# Recordings


@pytest.mark.slow
def test_fmu__recording_verifies_with_the_fmu_that_the_user_names(tank: Path, module_scratch: Path) -> None:
    path = module_scratch / "tank.mcap"
    with tank_env(tank, record=str(path), plant_arguments={"set": {"T": 25.0}}) as created:
        created.reset()
        trajectory(created.unwrapped, 5)
        created.reset()
        trajectory(created.unwrapped, 3)
    result = verify(path, fmu=tank)
    assert result.passed, str(result)
    assert result.steps == 8
    with pytest.raises(InvalidRecording, match=r"name it yourself, as in --fmu FILE"):
        verify(path)
    with pytest.raises(InvalidRecording, match=r"the fmu .*other.fmu has changed"):
        verify(path, fmu=build_tank(module_scratch, "other.fmu", step_s="30"))
    with pytest.raises(InvalidConfig, match="--plant and --fmu both name the plant"):
        verify(path, fmu=tank, plant="zenostat.plants.fmi.plant:FmuPlant")
    with pytest.raises(InvalidRecording, match="name it yourself"):
        verify(path, plant="zenostat.plants.fmi.plant:FmuPlant")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*the FMU:UserWarning")
def test_fmu__those_of_other_tools_continue_from_forks_to_the_bit(module_scratch: Path) -> None:
    for path in download_fmus(module_scratch):
        with gym.make("zenostat/Plant-v1", fmu=path, reward=None, affinity="off") as created:
            env = created.unwrapped
            values = np.array([a.default for a in env.manifest.actuators], np.float32)

            def go(env: BuildingEnv = env, values: NDArray[np.float32] = values) -> list[bytes]:
                return [env.step(values) and env.sample.values.tobytes() for _ in range(40)]

            env.reset()
            whole = [*go(), *go()]
            env.reset()
            before = go()
            with env.snapshot() as snapshot:
                after = go()
                env.reset(options={"snapshot": snapshot})
                assert go() == after, path.name
            assert [*before, *after] == whole, path.name
