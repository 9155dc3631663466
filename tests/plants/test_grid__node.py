"""An electric grid as the plant of a node: events of its power flow, snapshots, recordings."""

from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import yaml
from support.events import events_of, next_event

import zenostat
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.eplus_node.verify_recording import verify
from zenostat.topics.errors import InvalidRecording
from zenostat.topics.messages import EventKind

pytest.importorskip("power_grid_model")
pytestmark = pytest.mark.process

GRID = {
    "name": "street",
    "duration_s": 9000,
    "source": {"bus": "lv"},
    "buses": {"lv": {"voltage_kv": 0.4}, "a": {"voltage_kv": 0.4}},
    "lines": {
        "cable": {"from": "lv", "to": "a", "length_m": 400, "resistance_ohm_km": 0.5, "reactance_ohm_km": 0.1,
                  "ampacity_a": 100},
    },
    "loads": {"house": {"bus": "a", "power_w": {"file": "house.csv", "column": "w", "step_s": 900}}},
    "batteries": {"store": {"bus": "a", "capacity_kwh": 10, "power_kw": 5}},
}  # fmt: skip


@pytest.fixture(scope="module")
def file(module_scratch: Path) -> Path:
    """A grid whose third timestep has no solution."""
    (module_scratch / "house.csv").write_text("w\n" + "\n".join(["5000", "8000", "3e6", "6000"] + ["1000"] * 6) + "\n")
    path = module_scratch / "street.yaml"
    path.write_text(yaml.safe_dump(GRID))
    return path


@pytest.fixture(scope="module")
def env(file: Path, module_scratch: Path) -> Iterator[BuildingEnv]:
    record = str(module_scratch / "street.mcap")
    with gym.make("zenostat/Plant-v1", grid=file, reward=None, affinity="off", record=record) as created:
        yield created.unwrapped


def go(env: BuildingEnv, steps: int) -> list[bytes]:
    rows = []
    for _ in range(steps):
        env.step(np.array([2000.0], np.float32))
        rows.append(env.sample.values.tobytes())
    return rows


@pytest.mark.slow
def test_grid__only_devices_are_actions_of_an_agent(env: BuildingEnv) -> None:
    assert env.manifest.building == "street"
    assert [action.name for action in env.manifest.task.actions] == ["store_setpoint"]
    assert [actuator.name for actuator in env.manifest.actuators] == ["house_demand", "store_setpoint"]


def test_grid__power_flow_that_does_not_converge_is_an_event(env: BuildingEnv) -> None:
    env.reset()
    with zenostat.connect(env.local_node.endpoint, affinity="off") as bus, events_of(bus, env.manifest.node) as events:
        go(env, 4)
        event = next_event(events, EventKind.WARNING)
    assert event.step == 3
    text = event.text
    assert text.startswith("the power flow of step 3 does not converge")
    assert "at bus 'a'" in text


def test_grid__snapshot_continues_to_the_bit(env: BuildingEnv) -> None:
    env.reset()
    go(env, 2)
    with env.snapshot() as snapshot:
        onward = go(env, 5)
        env.reset(options={"snapshot": snapshot})
        assert go(env, 5) == onward


@pytest.mark.slow
def test_grid__recording_verifies_with_the_file_that_the_user_names(file: Path, module_scratch: Path) -> None:
    path = module_scratch / "own.mcap"
    with gym.make("zenostat/Plant-v1", grid=file, reward=None, affinity="off", record=str(path)) as created:
        created.reset()
        go(created.unwrapped, 5)
    assert verify(path, grid=file).passed
    with pytest.raises(InvalidRecording, match="name it yourself, as in --grid FILE"):
        verify(path)
    house = file.with_name("house.csv")
    content = house.read_text()
    house.write_text(content.replace("5000", "5001"))
    with pytest.raises(InvalidRecording, match=r"the profile house.csv .*house.csv has changed"):
        verify(path, grid=file)
    house.write_text(content)
