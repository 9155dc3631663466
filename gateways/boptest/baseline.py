"""Twin of the building under the baseline control, simulated ahead of a test.

It is a branch from the sample at which a test begins. It provides the setpoints and occupants of the coming hours,
which are the test's comfort band and its forecasts, and the values beside which a controller is compared.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from threading import Lock

import numpy as np

from zenostat.bridge.client.sample import SampleView
from zenostat.gateways.boptest.points import KELVIN
from zenostat.gateways.boptest.simulation import DAY_S, YEAR, Simulation, wrapped
from zenostat.metrics.comfort import DEFAULT_BAND_DEGC, Comfort
from zenostat.metrics.kpis import CO2_LIMIT_PPM
from zenostat.metrics.roles import ZoneRoles, roles
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Manifest

_ZONE_CO2 = "zone air co2 concentration"


class Baseline:
    """Samples under the baseline control from the beginning of a test on; the simulation begins when one is needed.

    Args:
        create: returns a simulation that is at the first sample, relinquished.
        first: first sample of the test.
        begin_s: its time.
        step_s: timestep.
    """

    def __init__(self, create: Callable[[], Simulation], first: SampleView, begin_s: int, step_s: int) -> None:
        self._create, self._lock = create, Lock()
        self._simulation: Simulation | None = None
        self.begin_s, self.step_s = begin_s, step_s
        self._recorder = TrajectoryRecorder(first.manifest)
        self._recorder.add(first)
        self._trajectory = self._recorder.trajectory(min_steps=0)
        self._per_day = DAY_S // step_s
        self._last_row = first.manifest.steps - first.step

    @property
    def trajectory(self) -> Trajectory:
        """Samples so far; KPIs ask for it in each timestep, so it is kept until there are more."""
        if len(self._trajectory) < len(self._recorder):
            self._trajectory = self._recorder.trajectory(min_steps=0)
        return self._trajectory

    def reach(self, row: int) -> int:
        """Simulate until a row exists, at least a day at a time; return that row, or the last one of the run period."""
        row = min(row, self._last_row)
        if row < len(self._recorder):
            return row
        with self._lock:  # a test and its branches share a baseline
            missing = row + 1 - len(self._recorder)
            if missing > 0:
                if self._simulation is None:
                    self._simulation = self._create()
                steps = min(max(missing, self._per_day), self._last_row + 1 - len(self._recorder))
                self._simulation.run_free(steps, self._recorder.add)
        return row

    def close(self) -> None:
        """End its simulation."""
        if self._simulation is not None:
            self._simulation.close()


class ZoneSchedules:
    """Setpoints, occupants and CO2 limits of zones, from a baseline.

    Attributes:
        points: forecast points by name: unit and description.
    """

    def __init__(self, manifest: Manifest) -> None:
        all_zones = [zone for zone in roles(manifest).zones if zone.temperature is not None]
        controlled = [z for z in all_zones if z.heating_setpoint is not None or z.cooling_setpoint is not None]
        self._zones = controlled or all_zones
        self.points: dict[str, tuple[str, str]] = {}
        self._columns: dict[str, tuple[int | None, float, float]] = {}
        for zone in all_zones:
            self._add_zone(zone, is_rated=zone in self._zones)
        for sensor in manifest.sensors:
            if sensor.variable.casefold() == _ZONE_CO2:
                name = f"UpperCO2[{_slug(sensor.key)}]"
                self._add_point(name, "ppm", f"Upper CO2 limit, {sensor.key}", None, 1.0, CO2_LIMIT_PPM)
        self._low = [z.heating_setpoint for z in self._zones]
        self._high = [z.cooling_setpoint for z in self._zones]
        self._follows = bool(controlled)

    def _add_zone(self, zone: ZoneRoles, *, is_rated: bool) -> None:
        slug = _slug(zone.key)
        low, high = (degc + KELVIN for degc in DEFAULT_BAND_DEGC)
        if is_rated:
            unrated = zone.heating_setpoint is None and zone.cooling_setpoint is None
            if zone.heating_setpoint is not None or unrated:
                offset = low if unrated else KELVIN
                self._add_point(
                    f"LowerSetp[{slug}]", "K", f"Lower limit of comfort, {zone.key}", zone.heating_setpoint, 1.0, offset
                )
            if zone.cooling_setpoint is not None or unrated:
                offset = high if unrated else KELVIN
                self._add_point(
                    f"UpperSetp[{slug}]", "K", f"Upper limit of comfort, {zone.key}", zone.cooling_setpoint, 1.0, offset
                )
        if zone.occupants is not None:
            self._add_point(f"Occupancy[{slug}]", "1", f"Number of occupants, {zone.key}", zone.occupants, 1.0, 0.0)

    def _add_point(self, name: str, unit: str, text: str, column: int | None, factor: float, offset: float) -> None:
        self.points[name] = (unit, text)
        self._columns[name] = (column, factor, offset)

    def at(self, name: str, baseline: Baseline, times_s: Floats) -> Floats:
        """Return a point at some times: its value in the timestep that begins then, or that contains the time.

        After the run period, it is that of a year ago.
        """
        column, factor, offset = self._columns[name]
        if column is None:
            return np.full(len(times_s), offset)
        rows = ((wrapped(times_s) - baseline.begin_s) // baseline.step_s).astype(np.intp) + 1
        last = baseline.reach(int(rows.max()))
        values: Floats = baseline.trajectory.fault_free_values[np.minimum(rows, last), column] * factor + offset
        return values

    def comfort(self, baseline: Baseline) -> Comfort | None:
        """Return the comfort bands of all zones with a thermostat: their setpoints under the baseline control."""
        if not self._zones:
            return None
        limits = (-np.inf, np.inf)
        columns = [
            (np.array([column or 0 for column in side], np.intp), np.array([column is None for column in side]), limit)
            for side, limit in zip((self._low, self._high), limits, strict=True)
        ]

        def band(_: Floats, begin: object) -> tuple[Floats, Floats]:
            elapsed_s = (begin - YEAR).total_seconds() - baseline.begin_s  # type: ignore[operator]
            row = baseline.reach(round(elapsed_s / baseline.step_s) + 1)
            values = baseline.trajectory.fault_free_values[row]
            low, high = (np.where(missing, limit, values[index]) for index, missing, limit in columns)
            return low, high

        air = [zone.temperature or 0 for zone in self._zones]
        people = [zone.occupants for zone in self._zones]
        if not self._follows:
            return Comfort("the default band", air, people, lambda *_: DEFAULT_BAND_DEGC)
        return Comfort("setpoints of the baseline control", air, people, band, follows_setpoints=True)


def _slug(zone: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", zone.lower()).strip("_")
