"""Seeds that cannot be: one clear error that names the range, by each way to reset."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import zenostat
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.agent_sdk.envs.zone_agents import ZonesEnv
from zenostat.agent_sdk.testing import Climate, FakeBuilding, FakeLink
from zenostat.topics.errors import InvalidConfig

WRONG = pytest.mark.parametrize(
    "seed", [2**70, 2**64, -1, 1.0, 1.5, True, "1", np.float64(2), np.bool_(True)], ids=repr
)
RANGE = r"seed = .*; an integer from 0 to 2\*\*64 - 1 expected"


def zones() -> ZonesEnv:
    return ZonesEnv(link=FakeLink(FakeBuilding(2, control="zone")))


@WRONG
@pytest.mark.parametrize("make_env", [lambda: BuildingEnv(link=FakeLink()), zones])
def test_seeds__one_building(make_env: Callable[[], Any], seed: Any) -> None:
    env = make_env()
    with pytest.raises(InvalidConfig, match=RANGE):
        env.reset(seed=seed)
    env.reset(seed=2**64 - 1)
    env.close()


@WRONG
def test_seeds__slots(seed: Any) -> None:
    env = BuildingVectorEnv(2, link=FakeLink([FakeBuilding(), FakeBuilding()]))
    with pytest.raises(InvalidConfig, match=r"seed = .*; an integer from 0 to 2\*\*64 - 2 expected"):
        env.reset(seed=seed)
    with pytest.raises(InvalidConfig, match=RANGE):
        env.reset(seed=[0, seed])
    env.reset(seed=2**64 - 2)
    env.reset(seed=[2**64 - 1, None])
    env.close()


def test_seeds__of_numpy_are_taken() -> None:
    env = BuildingEnv(link=FakeLink())
    assert np.array_equal(env.reset(seed=np.int64(5))[0], env.reset(seed=5)[0])
    env.close()


@pytest.mark.slow
def test_seeds__controller_without_gymnasium(bus: zenostat.Bus) -> None:
    with bus.controller("office") as link:
        wrong: list[Any] = [2**70, -1, 1.5, [2**70]]
        for seed in wrong:
            with pytest.raises(InvalidConfig, match=RANGE):
                link.reset(seed=seed)
        link.reset(seed=2**64 - 1)


def test_seeds__array_that_is_no_number() -> None:
    with pytest.raises(InvalidConfig, match=RANGE):
        BuildingEnv(link=FakeLink()).reset(seed=np.array([3]))  # type: ignore[arg-type]


def test_seeds__without_one_each_fake_building_draws_its_own_weather() -> None:
    noisy = [FakeBuilding(climate=Climate(noise_k=2.0)) for _ in range(2)]
    env = BuildingVectorEnv(2, link=FakeLink(noisy))
    first, again = env.reset()[0], env.reset()[0]
    temperatures = [*first[:, 0].tolist(), *again[:, 0].tolist()]
    assert len(set(temperatures)) == 4
