"""Rewards as sums of terms. A term is a factor times a quantity, which is measured at each timestep."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any, NamedTuple, Protocol

import numpy as np
from typing_extensions import override

from zenostat.agent_sdk.rewards.base import Begin, BoundReward, Outcome, Terms
from zenostat.agent_sdk.rewards.energy_meter import EnergyMeter
from zenostat.agent_sdk.rewards.seasons import Seasons
from zenostat.agent_sdk.rewards.selectors import Indices, sum_at
from zenostat.agent_sdk.rewards.slot_state import SlotState
from zenostat.agent_sdk.rewards.zone_setpoints import ZoneSetpoints
from zenostat.topics.arrays import Floats

Band = tuple[float, float]
"""Lowest and highest comfortable air temperature, degC, both inclusive."""

Votes = Callable[[Floats, Begin], Floats]
"""A function from the values of a timestep to PMV, or PPD in percent, by zone."""

_MAX_SEQUENTIAL_SUM = 7
"""NumPy adds up to this many numbers sequentially: a plain loop gives the same bits, faster."""

MAX_K = 100.0
"""Upper limit of the degrees outside, so that the exponential stays finite."""


class Quantity(ABC):
    """A quantity that a term weighs."""

    @abstractmethod
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        """Return the quantity of a timestep and add its metrics.

        Args:
            values: shape (points,) or (slots, points), in the order and units of the manifest.
            begin: time at which the timestep began.
            metrics: the reward's metrics, by name; None where they are not measured yet.
        """


class Term(NamedTuple):
    """One addend of a reward: `factor`, which may depend on the time, times `quantity`."""

    name: str
    factor: float | Callable[[Begin], Any]
    quantity: Quantity


class TermSum(BoundReward):
    """A reward that is the sum of terms, bound to the points of one node.

    Args:
        terms: the terms in the order in which they are added.
        metrics: names of the metrics in the order in which they are reported.
        slot_state: the state of the quantities, if any.
        keeps_state: whether a new episode keeps the state.
    """

    def __init__(
        self,
        terms: Sequence[Term],
        metrics: Sequence[str],
        slot_state: SlotState | None = None,
        *,
        keeps_state: bool = False,
    ) -> None:
        self._terms: list[tuple[str, Any, bool, Callable[..., Any]]] = [
            (term.name, term.factor, callable(term.factor), term.quantity.measure) for term in terms
        ]
        self._metrics: Terms = dict.fromkeys(metrics)
        self._slot_state, self._keeps_state = slot_state, keeps_state

    @override
    def __call__(self, values: Floats, begin: Begin) -> Outcome:
        metrics, terms, total = self._metrics.copy(), {}, None
        for name, factor, varies, measure in self._terms:
            term = terms[name] = (factor(begin) if varies else factor) * measure(values, begin, metrics)
            total = term if total is None else total + term
        return Outcome(total, terms, metrics)

    @override
    def reset(self, slots: Sequence[int] | None = None) -> None:
        if self._slot_state is not None and not self._keeps_state:
            self._slot_state.reset(slots)

    @override
    def state(self) -> dict[str, Any]:
        return {} if self._slot_state is None else self._slot_state.state()

    @override
    def restore(self, state: dict[str, Any]) -> None:
        if self._slot_state is not None:
            self._slot_state.restore(state)


class Power(Quantity):
    """The sum of points of power in W. Metric: power_w.

    Args:
        points: sensors or meters.
        to_w: factor from the sum of their values to W.
    """

    def __init__(self, points: Indices, to_w: float = 1.0) -> None:
        self._points, self._to_w = points, to_w

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        power_w = metrics["power_w"] = sum_at(values, self._points) * self._to_w
        return power_w


class DegreesOutside(Quantity):
    """The degrees outside the comfort band in K, summed over the zones. Metric: degrees_outside.

    Args:
        season: the band by season, degC.
        zones: sensors of zone air temperatures.
    """

    def __init__(self, season: Seasons[Band], zones: Indices) -> None:
        self.season, self.zones = season, zones

    def by_zone(self, values: Floats, begin: Begin) -> Floats:
        """Return the degrees outside the band of each zone."""
        low, high = self.season.columns(begin)
        air = values.take(self.zones, axis=-1)
        return np.maximum(np.maximum(low - air, air - high), 0.0)

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        if values.ndim == 1 and len(self.zones) <= _MAX_SEQUENTIAL_SUM and isinstance(begin, datetime):
            low, high = self.season.band(begin)
            outside = 0.0
            for air in values.take(self.zones).tolist():
                outside += max(low - air, air - high, 0.0)
            metrics["degrees_outside"] = outside
            return outside
        degrees = metrics["degrees_outside"] = np.add.reduce(self.by_zone(values, begin), axis=-1)
        return degrees


class ExponentialDegrees(Quantity):
    """The exponential of the degrees outside of each zone outside its band. Metric: degrees_outside, their sum."""

    def __init__(self, degrees: DegreesOutside) -> None:
        self._degrees = degrees

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        outside = self._degrees.by_zone(values, begin)
        metrics["degrees_outside"] = outside.sum(axis=-1)
        return np.where(outside > 0.0, np.exp(np.minimum(outside, MAX_K)), 0.0).sum(axis=-1)


class OccupiedDegrees(Quantity):
    """The degrees outside, weighted by the occupancy of each zone. Metrics: degrees_outside (weighted), people.

    Args:
        degrees: the degrees outside.
        people: the sensor of each zone's number of people.
        by_number: whether the number of people is the weight; else 1 while there are people.
        empty_weight: weight of an empty zone.
    """

    def __init__(self, degrees: DegreesOutside, people: Indices, *, by_number: bool, empty_weight: float) -> None:
        self._degrees, self._people = degrees, people
        self._by_number, self._empty_weight = by_number, empty_weight

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        people = values.take(self._people, axis=-1)
        weight = np.where(people > 0.0, people if self._by_number else 1.0, self._empty_weight)
        outside = metrics["degrees_outside"] = (weight * self._degrees.by_zone(values, begin)).sum(axis=-1)
        metrics["people"] = people.sum(axis=-1)
        return outside


class SetpointDegrees(Quantity):
    """The degrees outside each zone's setpoints and a threshold, in K, summed. Metric: degrees_outside.

    Args:
        setpoints: the zones with their setpoints.
        threshold_k: the threshold.
    """

    def __init__(self, setpoints: ZoneSetpoints, threshold_k: float) -> None:
        self._setpoints, self._threshold_k = setpoints, threshold_k

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        air = values.take(self._setpoints.air, axis=-1)
        cold = self._setpoints.heating(values) - self._threshold_k - air
        warm = air - self._setpoints.cooling(values) - self._threshold_k
        outside = metrics["degrees_outside"] = np.maximum(np.maximum(cold, warm), 0.0).sum(axis=-1)
        return outside


class ExcessVotes(Quantity):
    """PMV or PPD beyond a limit, summed over the zones. Metrics: beyond_limit, and the mean over the zones.

    Args:
        votes: PMV or PPD by zone.
        limit: limit of their absolute values.
        mean_metric: name of the mean.
    """

    def __init__(self, votes: Votes, limit: float, mean_metric: str) -> None:
        self._votes, self._limit, self._mean_metric = votes, limit, mean_metric

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        votes = self._votes(values, begin)
        beyond = metrics["beyond_limit"] = np.maximum(np.abs(votes) - self._limit, 0.0).sum(axis=-1)
        metrics[self._mean_metric] = votes.mean(axis=-1)
        return beyond


class EnergyQuantity(Quantity):
    """Base of quantities that depend on the energy of the timestep; a reward measures it once. Metric: energy_kwh.

    Args:
        meter: the energy.
        energy_metric: another name of the metric, in a reward that measures several energies.
    """

    def __init__(self, meter: EnergyMeter, energy_metric: str = "energy_kwh") -> None:
        self._meter, self._energy_metric = meter, energy_metric

    def kwh(self, values: Floats, metrics: Terms) -> Any:
        """Return the energy in kWh and add it to the metrics."""
        kwh = metrics.get(self._energy_metric)
        if kwh is None:
            kwh = metrics[self._energy_metric] = self._meter.kwh(values)
        return kwh


class MeanPower(EnergyQuantity):
    """The mean power of the timestep in W. Metrics: power_w, energy_kwh."""

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        power_w = metrics["power_w"] = self.kwh(values, metrics) * self._meter.kw_per_kwh * 1e3
        return power_w


class Signal(Protocol):
    """A signal of `zenostat.time_series`."""

    def at(self, begin: Any, /) -> Any:
        """Return the value, or those of each slot."""


class PricedEnergy(EnergyQuantity):
    """Energy times a price or a carbon intensity. Metrics: energy_kwh, and the product.

    Args:
        meter: the energy.
        signal: the price or intensity.
        per_kwh: factor that converts the signal to an amount per kWh.
        metric: name of the product.
        energy_metric: name of the energy in the metrics.
    """

    def __init__(
        self, meter: EnergyMeter, signal: Signal, per_kwh: float, metric: str, energy_metric: str = "energy_kwh"
    ) -> None:
        super().__init__(meter, energy_metric)
        self._signal, self._per_kwh, self._metric = signal, per_kwh, metric

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        amount = metrics[self._metric] = self.kwh(values, metrics) * (self._signal.at(begin) * self._per_kwh)
        return amount


class PeakIncrease(EnergyQuantity):
    """The increase of the month's peak demand in kW. Metrics: energy_kwh, peak_kw.

    Args:
        meter: the energy.
        slot_state: has the numbers `month` and `peak_kw`.
        threshold_kw: the peak at the start of each month.
        energy_metric: name of the energy in the metrics.
    """

    def __init__(
        self, meter: EnergyMeter, slot_state: SlotState, threshold_kw: float, energy_metric: str = "energy_kwh"
    ) -> None:
        super().__init__(meter, energy_metric)
        self._slot_state, self._threshold_kw = slot_state, threshold_kw

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        demand_kw = self.kwh(values, metrics) * self._meter.kw_per_kwh
        shape = np.shape(demand_kw)
        former, month = self._slot_state.of(shape), np.broadcast_to(_months(begin), shape)
        before_kw = np.where(former["month"] == month, former["peak_kw"], self._threshold_kw)
        peak_kw = metrics["peak_kw"] = np.maximum(before_kw, demand_kw)
        self._slot_state.store(month=month, peak_kw=peak_kw)
        return peak_kw - before_kw


def _months(begin: Begin) -> Any:
    """Return the months since year 0, which differ between years."""
    if isinstance(begin, datetime):
        return begin.year * 12 + begin.month
    return np.array([moment.year * 12 + moment.month for moment in begin])


class RelativeToMaximum(Quantity):
    """A quantity divided by its maximum so far. Metrics: those of the quantity, and the maximum.

    Args:
        quantity: the quantity.
        slot_state: has the maximum.
        maximum: the maximum's name in the state and in the metrics.
        moving: whether the maximum grows.
    """

    def __init__(self, quantity: Quantity, slot_state: SlotState, maximum: str, *, moving: bool) -> None:
        self._quantity, self._slot_state, self._maximum, self._moving = quantity, slot_state, maximum, moving

    @override
    def measure(self, values: Floats, begin: Begin, metrics: Terms) -> Any:
        amount = self._quantity.measure(values, begin, metrics)
        maximum = self._slot_state.of(values.shape[:-1])[self._maximum]
        if self._moving:
            maximum = np.maximum(maximum, amount)
            self._slot_state.store(**{self._maximum: maximum})
        else:
            maximum = maximum[()]
        metrics[self._maximum] = maximum
        return amount / np.where(maximum > 0.0, maximum, 1.0)
