"""Errors without Ray, or without a cluster that answers: one sentence."""

import importlib.util
import sys
from collections.abc import Callable

import numpy as np
import pytest
from support.nodes import free_port

import zenostat.agent_sdk.ray
from zenostat.topics.errors import InvalidConfig, NodeNotFound

without_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is not None, reason="Ray is installed")


@without_ray
@pytest.mark.parametrize(
    "call",
    [zenostat.agent_sdk.ray.register, lambda: zenostat.agent_sdk.ray.connect("127.0.0.1:6379")],
    ids=["register", "connect"],
)
def test_ray__without_ray_the_command_that_installs_it(call: Callable[[], object]) -> None:
    with pytest.raises(InvalidConfig, match=r"^zenostat\.ray needs ray.*pip install -e '.*\[ray\]'$"):
        call()


@pytest.mark.parametrize("address", ["localhost", "ray://somewhere", ":6379", ""])
def test_ray__address_that_cannot_be(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", sys)
    with pytest.raises(InvalidConfig, match="is not the address of a Ray cluster; write HOST:PORT"):
        zenostat.agent_sdk.ray.connect(address)


def test_ray__cluster_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", sys)
    port = free_port()
    with pytest.raises(NodeNotFound, match=rf"^no Ray cluster answers at 127\.0\.0\.1:{port} \(.*refused.*ray start"):
        zenostat.agent_sdk.ray.connect(f"127.0.0.1:{port}")


@pytest.mark.parametrize("numbers", [{"runners": -1}, {"runners": 1, "cores": 0}, {"runners": 1, "cores": 257}])
def test_ray__numbers_that_cannot_be(numbers: dict[str, int]) -> None:
    with pytest.raises(InvalidConfig, match=r"a number from (0|1 to 256) expected"):
        zenostat.agent_sdk.ray.set_env_runners(None, **numbers)


class Context(dict[str, object]):
    """Context that RLlib passes to a creator."""

    worker_index = 2


def test_creator__creates_the_requested_environment() -> None:
    """A single environment, or a vector whose seeds no other EnvRunner has."""
    building = {"id": "Fake-v1", "zones": 2, "steps_per_hour": 1}
    single = zenostat.agent_sdk.ray.create_env(Context(building))
    assert single.unwrapped.manifest.slots == 1
    vector = zenostat.agent_sdk.ray.create_env(Context(building, num_envs=3))
    assert vector.num_envs == 3
    seeds: list[int | None] = []
    vector.env.reset = lambda *, seed, options: seeds.append(seed)  # type: ignore[method-assign,union-attr]
    vector.reset(seed=np.int64(7 + Context.worker_index))
    vector.reset(seed=None)
    assert seeds == [7 + 3 * Context.worker_index, None]
