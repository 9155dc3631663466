"""One slot of a vector environment, and the slots and seeds of a reset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium import Space

from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import WeatherSeries
from zenostat.topics.seed_validation import check_seed

Seeds = int | Sequence[int | None] | None
"""The seed of slot 0, where slot i has `seed + i`; or a seed for each slot."""

_SHARED = (
    "action_names", "link", "local_node", "manifest", "metadata", "observation_dict", "observation_names",
    "render_mode", "reward", "spec",
)  # fmt: skip


class SlotHost(Protocol):
    """Interface of a vector environment to its slots."""

    single_observation_space: Space[Any]
    single_action_space: Space[Any]

    def set_slot_context(self, slot: int, values: Mapping[str, float | None]) -> None:
        """Set actuators of a slot that belong to no action."""

    def slot_weather(self, slot: int, columns: Sequence[str]) -> WeatherSeries:
        """Return columns of a slot's weather file."""

    def slot_sample(self, slot: int) -> SampleView:
        """Return the latest sample of a slot."""

    def render_slot(self, slot: int) -> Any:
        """Return a picture of a slot."""


class Slot:
    """One slot with the interface of `BuildingEnv`, except for `reset`, `step` and `close`, which belong to the vector.

    Attributes:
        number: Number of the slot, from 0.
        observation_space, action_space: Those of a single environment.
    """

    def __init__(self, env: SlotHost, number: int) -> None:
        self._env, self.number = env, number
        self.observation_space, self.action_space = env.single_observation_space, env.single_action_space

    @property
    def unwrapped(self) -> Slot:
        """The slot itself, because wrappers are around the vector."""
        return self

    def __getattr__(self, name: str) -> Any:
        if name in _SHARED:
            return getattr(self._env, name)
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _SHARED:
            raise AttributeError(f"{name!r} belongs to the vector environment: make a new one to change it")
        super().__setattr__(name, value)

    @property
    def sample(self) -> SampleView:
        """The slot's latest sample."""
        return self._env.slot_sample(self.number)

    def set_context(self, values: Mapping[str, float | None]) -> None:
        """Set actuators that belong to no action; see `BuildingEnv.set_context`."""
        self._env.set_slot_context(self.number, values)

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Return columns of this slot's weather file; see `BuildingEnv.weather`."""
        return self._env.slot_weather(self.number, columns)

    def render(self) -> Any:
        """Return a picture of the last day; see `BuildingEnv.render`."""
        return self._env.render_slot(self.number)


class SlotAccess:
    """Gymnasium's access to all slots of a vector environment, each of which is an object in `envs`."""

    envs: Sequence[Any]

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of each slot and return the results, or return an attribute of each."""
        members = [getattr(slot, name) for slot in self.envs]
        return tuple(member(*args, **kwargs) if callable(member) else member for member in members)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of each slot."""
        return tuple(getattr(slot, name) for slot in self.envs)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of each slot: a list or tuple has a value for each, any other value is for all.

        Raises:
            InvalidConfig: Not one value for each slot.
            AttributeError: What all slots share, such as the reward.
        """
        slot_values = values if isinstance(values, list | tuple) else [values] * len(self.envs)
        if len(slot_values) != len(self.envs):
            raise InvalidConfig(f"{name}: {len(slot_values)} values for {len(self.envs)} slots")
        for slot, value in zip(self.envs, slot_values, strict=True):
            setattr(slot, name, value)


def slots_of(options: Mapping[str, Any], count: int) -> list[int]:
    """Return the slots that a reset is for: those of `reset_mask`, or all.

    Raises:
        InvalidConfig: The mask is not a bool array with an entry for each slot and at least one True.
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
    """Return the seeds of some slots; None without a seed.

    Raises:
        InvalidConfig: Not an integer from 0 to 2**64 - 1, or not one for each slot.
    """
    if seed is None:
        return None
    if isinstance(seed, np.ndarray):
        seed = seed[()]  # a number, if it has no dimension
    if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str):
        seeds = [None if slot_seed is None else check_seed(slot_seed) for slot_seed in seed]
    else:
        first = check_seed(seed, count)
        seeds = [first + slot for slot in range(count)]
    if len(seeds) != count:
        raise InvalidConfig(f"seed = {seed!r}; a number, or one or None for each of {count} slots expected")
    return [seeds[slot] for slot in slots]
