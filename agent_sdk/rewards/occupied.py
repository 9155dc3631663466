"""Rewards on comfort in occupied zones."""

from __future__ import annotations

from typing import Literal

from pydantic import Field
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.comfort_band import ComfortBand
from zenostat.agent_sdk.rewards.linear import WeightedReward
from zenostat.agent_sdk.rewards.selectors import indices, named, same_zone
from zenostat.agent_sdk.rewards.terms import DegreesOutside, OccupiedDegrees, TermSum
from zenostat.topics.energyplus_names import OCCUPANTS
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

PEOPLE = OCCUPANTS
_UNITS = ("1", "count", "fraction")


class OccupiedComfort(ComfortBand):
    """Base of rewards that weight the degrees outside of each zone by its occupancy.

    Attributes:
        by: the weights, `presence` or `people`.
        empty_weight: n_z of an empty zone.
        occupants: the sensor of a zone's number of people by that of its air temperature; None: the sensors of 'Zone
            People Occupant Count' with the same key. Zones without such a sensor (plenums) are ignored, unless
            `temperatures` names them, which is an error.
    """

    by: Literal["presence", "people"] = "presence"
    empty_weight: float = Field(0.0, ge=0.0)
    occupants: dict[str, str] | None = None

    def _occupied_degrees(self, manifest: Manifest) -> OccupiedDegrees:
        degrees = self._degrees_outside(manifest)
        zones, people = zip(*self.pairs(degrees.zones.tolist(), manifest), strict=True)
        return OccupiedDegrees(
            DegreesOutside(degrees.season, indices(zones)),
            indices(people),
            by_number=self.by == "people",
            empty_weight=self.empty_weight,
        )

    def pairs(self, zones: list[int], manifest: Manifest) -> list[tuple[int, int]]:
        """Return the zones' temperatures with their numbers of people, as indices in a sample.

        Raises:
            InvalidConfig: a zone that the reward names has no number of people, or no zone has one.
        """
        return _pairs(self, zones, manifest)


class OccupiedReward(OccupiedComfort, WeightedReward):
    """`LinearReward` with the degrees of each zone weighted by its occupancy.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_z n_z * max(low - T_z, T_z - high, 0)

    n_z is 1 while zone z is occupied (`by: presence`) or its number of people (`by: people`), and `empty_weight` while
    it is empty. Terms: energy, comfort. Metrics: power_w, degrees_outside (weighted), people (in all these zones).

    Attributes:
        by, empty_weight, occupants: see `OccupiedComfort`.
    """

    kind: Literal["occupied"] = "occupied"

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        terms = [self._energy_term(manifest), self._comfort_term(self._occupied_degrees(manifest))]
        return TermSum(terms, ["power_w", "degrees_outside", "people"])


def _pairs(reward: OccupiedComfort, zones: list[int], manifest: Manifest) -> list[tuple[int, int]]:
    if reward.occupants is not None:
        by_zone = {
            named(reward.kind, zone, manifest, ["degC"]): named(reward.kind, people, manifest, _UNITS)
            for zone, people in reward.occupants.items()
        }
        sensors = [by_zone.get(zone) for zone in zones]
    else:
        sensors = same_zone(zones, PEOPLE, manifest)
    missing = [manifest.sensors[zone] for zone, people in zip(zones, sensors, strict=True) if people is None]
    if len(missing) == len(zones) or (missing and reward.temperatures is not None):
        first = missing[0]
        raise InvalidConfig(
            f"the {reward.kind} reward needs the number of people at {first.name!r}: name a sensor in sensors=, "
            f"such as ({PEOPLE!r}, {first.key!r}), or name an existing sensor as the reward's "
            f"`occupants`: {{{first.name}: sensor}}"
        )
    return [(zone, people) for zone, people in zip(zones, sensors, strict=True) if people is not None]
