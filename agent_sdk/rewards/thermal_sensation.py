"""A reward on thermal sensation: PMV or PPD."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from pydantic import Field
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import Begin, BoundReward
from zenostat.agent_sdk.rewards.comfort_band import Seasonal
from zenostat.agent_sdk.rewards.config import Names
from zenostat.agent_sdk.rewards.selectors import Indices, indices, named, of_variables, powers, same_zone, temperatures
from zenostat.agent_sdk.rewards.terms import ExcessVotes, Power, Term, TermSum, Votes
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import install_command
from zenostat.topics.messages import Manifest

PMV, PPD = "Zone Thermal Comfort Fanger Model PMV", "Zone Thermal Comfort Fanger Model PPD"
RADIANT, HUMIDITY = "Zone Mean Radiant Temperature", "Zone Air Relative Humidity"


class ThermalSensationReward(Seasonal):
    """Weighted sum of power and of the excess of the predicted mean vote (PMV) or percentage dissatisfied (PPD).

        by pmv: r = -w * lambda_energy * P - (1 - w) * lambda_sensation * sum_z max(|PMV_z| - limit, 0)
        by ppd: r = -w * lambda_energy * P - (1 - w) * lambda_sensation * sum_z max(PPD_z - limit, 0) / 100

    Source: Fanger's model in ISO 7730; its category B is |PMV| < 0.5, PPD < 10 %. PPD is 100 - 95 * exp(-0.03353 *
    PMV^4 - 0.2179 * PMV^2) percent.

    EnergyPlus computes the votes if the node has sensors of 'Zone Thermal Comfort Fanger Model PMV' (or '... PPD' for
    `by: ppd`), with the people, clothing and air speed of the model. Else the library pythermalcomfort (the extra
    `comfort`) computes them from each zone's air temperature, mean radiant temperature and relative humidity, with
    `met`, the clothing and the `air_speed` of this reward.

    Terms: energy, comfort. Metrics: power_w, beyond_limit (the sum over the zones), and pmv_mean or ppd_mean (over
    the zones).

    Attributes:
        by: `pmv` or `ppd`.
        limit: of |PMV| (None: 0.5) or PPD in percent (None: 10).
        weight, lambda_energy, power: as in `LinearReward`.
        lambda_sensation: the comfort term's factor.
        pmv, ppd: names of their sensors; None is all that the node has.
        temperatures, radiant, humidities: names of sensors, in the same order of zones; None is those of each zone.
        met: metabolic rate, met, 0.8 to 4.
        clo_winter, clo_summer: clothing, clo, 0 to 2.
        air_speed: relative air speed, m/s, 0 to 1.
    """

    kind: Literal["thermal_sensation"] = "thermal_sensation"
    by: Literal["pmv", "ppd"] = "pmv"
    limit: float | None = Field(None, ge=0.0)
    weight: float = Field(0.5, ge=0.0, le=1.0)
    lambda_energy: float = Field(1e-4, ge=0.0)
    lambda_sensation: float = Field(1.0, ge=0.0)
    power: Names | None = None
    pmv: Names | None = None
    ppd: Names | None = None
    temperatures: Names | None = None
    radiant: Names | None = None
    humidities: Names | None = None
    met: float = Field(1.2, ge=0.8, le=4.0)
    clo_winter: float = Field(1.0, ge=0.0, le=2.0)
    clo_summer: float = Field(0.5, ge=0.0, le=2.0)
    air_speed: float = Field(0.1, ge=0.0, le=1.0)

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        power = Power(*powers(self.kind, self.power, manifest))
        by_ppd = self.by == "ppd"
        votes = self._dissatisfied(manifest) if by_ppd else self._votes(manifest)
        default_limit, scale, mean = (10.0, 0.01, "ppd_mean") if by_ppd else (0.5, 1.0, "pmv_mean")
        excess = ExcessVotes(votes, default_limit if self.limit is None else self.limit, mean)
        terms = [
            Term("energy", -self.weight * self.lambda_energy, power),
            Term("comfort", -(1.0 - self.weight) * self.lambda_sensation * scale, excess),
        ]
        return TermSum(terms, ["power_w", "beyond_limit", mean])

    def _votes(self, manifest: Manifest) -> Votes:
        """Return PMV by zone: from sensors if there are any, else computed."""
        if self._computes():
            return self._computed(manifest)
        sensors = _sensors(self.kind, self.pmv, PMV, "1", manifest)
        return _read(sensors) if sensors is not None else self._computed(manifest)

    def _dissatisfied(self, manifest: Manifest) -> Votes:
        """Return PPD by zone, in percent."""
        if not self._computes() and self.pmv is None:
            sensors = _sensors(self.kind, self.ppd, PPD, "percent", manifest)
            if sensors is not None:
                return _read(sensors)
        votes = self._votes(manifest)
        return lambda values, begin: percentage_dissatisfied(votes(values, begin))

    def _computes(self) -> bool:
        """Whether the reward names sensors to compute votes from, and no sensors of votes."""
        sources = (self.temperatures, self.radiant, self.humidities)
        return self.pmv is None and self.ppd is None and any(names is not None for names in sources)

    def _computed(self, manifest: Manifest) -> Votes:
        air = temperatures(self.kind, self.temperatures, manifest)
        zones = air.tolist()
        radiant = self._of_zones(zones, self.radiant, RADIANT, "radiant", "degC", manifest)
        humid = self._of_zones(zones, self.humidities, HUMIDITY, "humidities", "percent", manifest)
        clothing = self._seasons((self.clo_winter,), (self.clo_summer,), manifest)
        pmv_ppd = _library(self.kind)

        def votes(values: Floats, begin: Begin) -> Floats:
            (clo,) = clothing.columns(begin)
            result = pmv_ppd(
                tdb=values.take(air, axis=-1), tr=values.take(radiant, axis=-1), rh=values.take(humid, axis=-1),
                vr=self.air_speed, met=self.met, clo=clo, model="7730-2005", limit_inputs=False, round_output=False,
            )  # fmt: skip
            return np.asarray(result.pmv, np.float64)

        return votes

    def _of_zones(
        self, zones: list[int], names: Sequence[str] | None, variable: str, field: str, unit: str, manifest: Manifest
    ) -> Indices:
        """Return a sensor for each zone: those that are named, else those with the zones' keys."""
        if names is not None:
            if len(names) != len(zones):
                raise InvalidConfig(f"the {self.kind} reward names {len(names)} {field} for {len(zones)} temperatures")
            return indices([named(self.kind, name, manifest, [unit]) for name in names])
        sensors = []
        for zone, sensor in zip(zones, same_zone(zones, variable, manifest), strict=True):
            if sensor is None:
                air = manifest.sensors[zone]
                raise InvalidConfig(
                    f"the {self.kind} reward needs ({variable!r}, {air.key!r}) in addition to {air.name!r}: name it in "
                    f"sensors=, or name others as the reward's `{field}`, or sensors of {PMV!r}"
                )
            sensors.append(sensor)
        return indices(sensors)


