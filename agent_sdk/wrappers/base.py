"""The logic of a wrapper, for any number of slots at once; `adapters` runs it around an environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Space
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray
from typing_extensions import override

from zenostat.agent_sdk.envs.episode_state import ContextProgram
from zenostat.agent_sdk.wrappers import names
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

Values = NDArray[Any]
"""An array with one row per slot."""


class Infos:
    """The infos of some slots, read by row.

    Args:
        infos: as `reset` or `step` returned them.
        slots: the slots of a vector environment; None for a single environment.
    """

    def __init__(self, infos: Mapping[str, Any], slots: Sequence[int] | None = None) -> None:
        self._infos, self._slots = infos, slots

    def get(self, row: int, key: str) -> Any:
        """Return the value of the slot in that row; None if it has none."""
        if self._slots is None:
            return self._infos.get(key)
        return _slot_value(self._infos, key, self._slots[row])

    def time(self, row: int) -> datetime:
        """Return the simulated time of the row's sample."""
        return datetime.fromisoformat(self.get(row, "time"))

    def step(self, row: int) -> int:
        """Return the number of the row's sample in its episode; above 0 at a reset to a snapshot."""
        return int(self.get(row, "step") or 0)


def _slot_value(infos: Mapping[str, Any], key: str, slot: int) -> Any:
    mask = infos.get(f"_{key}")
    if key not in infos or not (mask is None or mask[slot]):
        return None
    value = infos[key]
    if isinstance(value, Mapping):
        inner = [name for name in value if not (name.startswith("_") and name[1:] in value)]
        slot_values = {name: _slot_value(value, name, slot) for name in inner}
        return {name: value for name, value in slot_values.items() if value is not None}
    return value[slot]


class ResetBatch(NamedTuple):
    """The first samples of episodes in `slots`, one row per slot: sample 0, or that of a snapshot.

    `seeds` is None if `reset` got no seed.
    """

    slots: list[int]
    observations: Values
    infos: Infos
    seeds: Sequence[int | None] | None


class StepBatch(NamedTuple):
    """One timestep of `slots`, one row per slot. `actions` are those that this wrapper received."""

    slots: list[int]
    observations: Values
    rewards: Values
    ends: NDArray[np.bool_]
    infos: Infos
    actions: Values


class EnvView:
    """A wrapper's view of the environment that it wraps, single or vector.

    Args:
        env: the environment.
        wrapper_name: the wrapper's class, for errors.
    """

    def __init__(self, env: Any, wrapper_name: str) -> None:
        self.env, self.wrapper_name = env, wrapper_name
        self.vector = isinstance(env, VectorEnv)
        self.slots: int = env.num_envs if self.vector else 1
        self.observation_space: Space[Any] = env.single_observation_space if self.vector else env.observation_space
        self.action_space: Space[Any] = env.single_action_space if self.vector else env.action_space

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the observation's values."""
        return names.names_of(self.env)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the action's dimensions."""
        return names.action_names_of(self.env)

    @property
    def manifest(self) -> Manifest:
        """The manifest of the environment's node."""
        manifest: Manifest = names.attribute(self.env, "manifest")
        return manifest

    @property
    def box(self) -> Box[Any]:
        """The observation space: one dimension, with a name for each value.

        Raises:
            InvalidConfig: the observation space is not a Box.
        """
        if not isinstance(self.observation_space, Box):
            raise InvalidConfig(f"{self.wrapper_name} needs observations in a Box, not {self.observation_space}")
        assert self.observation_space.shape == (len(self.names),)
        return self.observation_space

    def call(self, slots: Sequence[int], method: str, *args: Any) -> list[Any]:
        """Call a method of each slot's environment with the same arguments; return the results."""
        base = self.env.unwrapped
        if not self.vector:
            return [self._method(base, method)(*args)]
        if hasattr(base, "envs"):
            return [self._method(base.envs[slot].unwrapped, method)(*args) for slot in slots]
        results = self._method(base, "call")(method, *args)
        return [results[slot] for slot in slots]

    def call_each(self, slots: Sequence[int], method: str, arguments: Sequence[Any]) -> None:
        """Call a method of each slot's environment, each with its own argument.

        Raises:
            InvalidConfig: the environments run in other processes and their arguments differ.
        """
        base = self.env.unwrapped
        if not self.vector or hasattr(base, "envs"):
            for slot, argument in zip(slots, arguments, strict=True):
                self._method(base.envs[slot].unwrapped if self.vector else base, method)(argument)
        elif len(slots) == self.slots and all(argument == arguments[0] for argument in arguments):
            self._method(base, "call")(method, arguments[0])
        else:
            raise InvalidConfig(
                f"{self.wrapper_name} cannot set slots in other processes to different values; "
                "wrap each environment instead, in the function that creates it"
            )

    def _method(self, env: Any, method: str) -> Any:
        try:
            return getattr(env, method)
        except AttributeError:
            raise InvalidConfig(
                f"{self.wrapper_name} needs an environment with {method}(), which {env} does not have"
            ) from None


