"""A reward on the points that the buildings of a district share."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import Begin, BoundReward, Terms
from zenostat.agent_sdk.rewards.comfort_band import ComfortBand
from zenostat.agent_sdk.rewards.config import Names
from zenostat.agent_sdk.rewards.energy_meter import EnergyMeter
from zenostat.agent_sdk.rewards.selectors import indices
from zenostat.agent_sdk.rewards.slot_state import SlotState
from zenostat.agent_sdk.rewards.terms import Quantity, Term, TermSum
from zenostat.agent_sdk.time_series import price_per_kwh
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import Manifest
from zenostat.topics.points import is_mean, value_index

Weight = Annotated[float, Field(ge=0.0)]

_UNKNOWN = -np.inf
"""A power or a price before the first timestep."""

_METRICS = {
    "peak": "peak_kw",
    "limit": "limit_excess",
    "ramping": "ramp_kw",
    "cost": "cost",
    "feed_in": "feed_in_kwh",
    "comfort": "degrees_outside",
}


class Limit(BaseModel):
    """An upper limit of a point, such as the loading of a transformer.

    Attributes:
        point: sensor or meter.
        high: limit, in the point's unit, above 0.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    point: str
    high: float = Field(gt=0.0)


class DistrictReward(ComfortBand):
    """Weighted sum of what a district costs its grid, and of degrees outside comfort bands.

        r = -w * (peak * max(P - P_max, 0) + limit * sum_l max(x_l / high_l - 1, 0) + ramping * |P - P_before|
            + cost * max(E, 0) * price + feed_in * max(-E, 0)) - (1 - w) * lambda_temperature * D
        D = sum_z max(low - T_z, T_z - high, 0)

    E is the net consumption of the timestep in kWh, P the same as mean power in kW: `consumption` less `generation`.
    P_max is the maximum of P on the calendar day so far, at least 0, so the first terms of a day add up to its peak.
    P_before is P of the previous timestep; the first one of an episode has no ramp. The price of a point that is a mean
    over the timestep, such as a market's, is its value of that timestep. Of any other point it is the value at the
    beginning of the timestep, or, in the first timestep of an episode, at its end.

    Terms: peak, limit, ramping, cost, feed_in, comfort, each if its weight is above 0. Metrics: net_kw (P), and with
    each term: peak_kw (P_max with this timestep), limit_excess, ramp_kw, cost, feed_in_kwh, degrees_outside.

    Attributes:
        weight: w, the weight of the grid against comfort, 0 to 1.
        consumption: names of meters (J) or power sensors (W) whose sum the district draws, such as a grid's import.
        generation: names of what it feeds in, such as a grid's export.
        limits: limits of points, all with the same weight.
        price: name of the point that has the price of energy; without it there is no cost.
        temperatures: names of the sensors of zone air temperatures; None: no comfort.
        peak: 1/kW.
        limit: weight of the excess over limits, relative to the limit.
        ramping: 1/kW.
        cost: per unit of currency.
        feed_in: weight of energy that is fed in rather than used in the district, 1/kWh.
        lambda_temperature: 1/K.
    """

    kind: Literal["district"] = "district"
    weight: float = Field(0.5, ge=0.0, le=1.0)
    consumption: Names
    generation: Names = ()
    limits: tuple[Limit, ...] = ()
    price: str | None = None
    peak: Weight = 1.0
    limit: Weight = 10.0
    ramping: Weight = 0.1
    cost: Weight = 1.0
    feed_in: Weight = 0.0
    lambda_temperature: Weight = 1.0

    @override
    def bind(self, manifest: Manifest) -> BoundReward:
        net = NetPower(self.kind, self.consumption, self.generation, manifest)
        state = SlotState(self.kind, day=-1.0, peak_kw=0.0, before_kw=_UNKNOWN, price=_UNKNOWN)
        w, quantities = self.weight, dict[str, tuple[float, Quantity]]()
        quantities["peak"] = w * self.peak, DailyPeakIncrease(net, state)
        if self.limits:
            limits = [(_index(self.kind, limit.point, manifest), limit.high) for limit in self.limits]
            quantities["limit"] = w * self.limit, LimitExcess(limits)
        quantities["ramping"] = w * self.ramping, Ramp(net, state)
        if self.price is not None:
            index = _index(self.kind, self.price, manifest)
            quantities["cost"] = (
                w * self.cost,
                Cost(
                    net,
                    index,
                    price_per_kwh(f"the district reward's price {self.price!r}", manifest.points[index].unit),
                    state,
                    is_mean=is_mean(manifest.points[index]),
                ),
            )
        quantities["feed_in"] = w * self.feed_in, FeedIn(net)
        if self.temperatures is not None:
            quantities["comfort"] = (1.0 - w) * self.lambda_temperature, self._degrees_outside(manifest)
        terms = [Term(name, -factor, quantity) for name, (factor, quantity) in quantities.items() if factor]
        if not terms:
            raise InvalidConfig(f"the district reward has no weight above 0; there are: {', '.join(_METRICS)}")
        return TermSum(terms, ["net_kw", *(_METRICS[term.name] for term in terms)], state)


