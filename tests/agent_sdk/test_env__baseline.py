"""Baseline of an episode, reported beside it: the building's own control, in that control's own episode, to the bit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import data_packs as packs
from support.engine_forks import FOUR, KINDS, SMALL, engines, kill, make, plan, row, same

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.topics.errors import EngineDied

Rows = list[list[float]]


def beside(info: dict[str, Any]) -> list[float]:
    return [*info["baseline"].tolist(), *info["baseline_effective"].tolist()]


def own_control(env: BuildingEnv, **reset: Any) -> Rows:
    """An episode that nobody commands: its points, and what its actuators really were."""
    env.reset(**reset)
    rows = []
    while True:
        rows.append([*env.sample.values.tolist(), *env.sample.effective.tolist()])
        if env.sample.truncated:
            return rows
        env.link.send(np.zeros(len(env.manifest.actuators)), bytes(len(env.manifest.actuators)))
        env._sample = env.link.receive()


def run(env: BuildingEnv, actions: list[Any]) -> tuple[Rows, Rows]:
    """Run an episode; return its own rows and those of its baseline, one for each step."""
    mine, its = [], []
    for action in actions:
        _, reward, *_, info = env.step(action)
        mine.append(row(env, reward))
        its.append(beside(info))
    return mine, its


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("kind", KINDS)
def test_env__it_is_the_episode_that_nobody_commands(kind: str, scratch: Path) -> None:
    """Whatever the agent does, after a reset, and after going back; and the agent's episode is the same without it."""
    packs.sinergym()
    plain, env = make(KINDS[kind]), make(KINDS[kind], baseline=True)
    expected = own_control(plain)
    last, mine, its = plain.manifest.steps, plan(plain, 1), plan(plain, 2)
    plain.reset()
    first, none = _plain(plain, mine)
    plain.reset()
    second, _ = _plain(plain, its)
    assert none == "no baseline"
    assert first != second
    for actions, wanted in ((mine, first), (its, second), (mine, first)):
        _, info = env.reset()
        same([beside(info)], expected[:1])
        got, other = run(env, actions)
        same(got, wanted)
        same(other, expected[1:])
    env.reset()
    half = last // 2
    run(env, mine[:half])
    snapshot = env.snapshot()
    got, other = run(env, mine[half:])
    same(got, first[half:])
    for _ in range(2):
        _, info = env.reset(options={"snapshot": snapshot})
        same([beside(info)], expected[half : half + 1])
        got, other = run(env, mine[half:])
        same(got, first[half:])
        same(other, expected[half + 1 :])
    env.reset()
    same(run(env, its)[1], expected[1:])
    plain.close()
    env.close()


def _plain(env: BuildingEnv, actions: list[Any]) -> tuple[Rows, str]:
    rows = []
    for action in actions:
        _, reward, *_, info = env.step(action)
        assert not {"baseline", "baseline_effective"} & set(info)
        rows.append(row(env, reward))
    return rows, "no baseline"


@pytest.mark.slow
def test_env__it_has_the_weather_of_its_episode(scratch: Path) -> None:
    name = SMALL.replace("continuous", "continuous-stochastic")
    plain, env = make(name, **FOUR), make(name, baseline=True, **FOUR)
    seen = []
    for seed in (3, None, None):
        expected = own_control(plain, seed=seed)
        _, info = env.reset(seed=seed)
        same([beside(info)], expected[:1])
        same(run(env, plan(env, 1))[1], expected[1:])
        seen.append(expected[-1])
    assert len({tuple(last) for last in seen}) == 3
    plain.close()
    env.close()


def test_env__branch_has_none(scratch: Path) -> None:
    env = make(baseline=True, **FOUR)
    _, info = env.reset()
    run(env, plan(env, 1, 5))
    with env.branch() as branch:
        *_, info = branch.step(plan(env, 1, 1)[0])
        assert "baseline" not in info
        assert not branch.manifest.baseline
    env.close()


@pytest.mark.slow
def test_env__its_engines_end_with_their_episodes(scratch: Path) -> None:
    """One for the episode, one beside it, one that waits: no more after many resets and goings back than before."""
    env = make(baseline=True, **FOUR)
    env.reset()
    run(env, plan(env, 1, 3))
    count = len(engines(env))
    assert count == 3
    with env.snapshot() as snapshot:
        assert len(engines(env)) == 5
        for _ in range(4):
            env.reset()
            run(env, plan(env, 1, 2))
            env.reset(options={"snapshot": snapshot})
            run(env, plan(env, 1, 2))
        assert len(engines(env)) == 5
    assert len(engines(env)) == count
    env.close()


@pytest.mark.slow
def test_env__snapshot_of_which_the_baseline_was_killed_changes_nothing(scratch: Path) -> None:
    """The running episode goes on, with its own weather, its own baseline, and nothing of the failed try."""
    name = SMALL.replace("continuous", "continuous-stochastic")
    env = make(name, baseline=True, **FOUR)
    mine = plan(env, 1)
    env.reset(seed=3)
    straight, beside_it = run(env, mine)
    env.reset(seed=4)
    run(env, mine[:2])
    before = {engine.pid for engine in engines(env)}
    snapshot = env.snapshot()
    of_it = sorted((engine for engine in engines(env) if engine.pid not in before), key=lambda engine: engine.pid)
    env.reset(seed=3)
    weather = env.weather(["dry_bulb_temperature"]).values
    got, other = run(env, mine[:20])
    kill(of_it[1])
    count = len(engines(env))
    for _ in range(2):
        with pytest.raises(EngineDied, match="SIGKILL"):
            env.reset(options={"snapshot": snapshot})
        assert env.weather(["dry_bulb_temperature"]).values == weather
        assert len(engines(env)) == count
    more, rest = run(env, mine[20:])
    same(got + more, straight)
    same(other + rest, beside_it)
    env.close()


@pytest.mark.slow
def test_env__killed_baseline_is_an_error_that_is_reported_and_the_next_episode_runs(scratch: Path) -> None:
    env = make(baseline=True, **FOUR)
    mine = plan(env, 1)
    env.reset()
    straight = run(env, mine)
    env.reset()
    run(env, mine[:5])
    kill(engines(env)[-1])
    with pytest.raises(EngineDied, match="SIGKILL"):
        run(env, mine[5:])
    env.reset()
    assert str(run(env, mine)) == str(straight)
    env.close()
