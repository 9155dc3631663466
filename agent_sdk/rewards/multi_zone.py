"""A reward on how well each zone keeps its setpoints."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.config import Names, RewardConfig
from zenostat.agent_sdk.rewards.selectors import named, of_variables, powers, same_zone
from zenostat.agent_sdk.rewards.terms import Power, SetpointDegrees, Term, TermSum
from zenostat.agent_sdk.rewards.zone_setpoints import ZonePoints, ZoneSetpoints
from zenostat.topics.energyplus_names import COOLING_SETPOINT_VARIABLE, HEATING_SETPOINT_VARIABLE, ZONE_TEMPERATURES
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.file_fields import as_tuple
from zenostat.topics.messages import Manifest

Setpoints = Annotated[tuple[str | None, ...], BeforeValidator(as_tuple, json_schema_input_type=str | list[str | None])]
"""Names of a zone's setpoint, or of [heating, cooling]; None: no limit on that side."""


class MultiZoneReward(RewardConfig):
    """Weighted sum of power and of degrees outside each zone's band: its setpoints and a threshold around them.

    Source: Sinergym's `MultiZoneReward`, which has one setpoint per zone.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_z max(h_z - d - T_z, T_z - c_z - d, 0)

    h_z and c_z are the heating and cooling setpoint of zone z in degC (equal if there is only one), d the
    threshold. A setpoint that the thermostat does not use at present (it reports 0 then, as for cooling in a season
    with heating only) is no limit. Terms: energy, comfort. Metrics: power_w, degrees_outside.

    Attributes:
        zones: the setpoint sensor, or [heating, cooling] with null for no limit on that side, by the sensor of the
            zone's air temperature; None: the sensors of 'Zone Air Temperature' with those of 'Zone Thermostat Heating
            Setpoint Temperature' and '... Cooling ...' that have the same key.
        threshold: d, K.
        weight, lambda_energy, lambda_temperature, power: as in `LinearReward`.
    """

    kind: Literal["multi_zone"] = "multi_zone"
    zones: dict[str, Setpoints] | None = None
    threshold: float = Field(0.5, ge=0.0)
    weight: float = Field(0.5, ge=0.0, le=1.0)
    lambda_energy: float = Field(1e-4, ge=0.0)
    lambda_temperature: float = Field(1.0, ge=0.0)
    power: Names | None = None

    @field_validator("zones")
    @classmethod
    def _check_zones(cls, zones: dict[str, Setpoints] | None) -> dict[str, Setpoints] | None:
        if zones is not None and not zones:
            raise ValueError("at least one zone expected")
        for zone, setpoints in (zones or {}).items():
            if len(setpoints) not in (1, 2) or not any(setpoints):
                raise ValueError(f"{zone}: a setpoint, or [heating, cooling] expected, one of which may be null")
        return zones

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        power = Power(*powers(self.kind, self.power, manifest))
        terms = [
            Term("energy", -self.weight * self.lambda_energy, power),
            Term(
                "comfort",
                -(1.0 - self.weight) * self.lambda_temperature,
                SetpointDegrees(self.setpoints(manifest), self.threshold),
            ),
        ]
        return TermSum(terms, ["power_w", "degrees_outside"])

    def setpoints(self, manifest: Manifest) -> ZoneSetpoints:
        """Return the zones of a node with their setpoints.

        Raises:
            InvalidConfig: the node does not have a point that is named, or no zone with both setpoints.
        """
        if self.zones is not None:
            rows = []
            for zone, setpoints in self.zones.items():
                limits = [None if name is None else named(self.kind, name, manifest, ["degC"]) for name in setpoints]
                rows.append(ZonePoints(named(self.kind, zone, manifest, ["degC"]), limits[0], limits[-1]))
            return ZoneSetpoints(rows, manifest)
        air = of_variables(manifest, *ZONE_TEMPERATURES)
        both = zip(
            air,
            same_zone(air, HEATING_SETPOINT_VARIABLE, manifest),
            same_zone(air, COOLING_SETPOINT_VARIABLE, manifest),
            strict=True,
        )
        rows = [ZonePoints(zone, heat, cool) for zone, heat, cool in both if heat is not None and cool is not None]
        if not rows:
            raise InvalidConfig(
                f"the {self.kind} reward needs sensors of 'Zone Air Temperature', '{HEATING_SETPOINT_VARIABLE}' and "
                f"'{COOLING_SETPOINT_VARIABLE}' with the same key: name them in sensors=, or name others as the "
                "reward's `zones`: {temperature: setpoint}"
            )
        return ZoneSetpoints(rows, manifest)
