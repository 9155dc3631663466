"""A reward whose terms are between 0 and -1, independent of the building's size."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.comfort_band import ComfortBand
from zenostat.agent_sdk.rewards.config import Names
from zenostat.agent_sdk.rewards.selectors import powers
from zenostat.agent_sdk.rewards.slot_state import SlotState
from zenostat.agent_sdk.rewards.terms import Power, RelativeToMaximum, Term, TermSum
from zenostat.topics.messages import Manifest


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
        power: name or names of the sensors (W) or meters (J) for P; None is the HVAC's electric power.
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

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        degrees = self._degrees_outside(manifest)
        power = Power(*powers(self.kind, self.power, manifest))
        maxima = SlotState(self.kind, max_power_w=self.max_power_w or 0.0, max_degrees=self.max_degrees or 0.0)
        relative_power = RelativeToMaximum(power, maxima, "max_power_w", moving=self.moving)
        relative_degrees = RelativeToMaximum(degrees, maxima, "max_degrees", moving=self.moving)
        return TermSum(
            [Term("energy", -self.weight, relative_power), Term("comfort", -(1.0 - self.weight), relative_degrees)],
            ["power_w", "degrees_outside", "max_power_w", "max_degrees"],
            maxima,
            keeps_state=not self.forget,
        )
