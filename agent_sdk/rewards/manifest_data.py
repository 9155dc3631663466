"""Rewards as the data of a manifest, and the rewards that a manifest names."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from zenostat.agent_sdk.rewards.base import Reward
from zenostat.agent_sdk.rewards.comfort_band import ComfortBand
from zenostat.agent_sdk.rewards.multi_zone import MultiZoneReward
from zenostat.agent_sdk.rewards.reward_reader import CUSTOM, REWARDS, read_reward
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest, Task


def is_data(reward: Reward) -> bool:
    """Return whether a reward is one that `read_reward` can read again from its data, and not code of the user's."""
    return type(reward) in REWARDS.values()


def reward_data(reward: Reward | None) -> dict[str, Any] | None:
    """Return a reward as a kind with its parameters; of code of the user's, the kind `custom` and its name."""
    if reward is None:
        return None
    if is_data(reward):
        data: dict[str, Any] = reward.model_dump(mode="json", exclude_defaults=True)  # type: ignore[attr-defined]
        return data
    return {"kind": CUSTOM, "name": str(getattr(reward, "name", type(reward).__name__))}


def task_paying(task: Task, reward: Reward | None) -> Task:
    """Return a task whose `reward` is the one that an environment pays; the same object if it is already."""
    data = reward_data(reward)
    with suppress(InvalidConfig):  # the node's own reward need not be readable here
        if task.reward == data or (reward is not None and _read(task.reward) == reward):
            return task
    return task.with_reward(data)


def known_rewards(manifest: Manifest) -> list[Reward]:
    """Return the reward that is paid and the scenario's own, without those that this process cannot read.

    Such are code of another program, and kinds of another version.
    """
    rewards = _read(manifest.task.reward), _read(manifest.task.scenario_reward)
    return [reward for reward in rewards if reward is not None]


def comfort_reward(manifest: Manifest) -> ComfortBand | MultiZoneReward | None:
    """Return the reward that defines comfort: the paid one, else that of the scenario; None if neither has a band."""
    rated = [reward for reward in known_rewards(manifest) if isinstance(reward, ComfortBand | MultiZoneReward)]
    return rated[0] if rated else None


def _read(data: dict[str, Any] | None) -> Reward | None:
    return read_reward(data) if data is not None and data.get("kind") in REWARDS else None
