"""The fake building as the plant of a node, in a process of its own: trajectories equal `FakeEnv`'s to the bit."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import zenostat

assert zenostat

PLANT = "zenostat.agent_sdk.testing.fake_plant:FakePlant"
BUILDING = {"zones": 2, "begin": "07-03", "time": ["hour"], "steps_per_hour": 6, "equipment_control": True}


@pytest.fixture
def env() -> Iterator[Any]:
    with closing(gym.make("zenostat/Plant-v1", plant=PLANT, plant_arguments=BUILDING, reward=None)) as plant_env:
        yield plant_env


@pytest.fixture
def fake() -> Any:
    return gym.make("zenostat/Fake-v1", reward=None, **BUILDING)


def values(env: Any) -> list[tuple[str, bytes]]:
    """Time and raw float64 values of the present sample."""
    sample = env.unwrapped.sample
    return [(sample.time.isoformat(), bytes(sample.message.values))]


def steps(env: Any, actions: Any) -> list[tuple[str, bytes]]:
    return [row for action in actions for row in (env.step(action), values(env))[1]]


@pytest.mark.slow
def test_fake_plant__equal_spaces_and_names(env: Any, fake: Any) -> None:
    assert env.observation_space == fake.observation_space
    assert env.action_space == fake.action_space
    assert env.unwrapped.observation_names == fake.unwrapped.observation_names


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("seed", [0, 2**64 - 1])
def test_fake_plant__trajectory_is_equal_to_the_bit(env: Any, fake: Any, seed: int) -> None:
    fake.action_space.seed(3)
    actions = [fake.action_space.sample() for _ in range(fake.unwrapped.manifest.steps)]
    fake_observation, _ = fake.reset(seed=seed)
    observation, _ = env.reset(seed=seed)
    assert np.array_equal(observation, fake_observation)
    assert [*values(env), *steps(env, actions)] == [*values(fake), *steps(fake, actions)]
    assert env.unwrapped.sample.truncated
    assert fake.unwrapped.sample.truncated


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("is_forkable", [True, False])
def test_fake_plant__snapshot_continues_to_the_bit(is_forkable: bool, tmp_path: Path) -> None:
    """Copied by a fork of its process, or by its state."""
    (tmp_path / "plant.py").write_text(
        "from zenostat.agent_sdk.testing.fake_plant import FakePlant\n"
        f"class Copied(FakePlant):\n    forkable = {is_forkable}\n"
    )
    plant = f"{tmp_path}/plant.py:Copied"
    with closing(gym.make("zenostat/Plant-v1", plant=plant, plant_arguments=BUILDING, reward=None)) as env:
        env.reset(seed=5)
        env.action_space.seed(5)
        actions = [env.action_space.sample() for _ in range(20)]
        steps(env, actions[:10])
        with env.unwrapped.snapshot() as snapshot:
            first = steps(env, actions[10:])
            env.reset(options={"snapshot": snapshot})
            assert steps(env, actions[10:]) == first
