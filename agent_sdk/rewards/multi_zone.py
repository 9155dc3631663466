"""A reward on how well each zone keeps its setpoints."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.config import Names, RewardConfig
from zenostat.agent_sdk.rewards.selectors import indices, named, of_variables, powers, same_zone
from zenostat.agent_sdk.rewards.terms import Power, SetpointDegrees, Term, TermSum
from zenostat.topics.energyplus_names import COOLING_SETPOINT_VARIABLE, HEATING_SETPOINT_VARIABLE, ZONE_TEMPERATURES
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest


class MultiZoneReward(RewardConfig):
    """Weighted sum of power and of degrees outside each zone's band: its setpoints and a threshold around them.

    Source: Sinergym's `MultiZoneReward`, which has one setpoint per zone.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_z max(h_z - d - T_z, T_z - c_z - d, 0)

    h_z and c_z are the heating and cooling setpoint of zone z in degC (equal if there is only one), d the
    threshold. Terms: energy, comfort. Metrics: power_w, degrees_outside.

    Attributes:
        zones: the setpoint sensor, or [heating, cooling], by the sensor of the zone's air temperature; None: the
            sensors of 'Zone Air Temperature' with those of 'Zone Thermostat Heating Setpoint Temperature' and
            '... Cooling ...' that have the same key. A thermostat without one of the two reports 0 for it: name
            only the other.
        threshold: d, K.
        weight, lambda_energy, lambda_temperature, power: as in `LinearReward`.
    """

    kind: Literal["multi_zone"] = "multi_zone"
    zones: dict[str, Names] | None = None
    threshold: float = Field(0.5, ge=0.0)
    weight: float = Field(0.5, ge=0.0, le=1.0)
    lambda_energy: float = Field(1e-4, ge=0.0)
    lambda_temperature: float = Field(1.0, ge=0.0)
    power: Names | None = None

    @field_validator("zones")
    @classmethod
    def _check_zones(cls, zones: dict[str, tuple[str, ...]] | None) -> dict[str, tuple[str, ...]] | None:
        if zones is not None and not zones:
            raise ValueError("at least one zone expected")
        for zone, setpoints in (zones or {}).items():
            if len(setpoints) not in (1, 2):
                raise ValueError(f"{zone}: a setpoint, or [heating, cooling] expected")
        return zones

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        power = Power(*powers(self.kind, self.power, manifest))
        air, heating, cooling = map(indices, zip(*self._points(manifest), strict=True))
        terms = [
            Term("energy", -self.weight * self.lambda_energy, power),
            Term(
                "comfort",
                -(1.0 - self.weight) * self.lambda_temperature,
                SetpointDegrees(air, heating, cooling, self.threshold),
            ),
        ]
        return TermSum(terms, ["power_w", "degrees_outside"])

    def _points(self, manifest: Manifest) -> list[tuple[int, int, int]]:
        """Return the indices of each zone's air temperature, heating and cooling setpoint."""
        if self.zones is not None:
            rows = []
            for zone, setpoints in self.zones.items():
                points = [named(self.kind, name, manifest, ["degC"]) for name in (zone, *setpoints)]
                rows.append((points[0], points[1], points[-1]))
            return rows
        air = of_variables(manifest, *ZONE_TEMPERATURES)
        both = zip(
            air,
            same_zone(air, HEATING_SETPOINT_VARIABLE, manifest),
            same_zone(air, COOLING_SETPOINT_VARIABLE, manifest),
            strict=True,
        )
        rows = [(zone, heat, cool) for zone, heat, cool in both if heat is not None and cool is not None]
        if not rows:
            raise InvalidConfig(
                f"the {self.kind} reward needs sensors of 'Zone Air Temperature', '{HEATING_SETPOINT_VARIABLE}' and "
                f"'{COOLING_SETPOINT_VARIABLE}' with the same key: name them in sensors=, or name others as the "
                "reward's `zones`: {temperature: setpoint}"
            )
        return rows
