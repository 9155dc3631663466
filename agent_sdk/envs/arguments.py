"""Check the arguments of an environment."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from zenostat.agent_sdk.rewards import AnyReward, read_reward
from zenostat.bridge.client.local_node import LocalNode
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics import yaml12
from zenostat.topics.errors import ErrorCollector, InvalidConfig, UnknownArgument, did_you_mean

FROM_SCENARIO = "scenario"
FROM_SCENARIO_IF_ANY = "scenario, if it has one"
"""Values of `reward` that stand for that of the scenario; without one, the first one warns of a plant's."""


_ELSEWHERE = {
    "seed": "pass it to reset(seed=…)",
    "wrappers": "it is a field of scenario files; zenostat.wrappers.apply_wrappers(env, […]) applies such a list",
}
"""Names that users pass as arguments of an environment, and where they belong."""


def is_of_scenario(reward: AnyReward | None) -> bool:
    """Return whether a value of `reward` stands for that of the scenario."""
    return reward in (FROM_SCENARIO, FROM_SCENARIO_IF_ANY)


def check_arguments(arguments: Mapping[str, Any], env_type: Callable[..., Any]) -> None:
    """Check the names of keyword arguments against the parameters of an environment.

    Raises:
        UnknownArgument: Unknown names; the text lists all of them with similar names.
    """
    known = list(inspect.signature(env_type).parameters)
    if "max_episode_steps" in arguments:
        raise UnknownArgument(
            "got max_episode_steps, but a vector environment of one node has no TimeLimit; shorten the run period with "
            "begin= and end=, or use gym.make, or gym.make_vec with vectorization_mode='sync' or 'async'"
        )
    if unknown := [name for name in arguments if name not in known]:
        known = [name for name in known if name != "link"]  # which is for tests
        errors = [
            f"got an unexpected keyword argument {name!r}; {_ELSEWHERE.get(name) or did_you_mean(name, known)}"
            for name in unknown
        ]
        raise UnknownArgument("\n".join(errors))


def of_scenario(scenario: str | Path | Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of an environment for a scenario's id, a scenario file, or arguments themselves."""
    if isinstance(scenario, Mapping):
        return dict(scenario)
    if Path(scenario).suffix in (".yaml", ".yml"):
        return {"file": scenario}
    return {"scenario": str(scenario).removeprefix("zenostat/")}


def check_agent_settings(reward: AnyReward | None, settings: Mapping[str, Any], placement: Affinity) -> None:
    """Check reward and wrappers before anything starts; if one is invalid, check all settings, and report all errors.

    Raises:
        InvalidConfig: Invalid reward or wrappers, together with all other errors.
    """
    fields = _checkable_fields(settings.get("scenario") or settings.get("district", ""))
    if not is_of_scenario(reward):
        fields["reward"] = reward
    errors = ErrorCollector()
    errors.collect(lambda: _check_fields(fields))
    if errors.errors:
        errors.collect(lambda: LocalNode({**settings, "check": True}, placement).close())
    errors.raise_if_any()


def check_agent_fields(scenario: str | Path) -> None:
    """Check the fields of a scenario file that a node does not check: reward and wrappers.

    Args:
        scenario: Path of the file; an id or a file that cannot be read has nothing to check.

    Raises:
        InvalidConfig: Lists the errors of both.
    """
    _check_fields(_checkable_fields(scenario))


def _checkable_fields(scenario: str | Path) -> dict[str, Any]:
    """Return the fields of a scenario file without a reward that is no mapping, which the node reports."""
    fields = fields_of_file(scenario)
    return fields if isinstance(fields.get("reward"), Mapping) else {**fields, "reward": None}


def _check_fields(fields: Mapping[str, Any]) -> None:
    errors = ErrorCollector()
    if (reward := fields.get("reward")) is not None:
        errors.collect(lambda: read_reward(reward))
    if isinstance(wrappers := fields.get("wrappers"), list):
        from zenostat.agent_sdk.wrappers.serialization import check_wrappers  # which imports environments

        errors.collect(lambda: check_wrappers(wrappers))
    errors.raise_if_any()


def fields_of_file(scenario: str | Path) -> dict[str, Any]:
    """Return the fields of a scenario file; none if it is no file, or cannot be read (the node reports why)."""
    if Path(scenario).suffix not in (".yaml", ".yml"):
        return {}
    try:
        return yaml12.read_mapping(Path(scenario))
    except InvalidConfig:
        return {}
