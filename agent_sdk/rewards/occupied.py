"""A reward that asks for comfort where people are."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from agent_sdk.rewards.base import Begin, BoundReward, Outcome
from agent_sdk.rewards.linear import WeightedBound, WeightedReward
from agent_sdk.rewards.selectors import indices, named, same_zone, sum_at
from topics.errors import InvalidConfig
from topics.messages import Manifest

PEOPLE = "Zone People Occupant Count"
_UNITS = ("1", "count", "fraction")


class OccupiedReward(WeightedReward):
    """As `LinearReward`, with the degrees of each zone weighed by its people.

        r = -w * lambda_energy * P - (1 - w) * lambda_temperature * sum_z n_z * max(low - T_z, T_z - high, 0)

    n_z is 1 while people are in zone z (`by: presence`) or their number (`by: people`), and `empty_weight` while
    nobody is. Terms: energy, comfort. Measures: power_w, degrees_outside (weighed), people (in all these zones).

    Attributes:
        by: what weighs.
        empty_weight: n_z of an empty zone.
        occupants: the sensor of a zone's air temperature to that of its people; None: the sensors of 'Zone People
            Occupant Count' with the same key. Zones without any (plenums) are left out, unless `temperatures` names
            them: then it is an error.
    """

    kind: Literal["occupied"] = "occupied"
    by: Literal["presence", "people"] = "presence"
    empty_weight: float = Field(0.0, ge=0.0)
    occupants: dict[str, str] | None = None

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _Bound(self, manifest)

    def pairs(self, zones: list[int], manifest: Manifest) -> list[tuple[int, int]]:
        """Those of these zones' temperatures that count, each with its people, by their places in a sample.

        Raises:
            InvalidConfig: a zone that is named has no people, or none has any.
        """
        return _pairs(self, zones, manifest)


class _Bound(WeightedBound):
    def __init__(self, of: OccupiedReward, manifest: Manifest) -> None:
        super().__init__(of, manifest)
        pairs = of.pairs(self._zones.tolist(), manifest)
        self._zones = indices([zone for zone, _ in pairs])
        self._people = indices([people for _, people in pairs])
        self._by_number, self._empty = of.by == "people", of.empty_weight

    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        people = values.take(self._people, axis=-1)
        weight = np.where(people > 0.0, people if self._by_number else 1.0, self._empty)
        outside = (weight * self._outside(values, begin)).sum(axis=-1)
        power_w = sum_at(values, self._powers)
        energy, comfort = self._energy * power_w, self._comfort * outside
        measures = {"power_w": power_w, "degrees_outside": outside, "people": people.sum(axis=-1)}
        return Outcome(energy + comfort, {"energy": energy, "comfort": comfort}, measures)


def _pairs(of: OccupiedReward, zones: list[int], manifest: Manifest) -> list[tuple[int, int]]:
    """Zones' temperatures with their people."""
    if of.occupants is not None:
        said = {
            named(of.kind, zone, manifest, ["degC"]): named(of.kind, people, manifest, _UNITS)
            for zone, people in of.occupants.items()
        }
        found = [said.get(zone) for zone in zones]
    else:
        found = same_zone(zones, PEOPLE, manifest)
    without = [manifest.sensors[zone] for zone, people in zip(zones, found, strict=True) if people is None]
    if len(without) == len(zones) or (without and of.temperatures is not None):
        lacking = without[0]
        raise InvalidConfig(
            f"the {of.kind} reward does not know how many people are at {lacking.name!r}: name a sensor in sensors=, "
            f"as ({PEOPLE!r}, {lacking.key!r}), or one of those that are there as the reward's "
            f"`occupants`: {{{lacking.name}: sensor}}"
        )
    return [(zone, people) for zone, people in zip(zones, found, strict=True) if people is not None]
