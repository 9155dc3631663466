"""A market as a plant of a district."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.cosim.coupled import Rows
from zenostat.cosim.market import Clearing, MarketSpec
from zenostat.cosim.resampling import whole_steps
from zenostat.topics import VERSION
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Actuator, Aggregation, Manifest, Mode, Policy, Sensor, Versions

SENSORS = ("price", "demand", "cleared_demand", "limit", "cleared", "trials")
"""Sensors of a market, in this order."""

_MEANS = ("price", "demand", "cleared_demand", "limit")
"""Those that hold for the timestep; a district whose timestep is longer has their means."""

PRICE = SENSORS.index("price")


def market_manifest(name: str, spec: MarketSpec, others: Mapping[str, Manifest], step_s: float | None) -> Manifest:
    """Return the manifest of a market, which has the time of the other plants.

    Args:
        name: of the market.
        spec: of it.
        others: manifests of the other plants.
        step_s: timestep of the district; None: the longest of the other plants.
    """
    longest = max(others.values(), key=lambda manifest: manifest.step_s)
    step_s = longest.step_s if step_s is None else step_s
    duration_s = min(manifest.steps * manifest.step_s for manifest in others.values())
    units = {"price": spec.unit, "demand": "W", "cleared_demand": "W", "limit": "W", "cleared": "on_off"}
    return Manifest(
        node=name,
        instance="1",
        building="market",
        begin=longest.begin,
        end=longest.end,
        step_s=step_s,
        steps=whole_steps(duration_s, step_s),
        mode=Mode.LOCKSTEP,
        policy=Policy.WAIT,
        sensors=tuple(
            Sensor(
                name=sensor,
                unit=units.get(sensor, "count"),
                aggregation=Aggregation.MEAN if sensor in _MEANS else Aggregation.INSTANT,
                low=spec.low if sensor == "price" else None,
                high=spec.high if sensor == "price" else None,
            )
            for sensor in SENSORS
        ),
        meters=(),
        actuators=(Actuator(name="limit", unit="W", default=spec.limit_w),),
        versions=Versions(zenostat=VERSION),
    )


class MarketPlant:
    """A market as a coupled plant; the orchestration clears it, since only that can try the other plants.

    Args:
        manifest: of the market.
        spec: of it.

    Attributes:
        limit_w: of the present step, W.
    """

    def __init__(self, manifest: Manifest, spec: MarketSpec) -> None:
        self.manifest, self.spec = manifest, spec
        self._row = np.zeros(len(SENSORS))
        self.limit_w = spec.limit_w
        self._tried: list[int] = []

    def reset(self, seed: int) -> Rows:  # noqa: ARG002
        """Begin at the lowest price."""
        self._row = np.array([self.spec.low, 0.0, 0.0, self.spec.limit_w, 1.0, 0.0])
        self.limit_w = self.spec.limit_w
        return self._rows()

    def begin(self, commands: Floats) -> None:
        """Take over the limit."""
        limit_w = float(commands[-1, 0])
        self.limit_w = self.spec.limit_w if np.isnan(limit_w) else limit_w

    def finish(self) -> Rows:
        """Return the present values."""
        return self._rows()

    def settle(self, clearing: Clearing, demand_w: float) -> Rows:
        """Take over the result of a step, and what the bidders really had."""
        self._row = np.array([
            clearing.price, demand_w, clearing.demand_w, self.limit_w, float(clearing.is_cleared), clearing.trials
        ])  # fmt: skip
        return self._rows()

    def _rows(self) -> Rows:
        return Rows(self._row[None, :].copy(), np.array([[self.limit_w]]))

    def begin_trial(self, commands: Sequence[Floats]) -> None:
        """Note the alternatives: a market has no state of its own."""
        self._tried = [len(rows) for rows in commands]

    def finish_trial(self) -> list[Rows]:
        """Return the present values for each alternative."""
        rows = self._rows()
        return [Rows(np.tile(rows.values, (n, 1)), np.tile(rows.effective, (n, 1))) for n in self._tried]

    def cancel_trial(self) -> None:
        """Do nothing: a market does not compute."""

    def check_copy(self) -> None:
        """Do nothing: a market is copied with the orchestration."""

    # Snapshots and branches: the values are part of the orchestration's state

    def snapshot(self) -> tuple[str, int]:
        """Return an empty name; -1: at any step."""
        return "", -1

    def drop(self, snapshot: str) -> None:
        """Do nothing."""

    def restore(self, snapshot: str) -> Rows:  # noqa: ARG002
        """Return the present values; those of the snapshot are in the orchestration's state."""
        return self._rows()

    def branch(self, snapshot: str) -> MarketPlant:  # noqa: ARG002
        """Return another market with these values."""
        other = MarketPlant(self.manifest, self.spec)
        other._row, other.limit_w = self._row.copy(), self.limit_w
        return other

    def is_reachable(self) -> bool:
        """Return True."""
        return True

    def drain_warnings(self) -> list[str]:
        """Return no texts."""
        return []

    def interrupt(self) -> None:
        """Do nothing: a market does not compute."""

    def close(self) -> None:
        """Do nothing."""


@dataclass(frozen=True, slots=True)
class Market:
    """A market with its points.

    Attributes:
        name: of the plant.
        spec: of it.
        plants: of the bidders.
        columns: of the bidders' demands among the values of their plants.
        to_w: factors from these values to W.
    """

    name: str
    spec: MarketSpec
    plants: tuple[str, ...]
    columns: tuple[int, ...]
    to_w: tuple[float, ...]

    def demands(self, values: Mapping[str, NDArray[Any]]) -> Floats:
        """Return the demand of each bidder in W, the mean over its timesteps."""
        return np.array([
            float(np.mean(values[plant][:, column])) * factor
            for plant, column, factor in zip(self.plants, self.columns, self.to_w, strict=True)
        ])  # fmt: skip
