"""A reward whose terms are between 0 and -1, independent of the building's size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from agent_sdk.rewards.base import Begin, BoundReward, Outcome
from agent_sdk.rewards.comfort_band import BandedBound, ComfortBand
from agent_sdk.rewards.config import Names
from agent_sdk.rewards.selectors import powers, sum_at
from agent_sdk.rewards.slot_state import SlotState
from topics.messages import Manifest


class NormalizedReward(ComfortBand):
    """Power and degrees outside the band, each divided by its maximum so far.

        r = -w * P / P_max - (1 - w) * D / D_max,    D = sum_z max(low - T_z, T_z - high, 0)

    The maxima start at `max_power_w` and `max_degrees` and grow with the values, including those of this timestep (so
    each quotient is between 0 and 1; 0 / 0 is 0). With `moving: false` they are constant, and quotients may be above 1.
    Each slot has its own maxima. A new episode keeps them unless `forget` is set.

    Source: Sinergym's `NormalizedLinearReward` as documented; its code never changes the maxima.

    Terms: energy, comfort. Metrics: power_w, degrees_outside, max_power_w, max_degrees.

    Attributes:
        weight: w, the weight of energy, 0 to 1.
        max_power_w: W; None starts at 0.
        max_degrees: K; None starts at 0.
        moving: whether the maxima grow.
        forget: whether a new episode resets the maxima.
        power: name or names of the sensors for P, W; None is the HVAC's electricity demand.
    """

    kind: Literal["normalized"] = "normalized"
    weight: float = Field(0.5, ge=0.0, le=1.0)
    max_power_w: float | None = Field(None, gt=0.0)
    max_degrees: float | None = Field(None, gt=0.0)
    moving: bool = True
    forget: bool = False
    power: Names | None = None

    @model_validator(mode="after")
    def _check_maxima(self) -> NormalizedReward:
        if not self.moving and (self.max_power_w is None or self.max_degrees is None):
            raise ValueError("moving: false needs max_power_w and max_degrees")
        return self

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _Bound(self, manifest)


class _Bound(BandedBound):
    def __init__(self, of: NormalizedReward, manifest: Manifest) -> None:
        super().__init__(of, manifest)
        self._of = of
        self._powers = powers(of.kind, of.power, manifest)
        self._state = SlotState(of.kind, max_power_w=of.max_power_w or 0.0, max_degrees=of.max_degrees or 0.0)

    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        outside, power_w = self._degrees(values, begin), sum_at(values, self._powers)
        maxima = self._state.of(values.shape[:-1])
        if self._of.moving:
            most_w = np.maximum(maxima["max_power_w"], power_w)
            most_k = np.maximum(maxima["max_degrees"], outside)
            self._state.store(max_power_w=most_w, max_degrees=most_k)
        else:
            most_w, most_k = maxima["max_power_w"][()], maxima["max_degrees"][()]
        energy = -self._of.weight * _share(power_w, most_w)
        comfort = -(1.0 - self._of.weight) * _share(outside, most_k)
        measures = {"power_w": power_w, "degrees_outside": outside, "max_power_w": most_w, "max_degrees": most_k}
        return Outcome(energy + comfort, {"energy": energy, "comfort": comfort}, measures)

    def reset(self, slots: Sequence[int] | None = None) -> None:
        if self._of.forget:
            self._state.reset(slots)

    def state(self) -> dict[str, Any]:
        return self._state.state()

    def restore(self, state: dict[str, Any]) -> None:
        self._state.restore(state)


def _share(part: Any, most: Any) -> Any:
    return part / np.where(most > 0.0, most, 1.0)
