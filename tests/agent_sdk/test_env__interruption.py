"""A timestep that Ctrl-C interrupted is simulated nevertheless, so the environment does not go on behind it."""

from contextlib import closing
from typing import Any

import gymnasium as gym
import pytest
from support.nodes import SMALL

import zenostat  # noqa: F401  # registers the environments
from zenostat.topics.errors import EpisodeChanged

DAY: dict[str, Any] = {"steps_per_hour": 1, "control": "building"}
REFUSAL = "an interrupted step ends its episode"


def interrupt(env: Any, actions: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Press Ctrl-C while the environment waits for the sample of a timestep."""

    def receive() -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(env.unwrapped.link, "receive", receive)
        with pytest.raises(KeyboardInterrupt):
            env.step(actions)


@pytest.mark.parametrize("slots", [0, 2])
def test_env__interrupted_step_needs_a_reset(slots: int, monkeypatch: pytest.MonkeyPatch) -> None:
    make = gym.make_vec("zenostat/Fake-v1", num_envs=slots, **DAY) if slots else gym.make("zenostat/Fake-v1", **DAY)
    with closing(make) as env:
        env.reset(seed=0)
        actions = env.action_space.sample()
        expected = env.step(actions)[0].tolist()
        interrupt(env, actions, monkeypatch)
        for _ in range(2):
            with pytest.raises(EpisodeChanged, match=REFUSAL):
                env.step(actions)
        env.reset(seed=0)
        assert env.step(actions)[0].tolist() == expected


def test_env__interrupted_reset_needs_a_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    def reset(**_: Any) -> None:
        raise KeyboardInterrupt

    with closing(gym.make("zenostat/Fake-v1", **DAY)) as env:
        env.reset(seed=0)
        with monkeypatch.context() as patch:
            patch.setattr(env.unwrapped.link, "reset", reset)  # type: ignore[attr-defined]
            with pytest.raises(KeyboardInterrupt):
                env.reset()
        with pytest.raises(EpisodeChanged, match=REFUSAL):
            env.step(env.action_space.sample())


def test_env__interrupted_step_of_a_real_building(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor do snapshots, branches and trials begin at the sample before it."""
    with closing(gym.make("zenostat/Building-v1", **{**SMALL, "affinity": "off"})) as outermost:
        env: Any = outermost.unwrapped
        env.reset(seed=0)
        actions = env.action_space.sample()
        with env.branch(slots=2) as branch:
            both = branch.action_space.sample()
            branch.step(both)
            interrupt(branch, both, monkeypatch)
            with pytest.raises(EpisodeChanged, match="was interrupted; close it"):
                branch.step(both)
            with pytest.raises(EpisodeChanged, match="was interrupted; close it"):
                branch.plan(both[:, None])
        expected = env.step(actions)[0].tolist()
        interrupt(env, actions, monkeypatch)
        with pytest.raises(EpisodeChanged, match=REFUSAL):
            env.step(actions)
        with pytest.raises(EpisodeChanged):
            env.snapshot()
        with pytest.raises(EpisodeChanged):
            env.branch()
        with pytest.raises(EpisodeChanged):
            env.try_step([actions])
        env.reset(seed=0)
        assert env.step(actions)[0].tolist() == expected
