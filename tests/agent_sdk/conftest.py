"""A building for tests of snapshots and branches."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.engine_forks import FOUR, drop_forks, make

from zenostat.agent_sdk.envs.building_env import BuildingEnv


@pytest.fixture(scope="module")
def shared_office(module_scratch: Path) -> Iterator[BuildingEnv]:
    env = make(**FOUR)
    yield env
    env.close()


@pytest.fixture
def office(shared_office: BuildingEnv) -> Iterator[BuildingEnv]:
    """The environment that tests of a module share; it begins and ends without snapshots and branches."""
    yield shared_office
    drop_forks(shared_office)
