"""Gymnasium's ids of scenarios, as files of studies name them."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

from zenostat.topics.errors import UnknownName, did_you_mean


def pop_env_id(arguments: dict[str, Any]) -> str:
    """Return the id for `gym.make`, and remove the scenario from the arguments.

    Raises:
        UnknownName: there is no such id.
    """
    if "file" in arguments:
        return "zenostat/Scenario-v1"
    if "scenario" not in arguments:
        return "zenostat/Plant-v1" if "plant" in arguments else "zenostat/Building-v1"
    name = str(arguments.pop("scenario"))
    if f"zenostat/{name}" not in gym.registry:
        known = [env_id.removeprefix("zenostat/") for env_id in gym.registry if env_id.startswith("zenostat/")]
        raise UnknownName(f"there is no scenario {name!r}; {did_you_mean(name, known)}; see `zenostat scenarios`")
    return f"zenostat/{name}"


def add_monitoring(arguments: dict[str, Any]) -> None:
    """Let the node also measure what metrics need, unless the arguments decide it; one that runs elsewhere does not."""
    if not {"connect", "link"} & arguments.keys():
        arguments.setdefault("monitoring", True)
