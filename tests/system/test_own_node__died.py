"""An environment whose own node died starts another one at its next reset, and says why."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import psutil
import pytest
from support.nodes import SMALL

import agent_sdk  # noqa: F401  # registers the environments
from topics.errors import EpisodeChanged, InvalidConfig, NodeLost, NodeNotFound

pytestmark = pytest.mark.usefixtures("scratch")

STARTED = r"own node had ended \(killed by SIGKILL.*\), and another one was started"


def kill_node(env: Any) -> None:
    node = psutil.Process(env.unwrapped.local_node.pid)
    node.kill()
    with pytest.raises(NodeLost, match="is gone"):
        step_for_ever(env)


def step_for_ever(env: Any) -> None:
    while True:
        env.step(env.action_space.sample())


def test_a_single_environment() -> None:
    env = gym.make("zenostat/Building-v1", **SMALL, affinity="off")
    first, _ = env.reset(seed=7)
    action = env.action_space.sample()
    stepped = env.step(action)[0]
    snapshot = env.unwrapped.snapshot()
    instance = env.unwrapped.manifest.instance
    kill_node(env)
    with pytest.warns(UserWarning, match=STARTED), pytest.raises(InvalidConfig, match="was restarted"):
        env.reset(options={"snapshot": snapshot})
    again, _ = env.reset(seed=7)
    assert env.unwrapped.manifest.instance != instance
    assert np.array_equal(first, again)
    assert np.array_equal(env.step(action)[0], stepped)
    env.close()


def test_it_dies_again_and_again() -> None:
    env = gym.make("zenostat/Building-v1", **SMALL, affinity="off")
    for _ in range(2):
        env.reset()
        psutil.Process(env.unwrapped.local_node.pid).kill()  # the reset follows at once
        with pytest.warns(UserWarning, match=STARTED):
            env.reset()
        env.step(env.action_space.sample())
    env.close()


def test_a_vector_environment() -> None:
    env = gym.make_vec("zenostat/Building-v1", 2, "vector_entry_point", **SMALL, affinity="off")
    first, _ = env.reset(seed=7)
    kill_node(env)
    with pytest.warns(UserWarning, match=STARTED), pytest.raises(EpisodeChanged, match="all slots"):
        env.reset(options={"reset_mask": np.array([True, False])})
    again, _ = env.reset(seed=7)
    assert np.array_equal(first, again)
    env.step(env.action_space.sample())
    env.close()


def test_a_node_of_somebody_elses_is_not_started_again() -> None:
    own = gym.make("zenostat/Building-v1", **SMALL, affinity="off")
    node = own.unwrapped.local_node
    env = gym.make("zenostat/Building-v1", connect=node.endpoint, node="building", priority=9, affinity="off")
    env.reset()
    psutil.Process(node.pid).kill()
    with pytest.raises(NodeLost, match="is gone"):
        step_for_ever(env)
    with pytest.raises(NodeNotFound, match="no node 'building'"):
        env.reset()
    env.close()
    own.close()
