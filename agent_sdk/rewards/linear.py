"""The linear reward of energy and comfort."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from agent_sdk.rewards.base import BoundReward, Terms
from topics.errors import InvalidConfig, near
from topics.messages import Manifest

HVAC_POWER = "facility total hvac electricity demand rate"
ZONE_TEMPERATURES = ("zone air temperature", "zone mean air temperature")

Band = tuple[float, float]
MonthDay = tuple[int, int]


def _one_or_more(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


class LinearReward(BaseModel):
    """Weighted sum of power and of degrees outside the comfort band.

    Source: the `LinearReward` of Campoy-Nieves et al., "Sinergym: a virtual testbed for building energy
    optimization with Reinforcement Learning", Energy and Buildings.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_z max(low - T_z, T_z - high, 0)

    P is the facility's HVAC electricity demand in W (or the sum of the sensors that are named), T_z the air
    temperature of zone z in degC; the band is the summer one from `summer_begin` to `summer_end` (month, day; both
    included), else the winter one, by the day on which the timestep began. Both terms are zero or negative.

    Attributes:
        power: name or names of the sensors for P; None is the one that reads it.
        temperatures: names of the sensors for T_z; None is all zone air temperatures.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    weight: float = Field(0.5, ge=0.0, le=1.0)
    lambda_energy: float = Field(1e-4, ge=0.0)
    lambda_temperature: float = Field(1.0, ge=0.0)
    winter: Band = (20.0, 23.5)
    summer: Band = (23.0, 26.0)
    summer_begin: MonthDay = (6, 1)
    summer_end: MonthDay = (9, 30)
    kind: Literal["linear"] = "linear"
    power: Annotated[tuple[str, ...], BeforeValidator(_one_or_more, json_schema_input_type=str | list[str])] | None = (
        None
    )
    temperatures: tuple[str, ...] | None = None

    @model_validator(mode="after")
    def _bands_are_upright(self) -> LinearReward:
        for name, (low, high) in (("winter", self.winter), ("summer", self.summer)):
            if not low < high:
                raise ValueError(f"the {name} band's lower end {low} is not below its upper end {high}")
        return self

    def band(self, day: datetime) -> Band:
        """The comfort band in degC of a day."""
        inside = self.summer_begin <= (day.month, day.day) <= self.summer_end
        if self.summer_begin > self.summer_end:  # a summer over the turn of the year
            inside = not self.summer_end < (day.month, day.day) < self.summer_begin
        return self.summer if inside else self.winter

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        powers, zones = self._power_indices(manifest), self._temperature_indices(manifest)
        energy_factor = -self.weight * self.lambda_energy
        comfort_factor = -(1.0 - self.weight) * self.lambda_temperature

        def reward(values: NDArray[np.float64], begin: datetime) -> tuple[Any, Terms]:
            low, high = self.band(begin)
            temperatures = values[..., zones]
            outside = np.maximum(np.maximum(low - temperatures, temperatures - high), 0.0).sum(axis=-1)
            power_w = values[..., powers].sum(axis=-1)
            energy, comfort = energy_factor * power_w, comfort_factor * outside
            return energy + comfort, {
                "energy": energy,
                "comfort": comfort,
                "power_w": power_w,
                "degrees_outside": outside,
            }

        return reward

    def _power_indices(self, manifest: Manifest) -> list[int]:
        if self.power is not None:
            return [_find(name, manifest, "W") for name in self.power]
        for index, sensor in enumerate(manifest.sensors):
            if sensor.variable.casefold() == HVAC_POWER:
                return [index]
        raise InvalidConfig(
            "the linear reward needs a sensor of 'Facility Total HVAC Electricity Demand Rate' (key 'Whole Building'): "
            "name one in sensors=, or name another power sensor by reward=LinearReward(power=...)"
        )

    def _temperature_indices(self, manifest: Manifest) -> list[int]:
        if self.temperatures is not None:
            return [_find(name, manifest, "degC") for name in self.temperatures]
        for variable in ZONE_TEMPERATURES:
            found = [i for i, s in enumerate(manifest.sensors) if s.variable.casefold() == variable]
            if found:
                return found
        raise InvalidConfig(
            "the linear reward needs at least one sensor of 'Zone Air Temperature': name one in sensors=, "
            "or name the temperature sensors by reward=LinearReward(temperatures=...)"
        )


def _find(name: str, manifest: Manifest, unit: str) -> int:
    """The index of a sensor of that unit."""
    units = {s.name: s.unit for s in manifest.sensors}
    fit = [n for n, u in units.items() if u == unit]
    if name not in manifest.names:
        raise InvalidConfig(f"the linear reward names {name!r}, which the node does not have; {near(name, fit)}")
    if units.get(name) != unit:
        raise InvalidConfig(f"the linear reward needs a sensor in {unit}, which {name!r} is not; {near(name, fit)}")
    return manifest.names.index(name)