def _index(kind: str, name: str, manifest: Manifest) -> int:
    index = value_index(manifest)
    if name not in index:
        raise InvalidConfig(
            f"the {kind} reward names {name!r}, which the node does not have; {did_you_mean(name, list(index))}"
        )
    return index[name]


class NetPower:
    """Net consumption of a district: what it draws less what it feeds in.

    Args:
        kind: of the reward, for errors.
        consumption, generation: meters in J or power sensors in W.
        manifest: the node's manifest.

    Raises:
        InvalidConfig: a point does not exist, or is neither energy nor power.
    """

    def __init__(self, kind: str, consumption: Names, generation: Names, manifest: Manifest) -> None:
        self._drawn = EnergyMeter(kind, consumption, manifest)
        self._fed = EnergyMeter(kind, generation, manifest) if generation else None

    def kw(self, values: Floats, metrics: Terms) -> Any:
        """Return the net mean power of the timestep in kW, with the leading shape of `values`. Metric: net_kw."""
        net_kw = metrics.get("net_kw")
        if net_kw is None:
            kwh = self._drawn.kwh(values)
            net_kwh = kwh if self._fed is None else kwh - self._fed.kwh(values)
            net_kw = metrics["net_kw"] = net_kwh * self._drawn.kw_per_kwh
        return net_kw

    def kwh(self, values: Floats, metrics: Terms) -> Any:
        """Return the net energy of the timestep in kWh; as `kw`."""
        return self.kw(values, metrics) / self._drawn.kw_per_kwh


class DailyPeakIncrease(Quantity):
    """The increase of the day's highest net power, kW. Metric: peak_kw."""

    def __init__(self, net: NetPower, state: SlotState) -> None:
        self._net, self._state = net, state

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        net_kw = self._net.kw(values, metrics)
        shape = np.shape(net_kw)
        former, day = self._state.of(shape), np.broadcast_to(_days(begin), shape)
        before_kw = np.where(former["day"] == day, former["peak_kw"], 0.0)
        peak_kw = metrics["peak_kw"] = np.maximum(before_kw, net_kw)
        self._state.store(day=day, peak_kw=peak_kw)
        return peak_kw - before_kw


def _days(begin: Begin) -> Any:
    return begin.toordinal() if isinstance(begin, datetime) else np.array([moment.toordinal() for moment in begin])


class LimitExcess(Quantity):
    """The excess over limits, relative to each of them, summed. Metric: limit_excess.

    Args:
        limits: index of a point, and its limit.
    """

    def __init__(self, limits: list[tuple[int, float]]) -> None:
        self._points = indices([point for point, _ in limits])
        self._high = np.array([high for _, high in limits])

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        excess = np.maximum(values.take(self._points, axis=-1) / self._high - 1.0, 0.0)
        total = metrics["limit_excess"] = np.add.reduce(excess, axis=-1)
        return total


class Ramp(Quantity):
    """The absolute change of net power since the previous timestep, kW; 0 in the first one. Metric: ramp_kw."""

    def __init__(self, net: NetPower, state: SlotState) -> None:
        self._net, self._state = net, state

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        net_kw = self._net.kw(values, metrics)
        before_kw = self._state.of(np.shape(net_kw))["before_kw"]
        ramp_kw = metrics["ramp_kw"] = np.where(before_kw == _UNKNOWN, 0.0, np.abs(net_kw - before_kw))[()]
        self._state.store(before_kw=np.asarray(net_kw))
        return ramp_kw


class Cost(Quantity):
    """The cost of the energy that is drawn, at the price of the timestep. Metric: cost.

    A point that is a mean over the timestep, as the price of a market, has the price of that timestep; any other has
    that of the coming one. That of the first timestep is then not known, and is taken from its end.

    Args:
        net: net consumption.
        price: index of the point.
        per_kwh: factor from its value to the price per kWh.
        state: has the number `price`.
        is_mean: whether the point is a mean over the timestep.
    """

    def __init__(self, net: NetPower, price: int, per_kwh: float, state: SlotState, *, is_mean: bool) -> None:
        self._net, self._price, self._per_kwh, self._state, self._is_mean = net, price, per_kwh, state, is_mean

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        kwh = np.maximum(self._net.kwh(values, metrics), 0.0)
        price = values.take(self._price, axis=-1) * self._per_kwh
        if self._is_mean:
            cost = metrics["cost"] = kwh * price
            return cost
        known = self._state.of(np.shape(kwh))["price"]
        cost = metrics["cost"] = kwh * np.where(known == _UNKNOWN, price, known)
        self._state.store(price=np.asarray(price))
        return cost


class FeedIn(Quantity):
    """The energy that is fed in, kWh. Metric: feed_in_kwh."""

    def __init__(self, net: NetPower) -> None:
        self._net = net

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        kwh = metrics["feed_in_kwh"] = np.maximum(-self._net.kwh(values, metrics), 0.0)
        return kwh
