"""Run one episode of a controller, and keep all of it in arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from zenostat.agent_sdk.controllers import Agent


@dataclass(frozen=True, slots=True)
class Episode:
    """One episode of T timesteps.

    Attributes:
        seed: the seed of its reset.
        weather: the name of its weather file.
        observations: shape (T + 1, observations); row t is what the controller knew when it chose action t.
        actions: as of the environment's space, shape (T, actions), or (T,) for a single discrete action.
        rewards: shape (T,).
        terminations, truncations: shape (T,); only the last of either is true.
        infos: arrays of T + 1 rows by name, nested as the environment's infos are. Row t + 1 belongs to step t; row 0
            is the state after the reset, where terms of the reward are NaN.
    """

    seed: int
    weather: str
    observations: NDArray[np.float32]
    actions: NDArray[Any]
    rewards: NDArray[np.float64]
    terminations: NDArray[np.bool_]
    truncations: NDArray[np.bool_]
    infos: dict[str, Any]


def run_episode(
    env: gym.Env[Any, Any],
    agent: Agent,
    *,
    seed: int,
    epsilon: float = 0.0,
    progress: Callable[[int], None] | None = None,
) -> Episode:
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
    exploration = np.random.default_rng(seed)
    env.action_space.seed(seed)
    observations, infos = [observation], [_info_row(building, info, is_random=False)]
    actions, rewards, terminations, truncations = [], [], [], []
    is_over = False
    while not is_over:
        action = agent.action(building.sample)  # also where it is not sent: controllers count their timesteps
        is_random = bool(exploration.random() < epsilon)
        if is_random:
            action = env.action_space.sample()
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(float(reward))
        terminations.append(bool(terminated))
        truncations.append(bool(truncated))
        infos.append(_info_row(building, info, is_random=is_random))
        is_over = terminated or truncated
        if progress is not None:
            progress(len(rewards))
    return Episode(
        seed=seed,
        weather=str(info.get("weather", "")),
        observations=np.asarray(observations, env.observation_space.dtype),
        actions=np.asarray(actions, env.action_space.dtype),
        rewards=np.asarray(rewards),
        terminations=np.asarray(terminations),
        truncations=np.asarray(truncations),
        infos=_columns(infos),
    )


def _info_row(building: Any, info: dict[str, Any], *, is_random: bool) -> dict[str, Any]:
    """Return the entries of an info that each timestep has, with actuators and terms by name."""
    actuators = [actuator.name for actuator in building.manifest.actuators]
    return {
        "time": str(info["time"]),
        "step": int(info["step"]),
        "is_random": is_random,
        "effective": dict(zip(actuators, map(float, info["effective"]), strict=True)),
        "reward_terms": info.get("reward_terms", {}),
        "reward_metrics": info.get("reward_metrics", {}),
    }


def _columns(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return an array for each key; a key that the first row lacks is NaN there."""
    columns: dict[str, Any] = {}
    for name, value in rows[-1].items():
        if isinstance(value, dict):
            parts = [{key: row[name].get(key, np.nan) for key in value} for row in rows]
            if value:
                columns[name] = _columns(parts)
        elif isinstance(value, str):
            columns[name] = [row[name] for row in rows]
        else:
            columns[name] = np.asarray([row[name] for row in rows])
    return columns
