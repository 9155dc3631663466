"""KPIs of a test: those of `zenostat.metrics.kpis`, each sample added once, and the time ratio."""

from __future__ import annotations

from time import perf_counter

from zenostat.gateways.boptest.prices import Rates
from zenostat.metrics.comfort import Comfort
from zenostat.metrics.kpis import KPIS, KpiAccumulator
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.messages import Manifest


class TestKpis:
    """KPIs from the sample at which a test begins.

    Args:
        manifest: the building.
        comfort: comfort bands of its zones.
        rates: prices and emission factors.
        price_scenario: which price of electricity counts.
        first_row: row of the test's first sample in its trajectory.
    """

    __test__ = False  # for pytest, which takes it for a test

    def __init__(
        self, manifest: Manifest, comfort: Comfort | None, rates: Rates, price_scenario: str, first_row: int
    ) -> None:
        prices = rates.prices_of(price_scenario)
        self._sums = KpiAccumulator(manifest, comfort, prices, rates.emissions)
        self._row = first_row
        self._is_begun = False

    def read(self, trajectory: Trajectory, rows: int | None = None) -> dict[str, float | None]:
        """Return the KPIs up to the last sample, or of the first rows; only those since the previous call are added."""
        values, begin, timestep = trajectory.fault_free_values, trajectory.begin, trajectory.manifest.timestep
        rows = len(trajectory) if rows is None else rows
        if not self._is_begun:
            self._sums.begin(values[self._row].copy())
            self._is_begun = True
        for row in range(self._row + 1, rows):
            self._sums.add(values[row].copy(), begin + (row - 1) * timestep)
        self._row = max(self._row, rows - 1)
        return {name: value for name, value in self._sums.result().items() if name in KPIS}


class TimeRatio:
    """Mean share of the simulated time that a client takes between two advances."""

    def __init__(self) -> None:
        self._sum, self._count = 0.0, 0
        self._ended_s: float | None = None

    def begin_advance(self, step_s: float) -> None:
        """Count the time since the end of the previous advance."""
        if self._ended_s is not None:
            self._sum += (perf_counter() - self._ended_s) / step_s
            self._count += 1

    def end_advance(self) -> None:
        """Take the time at the end of an advance."""
        self._ended_s = perf_counter()

    def result(self) -> float | None:
        """Return the ratio; None before the second advance."""
        return self._sum / self._count if self._count else None