def percentage_dissatisfied(pmv: Floats) -> Floats:
    """Return PPD in percent (5 to 100) for a predicted mean vote; ISO 7730, equation 5."""
    squared = np.square(pmv)
    ppd: Floats = 100.0 - 95.0 * np.exp(-0.03353 * np.square(squared) - 0.2179 * squared)
    return ppd


def _read(points: Indices) -> Votes:
    return lambda values, begin: values.take(points, axis=-1)  # noqa: ARG005


def _sensors(kind: str, names: Sequence[str] | None, variable: str, unit: str, manifest: Manifest) -> Indices | None:
    """Return the named sensors, else those of the variable; None if there are none."""
    if names is not None:
        return indices([named(kind, name, manifest, [unit]) for name in names])
    sensors = of_variables(manifest, variable.casefold())
    return indices(sensors) if sensors else None


def _library(kind: str) -> Callable[..., Any]:
    """Return Fanger's model; the import takes a second and happens only when it is needed."""
    try:
        models = importlib.import_module("pythermalcomfort.models")
    except ImportError:
        raise InvalidConfig(
            f"the {kind} reward needs the library pythermalcomfort to compute votes: {install_command('comfort')}; "
            f"or name sensors of {PMV!r} in sensors="
        ) from None
    model: Callable[..., Any] = models.pmv_ppd_iso
    return model
