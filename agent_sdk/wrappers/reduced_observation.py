"""Fewer values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import Box

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values
from agent_sdk.wrappers.names import places
from topics.errors import InvalidConfig


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, keep: Sequence[str]) -> None:
        super().__init__(view)
        if not keep:
            raise InvalidConfig(f"{view.who}: keep at least one of {', '.join(view.names)}")
        box = view.box
        self._kept = places(keep, view.names, view.who)
        self._dropped = {name: at for at, name in enumerate(view.names) if name not in keep}
        self.observation_names = tuple(keep)
        low, high = box.low[self._kept].astype(np.float32), box.high[self._kept].astype(np.float32)
        self.observation_space = Box(low, high, dtype=np.float32)

    def observe(self, seen: ResetBatch | StepBatch, *, begins: bool) -> Values:  # noqa: ARG002  # the same at sample 0
        """See `ObservationLogic`."""
        self.added = {"dropped": {name: seen.observations[:, at] for name, at in self._dropped.items()}}
        return seen.observations[:, self._kept].astype(np.float32)


class ReducedObservation(BuildingWrapper):
    """Keeps named observations, in the order asked; the others stand in `info["dropped"]` by name.

    Args:
        keep: names of observations.

    Raises:
        InvalidConfig: a name that the observation does not have, or none at all.
    """

    logic = _Logic