class WrapperLogic:
    """Base of the logic of wrappers. A subclass overrides what it changes; the rest passes through.

    Attributes:
        observation_space, action_space, reward_space: spaces of one slot; None if unchanged.
        observation_names, action_names: names after this wrapper; None if unchanged.
        added: values for the infos after `start` or `step`, by key and name, one value per row.
        snapshot_aware: whether a reset to a snapshot restores this logic's state as well.
    """

    snapshot_aware: ClassVar[bool] = True

    def __init__(self, view: EnvView) -> None:
        self.view = view
        self.observation_space: Space[Any] | None = None
        self.action_space: Space[Any] | None = None
        self.reward_space: Box[Any] | None = None
        self.observation_names: tuple[str, ...] | None = None
        self.action_names: tuple[str, ...] | None = None
        self.added: dict[str, dict[str, Values]] = {}

    def start(self, start: ResetBatch) -> Values:
        """Return the observations at an episode's start, shape (rows, values)."""
        return start.observations

    def act(self, slots: list[int], actions: Values) -> Values:  # noqa: ARG002  # most do not need the slots
        """Return the actions for the wrapped environment.

        It may refuse them, and simulate nothing: the state moves in `step`, so that a refused action leaves no trace.
        """
        return actions

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        """Return the observations and rewards of a timestep."""
        return step.observations, step.rewards

    def convert_infos(self, infos: dict[str, Any]) -> dict[str, Any]:
        """Return the infos as this wrapper shows them: those of a single environment, or of a vector."""
        return infos

    def context_program(self) -> ContextProgram | None:
        """Return an independent copy of what sets the context of this environment; None if this does not set any."""
        return None

    def get_state(self) -> list[dict[str, Any]]:
        """Return the state of each slot as plain values."""
        return [{} for _ in range(self.view.slots)]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        """Restore a state that `get_state` returned."""

    def close(self) -> None:
        """Release resources. Idempotent."""

    def extend(self, added: Sequence[str], low: Values, high: Values, kept: Sequence[int] | None = None) -> None:
        """Append values to the observation space and its names.

        Args:
            added: names of the new values.
            low: lower bounds of the new values.
            high: upper bounds of the new values.
            kept: indices of the wrapped environment's values that stay; None keeps all.

        Raises:
            InvalidConfig: the observation already has one of the names.
        """
        box, before = self.view.box, self.view.names
        indices = list(range(len(before))) if kept is None else list(kept)
        kept_names = [before[i] for i in indices]
        if duplicates := [name for name in added if name in kept_names]:
            raise InvalidConfig(
                f"{self.view.wrapper_name}: the observation already has {', '.join(map(repr, duplicates))}"
            )
        lows = np.concatenate([box.low[indices], np.asarray(low)]).astype(np.float32)
        highs = np.concatenate([box.high[indices], np.asarray(high)]).astype(np.float32)
        self.observation_space = Box(lows, highs, dtype=np.float32)
        self.observation_names = (*kept_names, *added)


class ObservationLogic(WrapperLogic):
    """Base of logic that transforms each observation and nothing else."""

    @override
    def start(self, start: ResetBatch) -> Values:
        return self.observe(start, is_reset=True)

    @override
    def step(self, step: StepBatch) -> tuple[Values, Values]:
        return self.observe(step, is_reset=False), step.rewards

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:
        """Return the observations, shape (rows, values), at an episode's start or after a timestep."""
        raise NotImplementedError


def append(observations: Values, values: Values) -> NDArray[np.float32]:
    """Append values to observations, shapes (…, n) and (…, m)."""
    return np.concatenate([observations, values], axis=-1).astype(np.float32)
