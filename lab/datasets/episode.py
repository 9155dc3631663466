"""Run one episode of a controller, and keep all of it in arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.controllers import Agent
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics.errors import InvalidConfig

_EXPLORATION = (int.from_bytes(b"expl"),)
"""Key of the random numbers of exploration, so that they are not those of controllers and plants of the same seed."""


@dataclass(frozen=True, slots=True)
class AgentEpisode:
    """One episode of T timesteps, with what its agent knew.

    Attributes:
        trajectory: with actions and rewards of the environment's spaces, its seed and its weather.
        observations: shape (T + 1, observations); row t is what the controller knew when it chose action t.
        is_random: whether each action was a random one, shape (T,).
        terminated, truncated: how the episode ended.
        metrics: metrics of the reward by name, each with T + 1 rows as `infos` has them.
    """

    trajectory: Trajectory
    observations: NDArray[np.float32]
    is_random: NDArray[np.bool_]
    terminated: bool
    truncated: bool
    metrics: dict[str, NDArray[Any]]

    def infos(self) -> dict[str, Any]:
        """Return arrays of T + 1 rows by name, nested as the environment's infos are.

        Row t + 1 belongs to step t; row 0 is the state after the reset, where terms of the reward are NaN.
        """
        run = self.trajectory
        tables = {
            "effective": dict(zip(run.actuators, run.effective.T, strict=True)),
            "reward_terms": {name: np.append(np.nan, term) for name, term in run.terms.items()},
            "reward_metrics": self.metrics,
        }
        for kind, table in tables.items():
            if separated := [name for name in table if "/" in name]:  # HDF5 would take it for a group
                raise InvalidConfig(f"{kind}: {separated[0]!r} has a '/', which names in a data set cannot have")
        return {
            "time": [time.isoformat() for time in run.time.tolist()],
            "step": run.step,
            "is_random": np.append(False, self.is_random),
        } | {name: table for name, table in tables.items() if table}


def run_episode(
    env: gym.Env[Any, Any],
    agent: Agent,
    *,
    seed: int,
    epsilon: float = 0.0,
    progress: Callable[[int], None] | None = None,
) -> AgentEpisode:
    """Run an episode.

    Args:
        env: an environment whose actions are those of its `BuildingEnv`.
        agent: the controller.
        seed: seed of the weather, and of the random actions.
        epsilon: probability of a random action in place of the controller's, for each timestep by itself.
        progress: callback for each timestep, with the number of steps.
    """
    building: Any = env.unwrapped
    observation, info = env.reset(seed=seed)
    exploration, sampling = np.random.SeedSequence(seed, spawn_key=_EXPLORATION).spawn(2)
    decisions = np.random.default_rng(exploration)
    env.action_space.seed(int(sampling.generate_state(1)[0]))
    recorder = TrajectoryRecorder(building.manifest)
    recorder.add(building.sample)
    observations, metrics = [observation], [info.get("reward_metrics", {})]
    actions, rewards, is_random = [], [], []
    terminated = truncated = False
    while not (terminated or truncated):
        action = agent.action(building.sample)  # also where it is not sent: controllers count their timesteps
        is_random.append(bool(decisions.random() < epsilon))
        if is_random[-1]:
            action = env.action_space.sample()
        observation, reward, terminated, truncated, info = env.step(action)
        recorder.add(building.sample, info.get("reward_terms"))
        observations.append(observation)
        actions.append(action)
        rewards.append(float(reward))
        metrics.append(info.get("reward_metrics", {}))
        if progress is not None:
            progress(len(rewards))
    trajectory = replace(
        recorder.trajectory(),
        actions=np.asarray(actions, env.action_space.dtype),
        rewards=np.asarray(rewards),
        seed=seed,
        weather=str(info.get("weather", "")),
    )
    return AgentEpisode(
        trajectory,
        np.asarray(observations, env.observation_space.dtype),
        np.asarray(is_random),
        bool(terminated),
        bool(truncated),
        {name: np.asarray([row.get(name, np.nan) for row in metrics]) for name in metrics[-1]},
    )
