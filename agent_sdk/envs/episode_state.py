"""What an environment remembers of its episode beside the building's own state."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar
from weakref import WeakKeyDictionary, WeakSet

import numpy as np
from numpy.typing import NDArray

from agent_sdk.envs.termination import TerminationLimits
from agent_sdk.rewards import BoundReward
from agent_sdk.rewards.base import Begin

C = TypeVar("C")


def _nan(found: Mapping[str, Any]) -> dict[str, Any]:
    """The same keys with NaN for each number, in the same shape and kind."""
    return {name: np.full(one.shape, np.nan) if np.ndim(one) else _kind(one)(math.nan) for name, one in found.items()}


def _kind(number: Any) -> type[float]:
    return type(number) if isinstance(number, float) else float  # float64 is one


@dataclass(slots=True)
class EpisodeState(Generic[C]):
    """Of one building, or of several slots.

    Attributes:
        reward, limits: those of the task, if it has any.
        context: what stands in the next command beside the action.
        wrappers: those of the SDK around the environment, which remember something as well.
    """

    reward: BoundReward | None
    limits: TerminationLimits | None
    context: C
    wrappers: WeakSet[Any] = field(default_factory=WeakSet)
    _unrewarded: dict[str, Any] | None = None

    def reset(self, slots: Sequence[int] | None = None) -> None:
        """An episode begins (in these slots; None: in all): reward and limits forget the former one."""
        for remembers in (self.reward, self.limits):
            if remembers is not None:
                remembers.reset(slots)

    def unrewarded(self, values: NDArray[np.float64], begin: Begin) -> dict[str, Any]:
        """What the info of a reset has of the reward, so that all infos have the same keys: NaN for each number.

        Which they are is asked of a copy of the reward once, at the first sample.
        """
        if self.reward is None:
            return {}
        if self._unrewarded is None:
            try:
                _, terms, measures = copy.deepcopy(self.reward)(values, begin)
            except Exception:  # somebody's own may not be ready for sample 0; the first step tells what is wrong
                terms, measures = {}, {}
            self._unrewarded = {"reward_terms": _nan(terms), "reward_metrics": _nan(measures)}
        return copy.deepcopy(self._unrewarded)

    def state(self) -> dict[str, Any]:
        """All of it, on its own."""
        reward = self.reward.state() if self.reward is not None else {}
        return copy.deepcopy({"reward": reward, "limits": self.limits, "context": self.context})

    def wrapper_states(self) -> WeakKeyDictionary[Any, Any]:
        """What each wrapper remembers."""
        return WeakKeyDictionary({wrapper: wrapper.remembered() for wrapper in self.wrappers})

    def restore(self, state: Mapping[str, Any]) -> None:
        """Goes on from a `state`."""
        state = copy.deepcopy(dict(state))
        if self.reward is not None:
            self.reward.restore(state["reward"])
        self.limits, self.context = state["limits"], state["context"]
