"""Episodes whose engine is forked or prefetched: equal to fresh starts to the bit, and no resources are leaked."""

import os
import signal
from pathlib import Path

import numpy as np
import psutil
import pytest
from support import data_packs as packs
from support.engine_forks import KINDS, SMALL, engines, make
from support.nodes import runs, until, within

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.topics.errors import EngineDied

ALL = KINDS | {
    "many zones, whose points fill more than a socket takes at once": "outpatient-USA_FL_Orlando-continuous-v1"
}


def play(env: BuildingEnv, *, steps: int | None = None) -> tuple[str, np.ndarray]:
    """Play an episode with fixed actions; return where its engine came from, and observations with rewards."""
    observation, info = env.reset()
    env.action_space.seed(11)
    rows, ended = [np.append(observation, 0.0)], False
    while not ended and (steps is None or len(rows) <= steps):
        observation, reward, _, ended, _ = env.step(env.action_space.sample())
        rows.append(np.append(observation, reward))
    return info["engine_start"], np.array(rows)


def play_on(env: BuildingEnv) -> None:
    for _ in range(5):
        env.step(env.action_space.sample())


@pytest.mark.variants
@pytest.mark.parametrize("kind", ALL)
def test_fork__equals_a_fresh_start_to_the_bit(kind: str, scratch: Path) -> None:
    """An environment that keeps EnergyPlus's output starts an engine per episode; the other one forks.

    The second fork follows an episode that was ended early, after the template has waited for a whole episode.
    """
    packs.sinergym()
    fresh, forking = make(ALL[kind], output_dir=scratch / "kept"), make(ALL[kind])
    began, expected = play(fresh)
    again, second = play(fresh)
    assert (began, again) == ("reused", "started")
    np.testing.assert_array_equal(expected, second)
    for start, steps in (("reused", None), ("forked", 40), ("forked", None)):
        began, rows = play(forking, steps=steps)
        assert began == start
        np.testing.assert_array_equal(rows, expected[: len(rows)])
    assert len(rows) == len(expected)
    fresh.close()
    forking.close()


@pytest.mark.slow
def test_resets__leak_no_resources(scratch: Path) -> None:
    """After fifty episodes there are as many processes, descriptors, files and folders as after three."""
    env = make(SMALL)
    node = psutil.Process(env.local_node.pid)

    def resources() -> tuple[int, int, int]:
        return len(engines(env)), node.num_fds(), len(within(scratch))

    for _ in range(3):
        play(env, steps=2)
    until(lambda: len(engines(env)) == 2, "the former engines have ended")
    before = resources()
    for _ in range(50):
        assert play(env, steps=2)[0] == "forked"
    until(lambda: resources() == before, "all is as it was")
    env.close()


@pytest.mark.slow
def test_template__is_restarted_after_its_death(scratch: Path) -> None:
    """Its death does not affect a running episode."""
    env = make(SMALL)
    _, expected = play(env)
    env.reset()
    waiting, running = until(lambda: len(running := engines(env)) == 2 and running, "the former engine has ended")
    env.action_space.seed(11)
    env.step(env.action_space.sample())
    waiting.kill()
    until(lambda: not runs(waiting), "the engine has ended")
    assert running.is_running()
    ended = False
    while not ended:
        _, _, _, ended, _ = env.step(env.action_space.sample())
    began, rows = play(env)
    assert began == "started"
    np.testing.assert_array_equal(rows, expected)
    assert play(env, steps=1)[0] == "forked"
    env.close()


@pytest.mark.slow
def test_killed_fork__raises_and_the_next_episode_runs(scratch: Path) -> None:
    env = make(SMALL)
    _, expected = play(env)
    env.reset()
    env.step(env.action_space.sample())
    os.kill(engines(env)[-1].pid, signal.SIGKILL)
    with pytest.raises(EngineDied, match="SIGKILL"):
        play_on(env)
    began, rows = play(env)
    assert began == "forked"
    np.testing.assert_array_equal(rows, expected)
    env.close()


@pytest.mark.slow
def test_prefetch__equals_a_fresh_start_with_noise(scratch: Path) -> None:
    """A prefetched engine has the weather of a fresh start; an unexpected seed starts another engine."""
    name = SMALL.replace("continuous", "continuous-stochastic")
    env, plain = make(name), make(name, output_dir=scratch / "kept")

    def began(one: BuildingEnv, seed: int | None) -> tuple[str, list[list[float]]]:
        observation, info = one.reset(seed=seed)
        rows = [observation.tolist()]
        rows += [one.step([20.0, 25.0])[0].tolist() for _ in range(60)]
        return info["engine_start"], rows

    for seed, start in (
        (4, "started"),
        (None, "prefetched"),
        (None, "prefetched"),
        (4, "started"),
        (None, "prefetched"),
    ):
        got, expected = began(env, seed), began(plain, seed)
        assert got[0] == start
        assert got[1] == expected[1]
    for seed, start in ((5, "started"), (6, "started"), (7, "started"), (None, "started"), (None, "prefetched")):
        assert began(env, seed)[0] == start
    assert len(engines(env)) == 2
    assert len([path for path in within(env.local_node.folder) if path.suffix == ".epw"]) == 2
    env.close()
    plain.close()


@pytest.mark.slow
def test_prefetch__weather_files_in_sequence(scratch: Path) -> None:
    names = ["USA_CO_Denver", "USA_FL_Miami"]
    env = make(SMALL, weather=names, weather_order="sequence")
    seen = []
    for _ in range(5):
        _, info = env.reset()
        env.step([20.0, 25.0])
        seen.append((info["weather"], info["engine_start"]))
    assert [weather for weather, _ in seen] == [names[i % 2] for i in range(5)]
    assert [start for _, start in seen] == ["reused", *["prefetched"] * 4]
    env.close()


@pytest.mark.slow
def test_prefetch__replaces_an_engine_that_died(scratch: Path) -> None:
    env = make(SMALL, weather=["USA_CO_Denver", "USA_FL_Miami"], weather_order="sequence")
    env.reset()
    env.step([20.0, 25.0])
    ahead = until(lambda: len(running := engines(env)) == 2 and running[-1], "the next engine is there")
    ahead.kill()
    until(lambda: not runs(ahead), "it has ended")
    _, info = env.reset()
    assert (info["weather"], info["engine_start"]) == ("USA_FL_Miami", "started")
    env.close()
