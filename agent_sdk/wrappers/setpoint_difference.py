"""How far temperatures are from their setpoints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from agent_sdk.wrappers.names import need_units, places
from topics.errors import InvalidConfig


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, pairs: Mapping[str, Sequence[str]]) -> None:
        super().__init__(view)
        need_units(view.env, view.who)
        for name, pair in pairs.items():
            if isinstance(pair, str) or len(pair) != 2:
                raise InvalidConfig(f"{view.who}: {name!r} should be a pair, [temperature, setpoint]; not {pair!r}")
        box, names = view.box, view.names
        self._of = [at for pair in pairs.values() for at in places(pair[:1], names, view.who)]
        self._from = [at for pair in pairs.values() for at in places(pair[1:], names, view.who)]
        low = box.low[self._of] - box.high[self._from]
        self.extend(list(pairs), low, box.high[self._of] - box.low[self._from])

    def observe(self, seen: ResetBatch | StepBatch, *, begins: bool) -> Values:  # noqa: ARG002  # the same at sample 0
        """See `ObservationLogic`."""
        values = seen.observations.astype(np.float32, copy=False)
        return append(values, values[..., self._of] - values[..., self._from])


class SetpointDifference(BuildingWrapper):
    """Appends a temperature minus its setpoint, in K, for pairs of named observations.

    Args:
        pairs: name of the new value to (temperature, setpoint), both names of observations.

    Raises:
        InvalidConfig: a name that the observation does not have; no pair; or a wrapper within that takes the
            values out of their units.
    """

    logic = _Logic
