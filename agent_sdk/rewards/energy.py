"""The base of rewards on energy."""

from __future__ import annotations

from pydantic import Field

from zenostat.agent_sdk.rewards.comfort_band import ComfortBand
from zenostat.agent_sdk.rewards.config import Names
from zenostat.agent_sdk.rewards.energy_meter import EnergyMeter
from zenostat.topics.messages import Manifest


class EnergyReward(ComfortBand):
    """Base of rewards that weigh energy, or what depends on it, against comfort.

    Attributes:
        weight: w, the weight of energy, 0 to 1.
        lambda_temperature: 1/K.
        energy: name or names of meters (J) or power sensors (W); None: the meter Electricity:Facility, else
            HVAC:Electricity, else Electricity:HVAC, else EnergyPlus's Facility Total HVAC Electricity Demand Rate.
    """

    weight: float = Field(0.5, ge=0.0, le=1.0)
    lambda_temperature: float = Field(1.0, ge=0.0)
    energy: Names | None = None

    def _energy_meter(self, manifest: Manifest) -> EnergyMeter:
        return EnergyMeter(self.kind, self.energy, manifest)
