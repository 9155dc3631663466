"""The part of an environment's actions and observations that belongs to one of several agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zenostat.topics.errors import InvalidConfig, did_you_mean


@dataclass(frozen=True, kw_only=True)
class AgentPart:
    """The parts of an environment that belong to one agent.

    Attributes:
        actions: Names of its actions.
        action_indices: Positions in the environment's action, or of its discrete actions.
        actuator_indices: Positions of the actuators that it sets.
        observation_indices: Positions of its observation in the environment's observation.
    """

    actions: tuple[str, ...]
    action_indices: list[int]
    actuator_indices: list[int]
    observation_indices: list[int]


def indices_of(shared: Sequence[str], names: Sequence[str]) -> set[int]:
    """Return the positions of shared observations.

    Raises:
        InvalidConfig: No observation has one of these names.
    """
    shared = [shared] if isinstance(shared, str) else shared
    for name in shared:
        if name not in names:
            raise InvalidConfig(f"shared: no observation is named {name!r}; {did_you_mean(name, names)}")
    return {names.index(name) for name in shared}
