"""A wrapper that adds values of the previous observation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from agent_sdk.wrappers.names import indices_of


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, names: Sequence[str]) -> None:
        super().__init__(view)
        box = view.box
        self._indices = indices_of(names, view.names, view.wrapper_name)
        self.extend([f"previous_{name}" for name in names], box.low[self._indices], box.high[self._indices])
        self._before = np.zeros((view.slots, len(self._indices)), np.float32)

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:
        now = batch.observations[:, self._indices]
        before = now if is_reset else self._before[batch.slots]
        self._before[batch.slots] = now
        return append(batch.observations, before)

    def get_state(self) -> list[dict[str, Any]]:
        return [{"before": row} for row in self._before.tolist()]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        rows = np.array([state["before"] for state in slots], np.float32)
        self._before[:] = rows.reshape(self._before.shape)


class PreviousObservation(BuildingWrapper):
    """Append the values of named observations one step ago, named `previous_` and the name.

    At sample 0, which has no previous sample, they are the current values.

    Args:
        names: names of observations, in the order in which to append them.

    Raises:
        InvalidConfig: the observation does not have one of the names.
    """

    logic = _Logic
