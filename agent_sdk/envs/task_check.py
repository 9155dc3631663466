"""Check the agent's part of a task against the points of a node that is not running: reward, actions, wrappers."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.rewards import Reward, RewardConfig, read_reward
from zenostat.agent_sdk.wrappers.serialization import apply_wrappers, check_wrappers
from zenostat.topics.errors import ErrorCollector, InvalidConfig
from zenostat.topics.messages import Manifest


def check_task(manifest: Manifest) -> None:
    """Bind reward, actions and wrappers of a task to the points of a manifest, as an environment does when it is made.

    Errors of form are those of `zenostat.agent_sdk.envs.arguments.check_agent_fields`, and not repeated here.

    Raises:
        InvalidConfig: lists all points that do not exist or have other units, and wrappers that do not work here.
    """
    errors = ErrorCollector()
    reward = _well_formed_reward(manifest)
    texts = [] if reward is None else _binding_errors(reward, manifest)
    errors.errors += [InvalidConfig(text) for text in texts]
    with suppress(InvalidConfig):
        check_wrappers(manifest.task.wrappers)
        errors.collect(lambda: _make_environment(manifest, None if texts else reward))
    errors.raise_if_any()


def _well_formed_reward(manifest: Manifest) -> Reward | None:
    with suppress(InvalidConfig):
        return None if manifest.task.reward is None else read_reward(manifest.task.reward)
    return None


def _binding_errors(reward: Reward, manifest: Manifest) -> list[str]:
    """Return the errors of binding a reward, one for each point that it names and that does not fit."""
    try:
        reward.bind(manifest)
    except InvalidConfig as error:
        texts = [str(error)]
    else:
        return []
    if isinstance(reward, RewardConfig):
        names = {field: value for field, value in reward if _is_names(value)}
        for field, values in names.items():
            for name in values:  # alone, because binding ends at its first error
                alone = reward.model_copy(update={**dict.fromkeys(names), field: (name,)})
                try:
                    alone.bind(manifest)
                except InvalidConfig as error:
                    texts += [str(error)] if repr(name) in str(error) else []
    return list(dict.fromkeys(texts))


def _is_names(value: Any) -> bool:
    return isinstance(value, tuple) and bool(value) and all(isinstance(name, str) for name in value)


class _NoNode:
    """The link of an environment that is made and closed."""

    name = "check"

    def __init__(self, manifest: Manifest) -> None:
        self.manifest = manifest

    def close(self) -> None:
        """Do nothing."""


def _make_environment(manifest: Manifest, reward: Reward | None) -> None:
    link: Any = _NoNode(manifest)
    with BuildingEnv(link=link, reward=reward) as env:
        apply_wrappers(env, manifest.task.wrappers)
