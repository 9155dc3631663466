"""What an environment remembers of its episode beside the building's own state."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar
from weakref import WeakKeyDictionary, WeakSet

from agent_sdk.limits import Limits
from agent_sdk.rewards import BoundReward

C = TypeVar("C")


@dataclass(slots=True)
class EpisodeMemory(Generic[C]):
    """Of one building, or of several slots.

    Attributes:
        reward, limits: those of the task, if it has any.
        context: what stands in the next command beside the action.
        wrappers: those of the SDK around the environment, which remember something as well.
    """

    reward: BoundReward | None
    limits: Limits | None
    context: C
    wrappers: WeakSet[Any] = field(default_factory=WeakSet)

    def forget(self, slots: Sequence[int] | None = None) -> None:
        """An episode begins (in these slots; None: in all): reward and limits forget the former one."""
        for remembers in (self.reward, self.limits):
            if remembers is not None:
                remembers.reset(slots)

    def state(self) -> dict[str, Any]:
        """All of it, on its own."""
        reward = self.reward.state() if self.reward is not None else {}
        return copy.deepcopy({"reward": reward, "limits": self.limits, "context": self.context})

    def of_wrappers(self) -> WeakKeyDictionary[Any, Any]:
        """What each wrapper remembers."""
        return WeakKeyDictionary({wrapper: wrapper.remembered() for wrapper in self.wrappers})

    def restore(self, state: Mapping[str, Any]) -> None:
        """Goes on from a `state`."""
        state = copy.deepcopy(dict(state))
        if self.reward is not None:
            self.reward.restore(state["reward"])
        self.limits, self.context = state["limits"], state["context"]
