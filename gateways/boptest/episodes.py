"""Beginnings of tests: a building after its warm-up, kept as snapshots so that the next test begins in milliseconds."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from zenostat.bridge.client.sample import SampleView
from zenostat.gateways.boptest.baseline import Baseline, ZoneSchedules
from zenostat.gateways.boptest.points import PointTable
from zenostat.gateways.boptest.simulation import DAY_S, MAX_COPIES, Building, Interruption, Simulation
from zenostat.gateways.boptest.weather import COLUMNS, Weather
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics.errors import BusError, RequestRejected

_MAX_KEPT = 4


@dataclass(frozen=True, slots=True, eq=False)
class Beginning:
    """A test's first sample.

    Attributes:
        time_s: its time.
        snapshot: snapshot of it.
        recorder: the warm-up and this sample.
        sample: the sample.
        baseline: the building under the baseline control from it on.
        weather: weather of the node's run period.
    """

    time_s: int
    snapshot: str
    recorder: TrajectoryRecorder
    sample: SampleView
    baseline: Baseline
    weather: Weather


class Episodes:
    """The node of a test, and the beginnings that it can return to.

    Args:
        arguments: arguments of the scenario.
        interruption: ends the node from another thread.
        name: name of the node's controller.

    Attributes:
        table: the points.
        schedules: setpoints and occupants.
        building: the node.
        interruption: as above.
    """

    def __init__(self, arguments: Mapping[str, Any], interruption: Interruption, name: str = "boptest") -> None:
        self._arguments, self.interruption, self._name = arguments, interruption, name
        self._kept: dict[tuple[int, int], Beginning] = {}
        self.building = Building(arguments, interruption=interruption, name=name)
        try:
            manifest = self.building.main.manifest
            self.table = PointTable(manifest)
            self.schedules = ZoneSchedules(manifest)
            self._weather = _weather(self.building)
        except BaseException:
            self.building.close()
            raise

    def begin(self, start: int, warmup_s: int, in_use: Collection[Beginning] = ()) -> Beginning:
        """Return to the building at a time, after a warm-up under the baseline control.

        Args:
            start: the time within the year, a multiple of the timestep.
            warmup_s: length of the warm-up, likewise; it begins at time 0 at the earliest.
            in_use: beginnings that snapshots and branches refer to, which are kept besides the last four.
        """
        begin = max(start - warmup_s, 0)
        self._use_day(begin // DAY_S)
        key = (start, begin)
        if key in self._kept:
            beginning = self._kept[key] = self._kept.pop(key)
            self.building.main.reset(beginning.snapshot)
            return beginning
        others = [key for key, kept in self._kept.items() if kept not in in_use]
        for other in others[: max(len(others) - _MAX_KEPT + 1, 0)]:
            self._drop(other)
        beginning = self._kept[key] = self._simulate(start, begin)
        return beginning

    def keeps(self, beginning: Beginning) -> bool:
        """Return whether a beginning can be returned to; those of another node have ended with it."""
        return beginning in self._kept.values()

    def has_room(self, in_use: Sequence[Beginning]) -> bool:
        """Return whether the node can have snapshots and branches of these beginnings, one for each mention.

        The node also has a snapshot and, as soon as it is needed, a branch for the baseline of each beginning that is
        kept: those in use, and the last four others.
        """
        copies = sum(map(self.keeps, in_use))
        others = sum(beginning not in in_use for beginning in self._kept.values())
        return copies + 2 * (len(self._kept) - others + max(others, _MAX_KEPT)) <= MAX_COPIES

    def _use_day(self, first_day: int) -> None:
        """Start another node if the run period has to begin on another day, or the node has ended."""
        if first_day == self.building.first_day and not self.building.has_ended:
            return
        self._kept.clear()
        self.building.close()
        self.building = Building(self._arguments, first_day, interruption=self.interruption, name=self._name)
        self._weather = _weather(self.building)

    def _simulate(self, start: int, begin: int) -> Beginning:
        building, main = self.building, self.building.main
        main.reset()
        recorder, relinquished = TrajectoryRecorder(main.manifest), np.full(len(main.manifest.actuators), np.nan)
        skipped = (begin - building.begin_s) // building.step_s

        def add(sample: SampleView) -> None:
            if sample.step >= skipped:
                recorder.add(sample, orders=relinquished)

        add(main.sample)
        main.run_free((start - building.begin_s) // building.step_s, add)
        first, snapshot = main.sample, main.snapshot()
        create = _branch_of(main, snapshot)
        baseline = Baseline(create, first, start, building.step_s)
        return Beginning(start, snapshot, recorder, first, baseline, self._weather)

    def _drop(self, key: tuple[int, int]) -> None:
        dropped = self._kept.pop(key)
        with suppress(BusError, RequestRejected):
            dropped.baseline.close()
            self.building.main.bus.drop(self.building.main.node, dropped.snapshot)

    def close(self) -> None:
        """End the node."""
        self._kept.clear()
        self.building.close()


def _branch_of(main: Simulation, snapshot: str) -> Callable[[], Simulation]:
    return lambda: main.branch(snapshot=snapshot, relinquished=True)


def _weather(building: Building) -> Weather:
    main = building.main
    series = main.bus.weather(main.node, COLUMNS)
    rows = np.frombuffer(series.values, "<f8").reshape(-1, len(series.columns)).T
    site = main.bus.geometry(main.node)
    return Weather(
        building.begin_s,
        series.step_s,
        dict(zip(COLUMNS, rows, strict=True)),
        site.latitude_deg,
        site.longitude_deg,
        site.time_zone_h,
    )
