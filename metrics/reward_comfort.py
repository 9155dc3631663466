"""Comfort bands of a building's zones by its reward, for metrics, KPIs and pictures."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from zenostat.agent_sdk.rewards import MultiZoneReward, Reward
from zenostat.agent_sdk.rewards.comfort_band import ComfortBand
from zenostat.agent_sdk.rewards.manifest_data import known_rewards
from zenostat.agent_sdk.rewards.occupied import PEOPLE, OccupiedComfort
from zenostat.agent_sdk.rewards.selectors import same_zone, temperatures
from zenostat.metrics.comfort import DEFAULT_BAND_DEGC, Comfort, default_comfort
from zenostat.metrics.roles import roles
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest


def comfort(manifest: Manifest, reward: Reward | None = None) -> Comfort | None:
    """Return the comfort bands of the zones that a reward rates; None where no reward has a band.

    Args:
        manifest: manifest of the node.
        reward: a reward with a comfort band; None, or a reward without a band: that of the task.
    """
    for candidate in (reward, *known_rewards(manifest)):
        try:
            if isinstance(candidate, ComfortBand):
                return _from_band(candidate, manifest)
            if isinstance(candidate, MultiZoneReward):
                return _from_setpoints(candidate, manifest)
        except InvalidConfig:  # the node lacks the temperatures
            continue
    return None


def display_comfort(manifest: Manifest, reward: Reward | None = None) -> Comfort | None:
    """Return comfort bands of all zones of a manifest, for pictures; None where it has no zone temperature.

    The zones are those of `zenostat.metrics.roles`, in its order. Those that the reward rates have its band; all
    others have the band of the reward too, or `DEFAULT_BAND_DEGC` where each zone has its own or no reward has one.
    """
    shown, rated = default_comfort(manifest), comfort(manifest, reward)
    if shown is None or rated is None:
        return shown
    column = {int(index): place for place, index in enumerate(rated.zones)}
    places = np.array([column.get(int(index), -1) for index in shown.zones], np.intp)

    def band(values: Floats, begin: datetime) -> tuple[Floats, Floats]:
        low, high = rated.limits(values, begin)
        rest = (float(low[0]), float(high[0])) if not rated.follows_setpoints else DEFAULT_BAND_DEGC
        return np.append(low, rest[0])[places], np.append(high, rest[1])[places]

    source = rated.source.partition(", ")[2]
    setpoints = [rated.setpoints[place] if place >= 0 else () for place in places]
    return Comfort(
        source, shown.zones.tolist(), shown.people, band, follows_setpoints=rated.follows_setpoints, setpoints=setpoints
    )


def _from_band(reward: ComfortBand, manifest: Manifest) -> Comfort:
    band, zones = reward.season(manifest).band, temperatures(reward.kind, reward.temperatures, manifest).tolist()
    if isinstance(reward, OccupiedComfort):
        zones, people = map(list, zip(*reward.pairs(zones, manifest), strict=True))
    else:
        people = _occupants(zones, manifest)
    return Comfort(_of(reward), zones, people, lambda _, begin: band(begin))


def _from_setpoints(reward: MultiZoneReward, manifest: Manifest) -> Comfort:
    setpoints, threshold = reward.setpoints(manifest), reward.threshold
    air = [zone.air for zone in setpoints.zones]
    return Comfort(
        _of(reward),
        air,
        _occupants(air, manifest),
        lambda values, _: (setpoints.heating(values) - threshold, setpoints.cooling(values) + threshold),
        follows_setpoints=True,
        setpoints=[[point for point in zone[1:] if point is not None] for zone in setpoints.zones],
    )


def _occupants(zones: list[int], manifest: Manifest) -> list[int | None]:
    """Return the occupant count of each zone; that of a plant without output variables is found by its name."""
    own = {zone.temperature: zone.occupants for zone in roles(manifest).zones}
    of_variables = same_zone(zones, PEOPLE, manifest, observed=False)
    return [
        sensor if manifest.sensors[zone].variable else own.get(zone)
        for zone, sensor in zip(zones, of_variables, strict=True)
    ]


def _of(reward: ComfortBand | MultiZoneReward) -> str:
    return f"the band of the {reward.kind} reward"
