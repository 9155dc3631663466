"""An engine that neither answers nor computes is given up; one that computes is left alone."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import psutil
import pytest
from support.events import events_of, next_event
from support.nodes import SMALL, Program, engines_of, node_on_bus, until

import zenostat
from zenostat.bridge.runtime.idle_watch import IdleWatch
from zenostat.topics.errors import EngineUnresponsive, InvalidConfig
from zenostat.topics.messages import EngineStart, EventKind

pytestmark = pytest.mark.usefixtures("scratch")

SOON: dict[str, Any] = {"unresponsive_s": 2.0, "affinity": "off"}
NOISE = "zenostat/ref-small-office-USA_CO_Denver-continuous-stochastic-v1"
DAY: dict[str, Any] = {key: SMALL[key] for key in ("begin", "end", "steps_per_hour")}
MESSAGE = r"neither answered nor used processor time for 2 s after sample 1, and was killed"


def test_engine__process_is_idle_only_while_it_uses_no_processor_time() -> None:
    with Program("while True: pass") as busy, Program("input()") as idle:
        burns, rests = IdleWatch(busy.pid), IdleWatch(idle.pid)
        assert burns.look(5.0) == 0.0
        until(lambda: burns.look(5.0) == 0.0, "it has used more")
        busy_process = psutil.Process(busy.pid)
        busy_process.suspend()
        until(lambda: burns.look(5.0) >= 20.0, "it stands still now")
        busy_process.resume()
        until(lambda: burns.look(5.0) == 0.0, "it goes on")
        until(lambda: rests.look(5.0) >= 20.0, "it waits for its input")
    assert burns.look(5.0) >= 0.0, "it has ended"


@pytest.mark.slow
def test_engine__timestep_of_an_engine_that_hangs_fails_by_name() -> None:
    with gym.make("zenostat/Building-v1", **SMALL, **SOON) as env:
        env.reset(seed=1)
        env.step(env.action_space.low)
        own = env.unwrapped.local_node
        engine = engines_of(own.pid)[-1]
        engine.suspend()
        with pytest.raises(EngineUnresponsive, match=MESSAGE):
            env.step(env.action_space.low)
        env.reset(seed=1)
        assert env.step(env.action_space.low)[-1]["step"] == 1


@pytest.mark.slow
def test_engine__one_of_several_that_hangs_fails_the_step() -> None:
    env = gym.make_vec("zenostat/Building-v1", num_envs=2, vectorization_mode="vector_entry_point", **SMALL, **SOON)
    env.reset(seed=1)
    low = np.stack([env.single_action_space.low] * 2)
    env.step(low)
    engines_of(env.unwrapped.local_node.pid)[-1].suspend()
    with pytest.raises(EngineUnresponsive, match=MESSAGE):
        env.step(low)
    env.reset(seed=1)
    env.step(low)
    env.close()


@pytest.mark.slow
def test_engine__event_is_reported(folder: Path) -> None:
    with (
        node_on_bus(folder / "node", **SMALL, unresponsive_s=2.0) as (node, bus),
        bus.controller("office", name="mine") as link,
    ):
        link.reset().send()
        sample = link.receive()
        engines_of(node.pid)[-1].suspend()
        with events_of(bus) as events:
            sample.send()
            assert next_event(events, EventKind.FAILED).error == "EngineUnresponsive"
        assert bus.status("office").failure_error == "EngineUnresponsive"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settings", "place", "engine_start"),
    [("zenostat/Building-v1", SMALL, 0, EngineStart.FORKED), (NOISE, DAY, 1, EngineStart.PREFETCHED)],
    ids=["waiting", "prefetched"],
)
def test_engine__one_that_waits_for_the_next_episode_is_replaced_with_a_warning(
    name: str, settings: dict[str, Any], place: int, engine_start: EngineStart
) -> None:
    """And harms no episode."""
    with gym.make(name, **settings, **SOON) as env:
        env.reset(seed=1)
        env.step(env.action_space.low)
        own = env.unwrapped.local_node
        until(lambda: len(engines_of(own.pid)) == 2, "another engine waits")
        engines_of(own.pid)[place].suspend()
        with zenostat.connect(own.endpoint, affinity="off") as bus, events_of(bus, "building") as events:
            assert env.reset()[1]["engine_start"] == engine_start
            assert env.step(env.action_space.low)[-1]["step"] == 1
            assert "replaced: the engine process neither answered" in next_event(events, EventKind.WARNING).text


def test_engine__no_time_at_all_is_refused() -> None:
    with pytest.raises(InvalidConfig, match="unresponsive_s"):
        gym.make("zenostat/Building-v1", **SMALL, unresponsive_s=0.0)
