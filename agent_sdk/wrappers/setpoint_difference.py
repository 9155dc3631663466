"""A wrapper that adds differences between temperatures and their setpoints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from agent_sdk.wrappers.names import indices_of, require_units
from topics.errors import InvalidConfig


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, pairs: Mapping[str, Sequence[str]]) -> None:
        super().__init__(view)
        require_units(view.env, view.wrapper_name)
        for name, pair in pairs.items():
            if isinstance(pair, str) or len(pair) != 2:
                raise InvalidConfig(
                    f"{view.wrapper_name}: {name!r} should be a pair, [temperature, setpoint]; not {pair!r}"
                )
        box, names = view.box, view.names
        self._temperatures = [i for pair in pairs.values() for i in indices_of(pair[:1], names, view.wrapper_name)]
        self._setpoints = [i for pair in pairs.values() for i in indices_of(pair[1:], names, view.wrapper_name)]
        low = box.low[self._temperatures] - box.high[self._setpoints]
        self.extend(list(pairs), low, box.high[self._temperatures] - box.low[self._setpoints])

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:  # noqa: ARG002  # resets are no different
        values = batch.observations.astype(np.float32, copy=False)
        return append(values, values[..., self._temperatures] - values[..., self._setpoints])


class SetpointDifference(BuildingWrapper):
    """Append temperatures minus their setpoints, in K, for pairs of named observations.

    Args:
        pairs: (temperature, setpoint), both names of observations, by the name of the new value.

    Raises:
        InvalidConfig: the observation does not have one of the names, a value is not a pair, or an inner wrapper
            changes the units of the values.
    """

    logic = _Logic
