"""Trade: a price at which the demand of several plants keeps a limit, from the demands that they really have.

Each bidder is a plant that the price reaches by a connection. Its bid is its demand at several prices: trials, in one
request for all of them. The price that clears is the lowest one at which the sum is within the limit (the intersection
of a double auction in which negative demands are supply; uniform price). Between two prices, further trials follow
until it clears. With approximate bids, each bidder has a straight line through its last demand in place of trials.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from zenostat.topics.arrays import Floats


class Bids(StrEnum):
    """Bids of a market: `TRIALS`: demands of trial steps. `LINEAR`: lines through the last demand."""

    TRIALS = "trials"
    LINEAR = "linear"


class Bidder(BaseModel):
    """A bidder of a market.

    Attributes:
        demand: PLANT.POINT, a power or the energy of the timestep; negative: it supplies.
        slope_w: of a linear bid, W per unit of price; 0 or less.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    demand: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_\-]*\.[A-Za-z0-9_.\-]+$")]
    slope_w: float = Field(0.0, le=0.0, description="Slope of a linear bid, W per unit of price.")


class MarketSpec(BaseModel):
    """A market, as a plant of a district's file; its price is the sensor `price`.

    Attributes:
        low, high: bounds of the price; `low` is the price without congestion.
        unit: of the price.
        limit_w: greatest sum of the demands, W; the default of the actuator `limit`.
        bidders: at least one.
        bids: trials or linear.
        prices: number of prices of a request for trials, 2 or more.
        rounds: greatest number of requests of a step to each bidder, after the first one.
        tolerance_w: what may be left below the limit, W.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    low: float = Field(0.0, description="Lowest price: the one without congestion.")
    high: float = Field(description="Highest price.")
    unit: str = Field("EUR/kWh", description="Unit of the price.")
    limit_w: float = Field(description="Greatest sum of the demands, W.")
    bidders: tuple[Bidder, ...] = Field(min_length=1, description="Bidders.")
    bids: Bids = Field(Bids.TRIALS, description="Bids: trials, or linear.")
    prices: int = Field(5, ge=2, le=64, description="Number of prices of a request.")
    rounds: int = Field(3, ge=1, le=20, description="Greatest number of requests of a step to each bidder.")
    tolerance_w: float = Field(100.0, gt=0.0, description="What may be left below the limit, W.")

    @model_validator(mode="after")
    def _check_prices(self) -> MarketSpec:
        if not self.low < self.high:
            raise ValueError(f"the lowest price {self.low:g} is not below the highest {self.high:g}")
        return self


@dataclass(frozen=True, slots=True)
class Clearing:
    """The result of a market in a step.

    Attributes:
        price: that clears, or the highest one.
        demand_w: sum of the bids at this price.
        is_cleared: whether the sum is within the limit.
        trials: number of prices that were tried.
    """

    price: float
    demand_w: float
    is_cleared: bool
    trials: int


Demand = Callable[[Floats], Floats]
"""The sum of the bids at several prices, W; both of shape (prices,)."""


def clear(demand: Demand, spec: MarketSpec, limit_w: float) -> Clearing:
    """Return the lowest price at which the demand is within the limit, as far as the trials tell.

    The first request is for the lowest price alone: without congestion nothing else is needed. Then `prices` from there
    to the highest one are tried, and, in the interval in which the demand falls below the limit first, `prices` between
    its ends, until at most `tolerance_w` are left below the limit, or for `rounds` requests. The demand need not be
    continuous, or fall everywhere.

    Args:
        demand: the sum of the bids.
        spec: of the market.
        limit_w: greatest sum, W.
    """
    low, high = spec.low, spec.high
    at_low = float(demand(np.array([low]))[0])
    if at_low <= limit_w:
        return Clearing(low, at_low, is_cleared=True, trials=1)
    prices = np.linspace(low, high, spec.prices + 1)[1:]
    best, trials = (high, np.inf), 1
    for _ in range(spec.rounds):
        sums = demand(prices)
        trials += len(prices)
        within = np.flatnonzero(sums <= limit_w)
        if not len(within):
            if best[1] == np.inf:  # not even at the highest price
                return Clearing(high, float(sums[-1]), is_cleared=False, trials=trials)
            low = float(prices[-1])
        else:
            first = int(within[0])
            low, high = float(prices[first - 1]) if first else low, float(prices[first])
            best = high, float(sums[first])
            if limit_w - best[1] <= spec.tolerance_w:
                break
        prices = np.linspace(low, high, spec.prices + 2)[1:-1]
    return Clearing(best[0], best[1], is_cleared=True, trials=trials)


@dataclass(slots=True)
class LinearBids:
    """Lines through the last demands: what a bidder expects that has not tried.

    Attributes:
        slopes_w: of the bidders, W per unit of price.
        price: last price.
        demands_w: last demands, W.
    """

    slopes_w: Floats
    price: float
    demands_w: Floats

    def __call__(self, prices: Floats) -> Floats:
        """Return the sum of the bids at several prices; no bid changes its sign."""
        lines = self.demands_w[None, :] + self.slopes_w[None, :] * (prices[:, None] - self.price)
        is_drawn = self.demands_w[None, :] >= 0.0
        total: Floats = np.where(is_drawn, np.maximum(lines, 0.0), np.minimum(lines, 0.0)).sum(axis=1)
        return total
