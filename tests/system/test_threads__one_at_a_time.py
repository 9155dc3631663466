"""Several threads on one environment: one steps, the others get a clear error; close() from another thread."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.nodes import SMALL, until

import zenostat
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv
from zenostat.agent_sdk.envs.zone_agents import ZonesEnv
from zenostat.agent_sdk.rewards import from_function
from zenostat.agent_sdk.testing import FakeBuilding, FakeLink
from zenostat.topics.errors import EpisodeChanged, InvalidAction, UsageError

BUSY = "one thread at a time"


class Gate:
    """A reward during which a step stands still until it is opened."""

    def __init__(self) -> None:
        self.is_in, self.opens = threading.Event(), threading.Event()

    def __call__(self, *_: Any) -> float:
        self.is_in.set()
        self.opens.wait()
        return 1.0


@contextmanager
def in_thread(work: Callable[[], Any]) -> Iterator[Future[Any]]:
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(work)


def building(zones: int = 2) -> FakeBuilding:
    return FakeBuilding(zones, reward=None, control="zone")


def single(gate: Gate) -> Any:
    return BuildingEnv(link=FakeLink(building()), reward=from_function(gate))


def vector(gate: Gate) -> Any:
    return BuildingVectorEnv(2, link=FakeLink([building(), building()]), reward=from_function(gate))


def action_of(env: Any) -> Any:
    if isinstance(env, ZonesEnv):
        return {agent: env.action_space(agent).sample() for agent in env.possible_agents}
    return env.action_space.sample()


def zones(gate: Gate) -> Any:
    return ZonesEnv(link=FakeLink(building()), building_reward=from_function(gate))


def zones_own(gate: Gate) -> Any:
    def rewards(*_: Any) -> dict[str, float]:
        gate()
        return dict.fromkeys(env.possible_agents, 1.0)

    env = ZonesEnv(link=FakeLink(building()), reward=rewards, building_reward=None)
    return env


@pytest.mark.parametrize("make_env", [single, vector, zones, zones_own])
def test_second_thread__is_rejected_and_the_first_goes_on(make_env: Callable[[Gate], Any]) -> None:
    gate = Gate()
    env = make_env(gate)
    env.reset(seed=0)
    with in_thread(lambda: env.step(action_of(env))) as first:
        gate.is_in.wait()
        try:
            for second in (lambda: env.step(action_of(env)), env.reset):
                with pytest.raises(UsageError, match=BUSY):
                    second()
        finally:
            gate.opens.set()
        first.result()
    env.step(action_of(env))
    env.reset()
    env.close()


def test_threads__actions_of_another_thread_are_not_taken_for_ones_own() -> None:
    sb3 = pytest.importorskip("zenostat.agent_sdk.envs.sb3_vec_env")
    gate = Gate()
    gate.opens.set()
    slots = FakeLink([building(), building()])
    env = sb3.as_sb3(BuildingVectorEnv(2, link=slots, reward=from_function(gate), autoreset_mode="SameStep"))
    env.reset()
    actions = np.array([env.action_space.sample()] * 2)
    env.step_async(actions)
    with pytest.raises(UsageError, match="step_async"):
        env.step_async(actions)
    env.step_wait()
    env.step_async(actions)
    env.reset()  # forgets them
    env.step(actions)
    env.close()


def test_threads__step_that_failed_leaves_nothing_behind() -> None:
    gate = Gate()
    gate.opens.set()
    env = single(gate)
    env.reset(seed=0)
    for _ in range(2):
        with pytest.raises(InvalidAction, match="shape"):
            env.step([1.0] * 99)
    env.step(env.action_space.sample())
    env.close()


# On a real node


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.usefixtures("scratch")
@pytest.mark.parametrize("slots", [1, 2])
def test_threads__that_step_a_real_node(slots: int) -> None:
    env: Any = (
        gym.make("zenostat/Building-v1", **SMALL, affinity="off")
        if slots == 1
        else gym.make_vec("zenostat/Building-v1", 2, "vector_entry_point", **SMALL, affinity="off")
    ).unwrapped
    env.reset(seed=0)
    action, ready = env.action_space.sample(), threading.Barrier(4)

    def steps() -> tuple[int, int]:
        done = refused = 0
        ready.wait()
        for _ in range(20):
            try:
                env.step(action)
                done += 1
            except UsageError:
                refused += 1
        return done, refused

    with ThreadPoolExecutor(4) as pool:
        ran = [future.result() for future in [pool.submit(steps) for _ in range(4)]]
    done = sum(count for count, _ in ran)
    assert done
    assert sum(map(sum, ran)) == 80
    *_, info = env.step(action)
    assert np.max(info["step"]) == done + 1  # every step that was taken was simulated once
    env.reset()
    env.step(action)
    env.close()


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.usefixtures("scratch")
@pytest.mark.parametrize("reset", [False, True])
def test_threads__controller_has_one_receiver(bus: zenostat.Bus, *, reset: bool) -> None:
    with bus.controller("office") as link:
        link.reset()
        with in_thread(link.receive) as first:
            until(lambda: link._busy, "the first waits")
            with pytest.raises(UsageError, match=BUSY):
                link.reset() if reset else link.receive()
            link.send()  # any thread may
            assert first.result().step == 1


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.usefixtures("scratch")
@pytest.mark.parametrize("slots", [1, 2])
def test_threads__close_while_another_thread_steps(slots: int) -> None:
    env: Any = (
        gym.make("zenostat/Building-v1", **SMALL, affinity="off")
        if slots == 1
        else gym.make_vec("zenostat/Building-v1", 2, "vector_entry_point", **SMALL, affinity="off")
    ).unwrapped
    env.reset(seed=0)
    stepped = threading.Event()

    def steps() -> None:
        while True:
            try:
                env.step(env.action_space.sample())
            except EpisodeChanged as error:
                if "episode is over" not in str(error):
                    raise
                env.reset()
            stepped.set()

    with in_thread(steps) as stepping:
        stepped.wait()
        env.close()
        with pytest.raises(EpisodeChanged, match="environment is closed"):
            stepping.result()
    env.close()


@pytest.mark.slow
@pytest.mark.usefixtures("scratch")
def test_threads__close_while_another_thread_waits_for_a_sample(bus: zenostat.Bus) -> None:
    link = bus.controller("office")
    link.reset()
    with in_thread(link.receive) as waiting:
        until(lambda: link._busy, "it waits")
        link.close()
        with pytest.raises(EpisodeChanged, match="is disconnected from its node"):
            waiting.result()
    with bus.controller("office") as other:
        other.reset().send()
        assert other.receive().step == 1
