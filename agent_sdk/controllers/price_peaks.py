"""Hours of high prices, by the price of the task's reward."""

from __future__ import annotations

from datetime import datetime, timedelta

from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, number
from zenostat.agent_sdk.rewards.energy_cost import TariffReward
from zenostat.agent_sdk.rewards.manifest_data import known_rewards
from zenostat.agent_sdk.time_series import TimeOfUse, TimeSeries
from zenostat.topics.messages import Manifest

_HOUR = timedelta(hours=1)


class PricePeaks:
    """Hours whose price is above the middle between the day's lowest and highest price.

    Args:
        manifest: manifest of the node; the price is that of electricity in the reward that is paid, else in the
            scenario's.
        lead_h: hours before a peak in which zones are preconditioned, 0 to 12.

    Raises:
        ControllerMismatch: no reward of the task has a price.
    """

    def __init__(self, manifest: Manifest, lead_h: float) -> None:
        self._price = price_of(manifest)
        self._lead = timedelta(hours=lead_h)
        self._peaks: dict[datetime, tuple[bool, ...]] = {}

    def is_peak(self, at: datetime) -> bool:
        """Return whether the price is high at a time."""
        day = at.replace(hour=0, minute=0, second=0, microsecond=0)
        if day not in self._peaks:
            prices = [float(self._price.at(day + hour * _HOUR)) for hour in range(24)]
            middle = (min(prices) + max(prices)) / 2
            self._peaks = {day: tuple(price > middle for price in prices), **dict(list(self._peaks.items())[:1])}
        return self._peaks[day][at.hour]

    def is_before_peak(self, at: datetime) -> bool:
        """Return whether a peak begins within the lead from now on."""
        if self.is_peak(at):
            return False
        end, hour = at + self._lead, at.replace(minute=0, second=0, microsecond=0) + _HOUR
        while hour <= end:
            if self.is_peak(hour):
                return True
            hour += _HOUR
        return False


class PriceShifts:
    """Shifts of the setpoints of occupied zones: stored energy before hours of high prices, less use in them.

    Source: Xu, Haves, Piette and Braun, "Peak demand reduction from pre-cooling with zone temperature reset in an
    office building", LBNL-55800, 2004.

    Args:
        manifest: manifest of the node, which needs a price if a shift is not 0; see `PricePeaks`.
        precooling: lowering of cooling setpoints before hours of high prices, K, at least 0.
        preheating: raise of heating setpoints before these hours, K, at least 0.
        price_lead: time before these hours, h, 0 to 12.
        shed_cooling: raise of cooling setpoints during these hours, K, at least 0.
        shed_heating: lowering of heating setpoints during these hours, K, at least 0.

    Raises:
        InvalidConfig: a parameter is out of its range.
        ControllerMismatch: no reward of the task has a price.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        precooling: float,
        preheating: float,
        price_lead: float,
        shed_cooling: float,
        shed_heating: float,
    ) -> None:
        self._before = number("preheating", preheating, minimum=0.0), -number("precooling", precooling, minimum=0.0)
        self._within = (
            -number("shed_heating", shed_heating, minimum=0.0),
            number("shed_cooling", shed_cooling, minimum=0.0),
        )
        lead_h = number("price_lead", price_lead, minimum=0.0, maximum=12.0)
        self._peaks = PricePeaks(manifest, lead_h) if any(self._before) or any(self._within) else None

    def at(self, now: datetime) -> tuple[float, float]:
        """Return the shift of heating setpoints and of cooling setpoints, K."""
        if self._peaks is None:
            return 0.0, 0.0
        if self._peaks.is_peak(now):
            return self._within
        return self._before if self._peaks.is_before_peak(now) else (0.0, 0.0)


def price_of(manifest: Manifest) -> TimeSeries:
    """Return the price of electricity in the task's reward.

    Raises:
        ControllerMismatch: no reward of the task has a price.
    """
    for reward in known_rewards(manifest):
        price = getattr(reward, "price", None)
        if isinstance(price, TimeSeries):
            price.load()
            return price
        if isinstance(reward, TariffReward):
            return TimeOfUse(table=reward.periods, otherwise=reward.otherwise, unit=reward.unit)
    raise ControllerMismatch(
        f"preconditioning before price peaks needs the price of electricity, which the reward of node "
        f"{manifest.node!r} does not have: use the reward occupied_cost, energy_cost or tariff"
    )
