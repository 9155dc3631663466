"""What a wrapper does, for any number of slots at once; `single` and `vector` put it around an environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Space
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agent_sdk.wrappers import names
from topics.errors import InvalidConfig
from topics.messages import Manifest

Values = NDArray[Any]
"""An array with a row for each of some slots."""


class Infos:
    """What the environment says beside its observations, for some slots."""

    def __init__(self, found: Mapping[str, Any], slots: Sequence[int] | None = None) -> None:
        """Of one environment, or (with `slots`) of those slots of a vector environment."""
        self._found, self._slots = found, slots

    def get(self, row: int, key: str) -> Any:
        """The value of the slot in that row; None if it says nothing."""
        if self._slots is None:
            return self._found.get(key)
        return _pick(self._found, key, self._slots[row])

    def time(self, row: int) -> datetime:
        """Simulated time of the row's sample."""
        return datetime.fromisoformat(self.get(row, "time"))

    def step(self, row: int) -> int:
        """Number of the row's sample in its episode: above 0 at a reset that goes back to a snapshot."""
        return int(self.get(row, "step") or 0)


def _pick(found: Mapping[str, Any], key: str, slot: int) -> Any:
    mask = found.get(f"_{key}")
    if key not in found or not (mask is None or mask[slot]):
        return None
    value = found[key]
    if isinstance(value, Mapping):
        inner = [name for name in value if not (name.startswith("_") and name[1:] in value)]
        said = {name: _pick(value, name, slot) for name in inner}
        return {name: told for name, told in said.items() if told is not None}
    return value[slot]


class ResetBatch(NamedTuple):
    """An episode begins in `slots`: sample 0, or that of a snapshot; one row a slot. `seeds` None: none were given."""

    slots: list[int]
    observations: Values
    infos: Infos
    seeds: Sequence[int | None] | None


class StepBatch(NamedTuple):
    """A timestep of `slots`, one row a slot. `actions` are those that this wrapper was given."""

    slots: list[int]
    observations: Values
    rewards: Values
    ends: NDArray[np.bool_]
    infos: Infos
    actions: Values


class EnvView:
    """What a wrapper sees of the environment that it wraps, single or vector."""

    def __init__(self, env: Any, who: str) -> None:
        self.env, self.who = env, who
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
        """The node's."""
        found: Manifest = names.attribute(self.env, "manifest")
        return found

    @property
    def box(self) -> Box[Any]:
        """The observation space, one dimension, a name each."""
        if not isinstance(self.observation_space, Box):
            raise InvalidConfig(f"{self.who} needs observations in a Box, not {self.observation_space}")
        assert self.observation_space.shape == (len(self.names),)
        return self.observation_space

    def each(self, slots: Sequence[int], method: str, *given: Any) -> list[Any]:
        """What the method of each slot's environment answers."""
        base = self.env.unwrapped
        if not self.vector:
            return [self._own(base, method)(*given)]
        if hasattr(base, "envs"):
            return [self._own(base.envs[slot].unwrapped, method)(*given) for slot in slots]
        answers = self._own(base, "call")(method, *given)
        return [answers[slot] for slot in slots]

    def tell(self, slots: Sequence[int], method: str, given: Sequence[Any]) -> None:
        """Calls a method of each slot's environment, each with its own argument."""
        base = self.env.unwrapped
        if not self.vector or hasattr(base, "envs"):
            for slot, value in zip(slots, given, strict=True):
                self._own(base.envs[slot].unwrapped if self.vector else base, method)(value)
        elif len(slots) == self.slots and all(value == given[0] for value in given):
            self._own(base, "call")(method, given[0])
        else:
            raise InvalidConfig(
                f"{self.who}: slots in other processes stand at different times; "
                "wrap each environment instead, in the function that makes it"
            )

    def _own(self, env: Any, method: str) -> Any:
        try:
            return getattr(env, method)
        except AttributeError:
            raise InvalidConfig(f"{self.who} needs an environment with {method}(); {env} has none") from None


class WrapperLogic:
    """Base of what the wrappers do. A subclass changes what it needs to; the rest passes.

    Attributes:
        observation_space, action_space, reward_space: of one slot; None if unchanged.
        observation_names, action_names: the same.
        added: what goes into the infos after a `start` or `step`, by key and name, a value for each row.
        snapshot_aware: whether it remembers again, at a snapshot, what it remembered there.
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
        """The observations of sample 0, shape (rows, values)."""
        return start.observations

    def act(self, slots: list[int], actions: Values) -> Values:  # noqa: ARG002  # most don't need the slots
        """The actions for the wrapped environment."""
        return actions

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        """Observations and rewards of a timestep."""
        return step.observations, step.rewards

    def get_state(self) -> list[dict[str, Any]]:
        """What it remembers, as plain values, for each slot."""
        return [{} for _ in range(self.view.slots)]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        """Goes on from `get_state`."""

    def close(self) -> None:
        """Lets go of what it holds; twice is fine."""

    def extend(self, added: Sequence[str], low: Values, high: Values, kept: Sequence[int] | None = None) -> None:
        """Values are appended, after those of the wrapped environment or the `kept` of them.

        Raises:
            InvalidConfig: a name that the observation has already.
        """
        box, before = self.view.box, self.view.names
        at = list(range(len(before))) if kept is None else list(kept)
        held = [before[i] for i in at]
        if twice := [name for name in added if name in held]:
            raise InvalidConfig(f"{self.view.who}: the observation has {', '.join(map(repr, twice))} already")
        lows = np.concatenate([box.low[at], np.asarray(low)]).astype(np.float32)
        highs = np.concatenate([box.high[at], np.asarray(high)]).astype(np.float32)
        self.observation_space = Box(lows, highs, dtype=np.float32)
        self.observation_names = (*held, *added)


class ObservationLogic(WrapperLogic):
    """A wrapper that does the same to each observation."""

    def start(self, start: ResetBatch) -> Values:
        """See `WrapperLogic`."""
        return self.observe(start, begins=True)

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        """See `WrapperLogic`."""
        return self.observe(step, begins=False), step.rewards

    def observe(self, seen: ResetBatch | StepBatch, *, begins: bool) -> Values:
        """The observations, shape (rows, values), at sample 0 or at a later one."""
        raise NotImplementedError


def append(observations: Values, more: Values) -> NDArray[np.float32]:
    """Values after the observation's own, shapes (…, n) and (…, m)."""
    return np.concatenate([observations, more], axis=-1).astype(np.float32)
