"""What was observed a step ago."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from agent_sdk.wrappers.names import places


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, names: Sequence[str]) -> None:
        super().__init__(view)
        box = view.box
        self._at = places(names, view.names, view.who)
        self.extend([f"previous_{name}" for name in names], box.low[self._at], box.high[self._at])
        self._before = np.zeros((view.slots, len(self._at)), np.float32)

    def observe(self, seen: ResetBatch | StepBatch, *, begins: bool) -> Values:
        """See `ObservationLogic`."""
        now = seen.observations[:, self._at]
        before = now if begins else self._before[seen.slots]
        self._before[seen.slots] = now
        return append(seen.observations, before)

    def get_state(self) -> list[dict[str, Any]]:
        """See `WrapperLogic`."""
        return [{"before": row} for row in self._before.tolist()]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        """See `WrapperLogic`."""
        rows = np.array([state["before"] for state in slots], np.float32)
        self._before[:] = rows.reshape(self._before.shape)


class PreviousObservation(BuildingWrapper):
    """Appends the values of named observations one step ago, as `previous_` and the name.

    At sample 0 there is none before it; the present values stand there.

    Args:
        names: observations, in the order in which they are appended.

    Raises:
        InvalidConfig: a name that the observation does not have.
    """

    logic = _Logic
