"""One slot of a vector environment: what can be asked of it alone, and how a reset names some."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from topics.errors import InvalidConfig
from topics.messages import WeatherSeries
from topics.seeds import check_seed

if TYPE_CHECKING:
    from agent_sdk.envs.vector_env import BuildingVectorEnv

Seeds = int | Sequence[int | None] | None
"""Of slot 0, the next slot having the next one; or each slot's own."""

_OF_ALL = (
    "action_names", "link", "local_node", "manifest", "metadata", "observation_dict", "observation_names",
    "render_mode", "reward", "spec",
)  # fmt: skip


class Slot:
    """Has the names of `BuildingEnv`, except for `reset`, `step` and `close`, which are the vector's.

    Attributes:
        number: of the slot, from 0.
        observation_space, action_space: as of a single environment.
    """

    def __init__(self, env: BuildingVectorEnv, number: int) -> None:
        self._env, self.number = env, number
        self.observation_space, self.action_space = env.single_observation_space, env.single_action_space

    @property
    def unwrapped(self) -> Slot:
        """Itself: wrappers are around the vector."""
        return self

    def __getattr__(self, name: str) -> Any:
        if name in _OF_ALL:
            return getattr(self._env, name)
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def set_context(self, values: Mapping[str, float | None]) -> None:
        """See `BuildingEnv.set_context`."""
        self._env.set_slot_context(self.number, values)

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """See `BuildingEnv.weather`."""
        return self._env.slot_weather(self.number, columns)

    def render(self) -> Any:
        """See `BuildingEnv.render`."""
        return self._env.render()[self.number]


def slots_of(options: Mapping[str, Any], count: int) -> list[int]:
    """The slots that a reset is asked for: those of `reset_mask`, or all.

    Raises:
        InvalidConfig: no such mask.
    """
    if "reset_mask" not in options:
        return list(range(count))
    mask = np.asarray(options["reset_mask"])
    if mask.shape != (count,) or mask.dtype != np.bool_ or not mask.any():
        raise InvalidConfig(
            f"reset_mask: a bool array of shape ({count},) with at least one True expected, got "
            f"{options['reset_mask']!r}"
        )
    return list(np.flatnonzero(mask).tolist())


def seeds_of(seed: Seeds, slots: Sequence[int], count: int) -> list[int | None] | None:
    """The seeds of some slots; None if none was given.

    Raises:
        InvalidConfig: no whole number from 0 to 2**64 - 1, or not one for each of all slots.
    """
    if seed is None:
        return None
    if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str):
        every = [one if one is None else check_seed(one) for one in seed]
    else:
        first = check_seed(seed, count)
        every = [first + slot for slot in range(count)]
    if len(every) != count:
        raise InvalidConfig(f"seed = {seed!r}; a number, or one or None for each of {count} slots expected")
    return [every[slot] for slot in slots]
