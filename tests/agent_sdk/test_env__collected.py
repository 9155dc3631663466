"""An environment that is not closed: all that it holds ends when it is collected."""

import gc
import threading
import weakref
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
from support.nodes import SMALL, NodeProgram

import zenostat  # noqa: F401  # registers the environments

PLANT = f"{Path(__file__).parents[2] / 'examples' / 'own_plant.py'}:HeatPumpRoom"


def collect_unclosed(*args: Any, **arguments: Any) -> None:
    """Make an environment, take a step, drop it, and check that its buses and their threads are no more."""
    threads = set(threading.enumerate())
    make = gym.make_vec if len(args) > 1 else gym.make
    env: Any = make(*args, **arguments)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    buses = [weakref.ref(inner.link.bus) for inner in getattr(env.unwrapped, "envs", [env.unwrapped])]
    del env
    gc.collect()
    gc.collect()  # the first one closes the buses, which hold links that hold them
    assert [bus() for bus in buses] == [None] * len(buses)
    assert not set(threading.enumerate()) - threads


@pytest.mark.parametrize("args", [("zenostat/Plant-v1",), ("zenostat/Plant-v1", 2)], ids=["single", "vector"])
def test_env__collected_without_close_leaves_no_bus_and_no_thread(args: tuple[Any, ...]) -> None:
    collect_unclosed(*args, plant=PLANT, reward=None)


@pytest.mark.slow
def test_fleet__collected_without_close_leaves_no_bus_and_no_thread(scratch: Path) -> None:
    with NodeProgram(scratch / "one", **SMALL) as one, NodeProgram(scratch / "two", **SMALL) as two:
        collect_unclosed("zenostat/Building-v1", 2, connect=[one.endpoint, two.endpoint], node="office")
