"""State of an environment's episode besides the building's own."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Generic, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from zenostat.agent_sdk.envs.termination import TerminationLimits
from zenostat.agent_sdk.envs.wrapper_set import WrapperSet
from zenostat.agent_sdk.rewards import BoundReward, Reward
from zenostat.agent_sdk.rewards.base import Begin
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import EpisodeChanged
from zenostat.topics.messages import Manifest

C = TypeVar("C")
Context = Mapping[str, float | None]
ContextProgram = Callable[[datetime], Context]
"""Returns changes of the context at the beginning of each timestep, in order; can be copied with its state."""


def require_episode(sample: object | None) -> None:
    """Raise `EpisodeChanged` before the first sample, for a context that the reset would clear."""
    if sample is None:
        raise EpisodeChanged("call reset() before set_context(): the beginning of an episode clears the context")


def unrewarded_entries(reward: BoundReward, values: Floats, begin: Begin) -> dict[str, dict[str, Any]]:
    """Return a reward's entries in an info, by calling a copy of it, with NaN for each number; see `unrewarded`."""
    try:
        _, terms, metrics = copy.deepcopy(reward)(values, begin)
    except Exception:  # a user's reward may not be ready for sample 0; the first step raises what is wrong
        terms, metrics = {}, {}
    return {"reward_terms": _nan_like(terms), "reward_metrics": _nan_like(metrics)}


def _nan_like(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Return the same keys with NaN for each number, in the same shape and type."""
    return {
        name: np.full(number.shape, np.nan) if np.ndim(number) else _float_type(number)(math.nan)
        for name, number in numbers.items()
    }


def _float_type(number: Any) -> type[float]:
    return type(number) if isinstance(number, float) else float  # np.float64 is a float


@dataclass(slots=True)
class EpisodeState(Generic[C]):
    """State of the episode of one building, or of several slots.

    Attributes:
        reward, limits: Those of the task; None if it has none.
        context: Values of actuators outside the actions for the next command.
        wrappers: The SDK's wrappers around the environment that have a state.
        programs: What sets the context of a branch, in place of its parent's wrappers.
    """

    reward: BoundReward | None
    limits: TerminationLimits | None
    context: C
    wrappers: WrapperSet = field(default_factory=WrapperSet)
    programs: list[ContextProgram] = field(default_factory=list)
    _reset_entries: dict[str, Any] | None = None

    @classmethod
    def of(cls, manifest: Manifest, reward: Reward | None, context: C, slots: int = 1) -> EpisodeState[C]:
        """Return the state of the task of a manifest, for a number of slots."""
        limits = TerminationLimits(manifest, slots) if manifest.task.terminate else None
        return cls(None if reward is None else reward.bind(manifest), limits, context)

    def reset(self, slots: Sequence[int] | None = None) -> None:
        """Reset reward and limits for a new episode in these slots; None: in all."""
        for stateful in (self.reward, self.limits):
            if stateful is not None:
                stateful.reset(slots)

    def unrewarded(self, values: Floats, begin: Begin) -> dict[str, Any]:
        """Return the reward's entries in the info of a reset, with NaN for each number, so that all infos have them.

        A copy of the reward is called once, at the first sample, to learn its keys.
        """
        if self.reward is None:
            return {}
        if self._reset_entries is None:
            self._reset_entries = unrewarded_entries(self.reward, values, begin)
        return copy.deepcopy(self._reset_entries)

    def capture(self) -> dict[str, Any]:
        """Return an independent copy of the state of reward, limits and context, and what will set the context."""
        reward = self.reward.state() if self.reward is not None else {}
        state = copy.deepcopy({"reward": reward, "limits": self.limits, "context": self.context})
        return state | {"programs": self.context_programs()}

    def context_programs(self) -> list[ContextProgram]:
        """Return copies of what will set the context; the innermost wrapper is the last one."""
        wrappers = sorted(self.wrappers, key=lambda wrapper: wrapper.depth, reverse=True)
        programs = (wrapper.context_program() for wrapper in wrappers)
        return copy.deepcopy(self.programs) + [program for program in programs if program is not None]

    def apply_programs(self, begin: datetime, set_context: Callable[[Context], None]) -> None:
        """Set the context of the timestep of a branch that begins at that time."""
        for program in self.programs:
            set_context(program(begin))

    def wrapper_states(self) -> WeakKeyDictionary[Any, Any]:
        """Return the state of each wrapper."""
        return WeakKeyDictionary({wrapper: wrapper.snapshot_state() for wrapper in self.wrappers})

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a captured state; wrappers restore what sets the context."""
        state = copy.deepcopy(dict(state))
        if self.reward is not None:
            self.reward.restore(state["reward"])
        self.limits, self.context = state["limits"], state["context"]
