"""A reward that grows exponentially with the distance from the comfort band."""

from __future__ import annotations

from typing import Literal

from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.linear import WeightedReward
from zenostat.agent_sdk.rewards.terms import ExponentialDegrees, TermSum
from zenostat.topics.messages import Manifest


class ExponentialReward(WeightedReward):
    """`LinearReward` with the exponential of the degrees outside.

    Source: Sinergym's `ExpReward`.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_{z: v_z > 0} exp(v_z)
        v_z = max(low - T_z, T_z - high, 0), at most 100 K

    A zone within the band (bounds included) adds 0, and a zone just outside adds 1: leaving the band has a fixed cost.
    Terms: energy, comfort. Metrics: power_w, degrees_outside.
    """

    kind: Literal["exponential"] = "exponential"

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        energy = self._energy_term(manifest)
        comfort = self._comfort_term(ExponentialDegrees(self._degrees_outside(manifest)))
        return TermSum([energy, comfort], ["power_w", "degrees_outside"])
