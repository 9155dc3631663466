"""A wrapper that keeps some values of the observation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import Box

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values
from agent_sdk.wrappers.names import indices_of
from topics.errors import InvalidConfig


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, keep: Sequence[str]) -> None:
        super().__init__(view)
        if not keep:
            raise InvalidConfig(f"{view.wrapper_name}: keep at least one of {', '.join(view.names)}")
        box = view.box
        self._kept = indices_of(keep, view.names, view.wrapper_name)
        self._dropped = {name: i for i, name in enumerate(view.names) if name not in keep}
        self.observation_names = tuple(keep)
        low, high = box.low[self._kept].astype(np.float32), box.high[self._kept].astype(np.float32)
        self.observation_space = Box(low, high, dtype=np.float32)

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:  # noqa: ARG002  # resets are no different
        self.added = {"dropped": {name: batch.observations[:, i] for name, i in self._dropped.items()}}
        return batch.observations[:, self._kept].astype(np.float32)


class ReducedObservation(BuildingWrapper):
    """Keep the named observations, in the given order; `info["dropped"]` has the others by name.

    Args:
        keep: names of the observations to keep.

    Raises:
        InvalidConfig: the observation does not have one of the names, or `keep` is empty.
    """

    logic = _Logic
