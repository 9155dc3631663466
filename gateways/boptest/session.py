"""A test: one building that one client advances, as BOPTEST's interface defines it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from math import inf, isfinite
from threading import RLock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.gateways.boptest import parsing
from zenostat.gateways.boptest.cases import TestCase
from zenostat.gateways.boptest.episodes import Beginning, Episodes
from zenostat.gateways.boptest.forecast import Forecaster
from zenostat.gateways.boptest.forecast_errors import LEVELS
from zenostat.gateways.boptest.kpis import TestKpis, TimeRatio
from zenostat.gateways.boptest.parsing import BadRequest, PeriodNotOver
from zenostat.gateways.boptest.prices import ELECTRICITY_PRICES, Rates
from zenostat.gateways.boptest.simulation import DAY_S, YEAR_S, Interruption, Simulation, row_range
from zenostat.gateways.boptest.test_periods import PERIOD_S, TIME_PERIODS, WARMUP_S
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import CommandOp

Payload = Any
Answer = tuple[str, Payload]
"""The message and the payload of an answer."""

DEFAULT_STEP_S = 3600.0
END_MESSAGE = "End of test case scenario time period reached."

_SET, _RELINQUISH = int(CommandOp.SET), int(CommandOp.RELINQUISH)
_CHOICES = {
    "electricity_price": (*ELECTRICITY_PRICES,),
    "time_period": TIME_PERIODS,
    "temperature_uncertainty": ("none", *LEVELS),
    "solar_uncertainty": ("none", *LEVELS),
}
_SCENARIO = (*_CHOICES, "seed")


class BuildingTest:
    """A running test.

    Args:
        case: the test case.
        rates: prices and emission factors.
        days: returns the days of the test periods; it may simulate a year.
        interruption: ends its node from another thread.
        client: name of the client that started it; empty if it has none.

    Attributes:
        client: as above.
        lock: held during each request.
    """

    def __init__(
        self,
        case: TestCase,
        rates: Rates,
        days: Callable[[], Mapping[str, int]],
        interruption: Interruption | None = None,
        client: str = "",
    ) -> None:
        self.case, self.client, self.lock, self._is_stopped = case, client, RLock(), False
        self._rates, self._days = rates, days
        self._branch: Simulation | None = None
        name = f"boptest.{client}" if client else "boptest"
        self.episodes = Episodes(case.arguments, interruption or Interruption(), name)
        self.table, self._timestep_s = self.episodes.table, self.episodes.building.step_s
        self.step_s = DEFAULT_STEP_S
        self.scenario: dict[str, Any] = {**dict.fromkeys(_SCENARIO), "electricity_price": "constant"}
        self._begin(0, 0)
        self._weather_points = {_weather_name(point): point for point in self.beginning.weather.points}
        self._state_names = self._points_of_state()

    def _points_of_state(self) -> tuple[str, ...]:
        """Return the names of a state in the order of its values; all of them can be requested as results."""
        table = self.table
        return ("time", *table.measured, *self._weather_points, *table.commanded, *table.activates)

    @property
    def simulation(self) -> Simulation:
        """The engine that is advanced: that of the node, or of a branch."""
        return self._branch or self.episodes.building.main

    @property
    def is_stopped(self) -> bool:
        """Whether it has ended, so that a request in progress ends; another thread may have ended it.

        A branch also ends with its node, which another beginning of the test that it came from replaces.
        """
        return self._is_stopped or (self._branch is not None and not self.episodes.keeps(self.beginning))

    # Beginning

    def _begin(self, start_s: int, warmup_s: int, end_s: float = inf) -> None:
        self.beginning: Beginning = self.episodes.begin(start_s, warmup_s, self._beginnings_in_use())
        self.recorder = self.beginning.recorder.copy()
        self.first_row = len(self.recorder) - 1
        self.end_s = end_s
        self.is_over = False
        self._restart_figures()

    def _beginnings_in_use(self) -> Collection[Beginning]:
        """Return the beginnings that can be needed after another one."""
        return ()

    def _restart_figures(self) -> None:
        """Draw new errors of forecasts, and compute KPIs and the time ratio from here on."""
        self.forecaster = Forecaster(self.beginning.weather, self._rates, self.episodes.schedules)
        self.time_ratio = TimeRatio()
        self._restart_kpis()

    def _restart_kpis(self) -> None:
        comfort = self.episodes.schedules.comfort(self.beginning.baseline)
        manifest, price = self.simulation.manifest, self.scenario["electricity_price"]
        self._kpis = TestKpis(manifest, comfort, self._rates, price, self.first_row)

    @property
    def time_s(self) -> int:
        """The current time."""
        return self._begin_s + (len(self.recorder) - 1) * self._timestep_s

    @property
    def _begin_s(self) -> int:
        return self.beginning.time_s - self.first_row * self._timestep_s

    @property
    def trajectory(self) -> Trajectory:
        """Samples of the warm-up and of the test so far; `orders` are the values that the client has sent."""
        return self.recorder.trajectory(min_steps=0)

    def state(self) -> dict[str, float]:
        """Return time, measurements, weather and inputs; NaN for what EnergyPlus does not report."""
        trajectory, time_s = self.trajectory, self.time_s
        values = [
            time_s,
            *self.table.si_values(trajectory.fault_free_values[-1]).tolist(),
            *self.beginning.weather.now(time_s).values(),
            *self.table.si_inputs(trajectory.effective[-1]).tolist(),
            *self._activated(-1).tolist(),
        ]
        return dict(zip(self._state_names, values, strict=True))

    def initialize(self, fields: Mapping[str, Any]) -> Answer:
        """Begin at the timestep nearest to a time, after a warm-up."""
        start_s = parsing.positive(parsing.require(fields, "start_time"), "start_time")
        warmup_s = parsing.positive(parsing.require(fields, "warmup_period"), "warmup_period")
        final = fields.get("final_time")
        final_s = inf if final is None else parsing.number(final, "final_time")
        if start_s >= YEAR_S:
            raise BadRequest(f"start_time {start_s} is not within the year: it must be less than {YEAR_S}.")
        if final_s < start_s:
            raise BadRequest(f"Invalid value {final_s} for final_time. Value must not be before start_time.")
        self._check_no_branch("be initialized; branch again instead")
        timestep_s = self._timestep_s
        start = min(round(start_s / timestep_s) * timestep_s, YEAR_S - timestep_s)
        warmup = round(min(warmup_s, start) / timestep_s) * timestep_s
        end_s = max(final_s // timestep_s * timestep_s, start) if isfinite(final_s) else final_s
        self._begin(start, warmup, end_s)
        text = f"Test simulation initialized successfully to {float(start)}s with warmup period of {warmup_s}s."
        times = {"start_time": (start_s, start), "warmup_period": (min(warmup_s, start), warmup)}
        return text + self._rounding({**times, "final_time": (final_s, end_s)}), self.state()

    def _rounding(self, times: Mapping[str, tuple[float, float]]) -> str:
        """Return the warnings of times that are used otherwise than sent."""
        reason = f"is not a multiple of the building's timestep of {self._timestep_s} s."
        return "".join(
            f" WARNING: {name} {sent_s} {reason}  Using {float(used_s)}. ;"
            for name, (sent_s, used_s) in times.items()
            if sent_s != used_s
        )

    def _check_no_branch(self, impossible: str) -> None:
        if self._branch is not None:
            raise BadRequest(f"This test is a branch of another one and cannot {impossible}.")

    # Steps

    def get_step(self) -> Answer:
        """Return the control step."""
        return "Queried the control step successfully.", self.step_s

    def set_step(self, fields: Mapping[str, Any]) -> Answer:
        """Set the control step."""
        self.step_s = parsing.positive(parsing.require(fields, "step"), "step")
        return "Control step set successfully.", {"step": self.step_s}

    def advance(self, fields: Mapping[str, Any]) -> Answer:
        """Simulate a control step with inputs; what is not activated follows the baseline control."""
        values, operations, activated, warnings = self._read_inputs(fields)
        begin_s = self.time_s
        if self.is_over or begin_s >= self.end_s or self.simulation.sample.truncated:
            self.is_over = True
            return END_MESSAGE, {}
        steps = self._steps(min(self.step_s, self.end_s - begin_s))
        self.time_ratio.begin_advance(self.step_s or self._timestep_s)
        simulation, orders = self.simulation, np.where(activated, values, np.nan)
        for step in range(steps):
            sample = simulation.step(values, operations) if step == 0 else simulation.step()
            self.recorder.add(sample, orders=orders)
            if sample.truncated or self.is_stopped:
                break
        self.time_ratio.end_advance()
        text = f"Advanced simulation successfully from {float(begin_s)}s to {float(self.time_s)}s."
        return (f"{text} {warnings}" if warnings else text), self.state()

    def overridden(self, fields: Mapping[str, Any]) -> list[str]:
        """Return the names on the bus of the actuators that inputs activate."""
        actuators, activated = self.simulation.manifest.actuators, self.table.activated
        return [
            actuators[activated[name]].name
            for name, value in fields.items()
            if name in activated and value is not None and parsing.switch(value, name)
        ]

    def _steps(self, duration_s: float) -> int:
        timestep_s = self._timestep_s
        if duration_s % timestep_s:
            raise BadRequest(
                f"The step of {self.step_s:g} s is not a multiple of the building's timestep of {timestep_s} s; "
                "set another one with /step."
            )
        return round(duration_s / timestep_s)

    def _read_inputs(self, fields: Mapping[str, Any]) -> tuple[Floats, bytes, NDArray[np.bool_], str]:
        """Return values, operations, switches, and warnings of values not used as sent, the newest first."""
        table, count = self.table, len(self.table.inputs)
        values, is_sent, switched = np.zeros(count), np.zeros(count, np.bool_), np.zeros(count, np.bool_)
        warnings = ""
        for name, value in fields.items():
            if name in table.commanded:
                if value is None:
                    continue
                index = table.commanded[name]
                number, warning = self._clipped(index, parsing.number(value, name))
                values[index], is_sent[index] = table.bus_input(index, number), True
                warnings = warning + warnings
            elif name in table.activated:
                switched[table.activated[name]] = value is not None and parsing.switch(value, name)
            else:
                raise BadRequest(f"Unexpected input variable: {name[:200]}.")
        for unused in np.flatnonzero(switched != is_sent).tolist():
            warnings = self._unused(unused, fields) + warnings
        active = switched & is_sent
        operations = np.where(active, _SET, _RELINQUISH).astype(np.uint8).tobytes()
        return values, operations, active, warnings

    def _unused(self, index: int, fields: Mapping[str, Any]) -> str:
        """Return the warning of a switch without a value, or of a value without its switch; empty for a switch of 0."""
        point, switch = self.table.inputs[index].name, self.table.activates[index]
        if fields.get(switch) is None:
            return f"WARNING: {point} has a value, and {switch} is not sent.  Using the baseline control. ;"
        if fields.get(point) is None:
            return f"WARNING: {switch} is 1, and {point} has no value.  Using the baseline control. ;"
        return ""

    def _clipped(self, index: int, value: float) -> tuple[float, str]:
        point = self.table.inputs[index]
        assert point.minimum is not None
        assert point.maximum is not None
        for limit, side, is_outside in (
            (point.maximum, "above maximum", value > point.maximum),
            (point.minimum, "below minimum", value < point.minimum),
        ):
            if is_outside:
                return limit, f"WARNING: value of {value} for {point.name} is {side} of {limit}.  Using {limit}. ;"
        return value, ""

    # Points

    def name(self) -> Answer:
        """Return the test case's name."""
        return "Name queried successfully.", {"name": self.case.name}

    def inputs(self) -> Answer:
        """Describe the inputs."""
        described: dict[str, Any] = {}
        for point, switch in zip(self.table.inputs, self.table.activates, strict=True):
            described[point.name] = point.as_json()
            text = f"Activation of {point.name}: 1 overrides the baseline control, 0 returns to it"
            described[switch] = {"Unit": None, "Description": text, "Minimum": None, "Maximum": None}
        return "Queried the inputs successfully.", described

    def measurements(self) -> Answer:
        """Describe the measurements."""
        described: dict[str, Any] = {point.name: point.as_json() for point in self.table.measurements}
        for name, (unit, text) in zip(self._weather_points, self.beginning.weather.points.values(), strict=True):
            described[name] = {
                "Unit": unit, "Description": text, "Minimum": None, "Maximum": None,
            }  # fmt: skip
        return "Queried the measurements successfully.", described

    def forecast_points(self) -> Answer:
        """Describe the forecast points."""
        points = self.forecaster.points.items()
        return "Queried the forecast points successfully.", {
            name: {"Unit": unit, "Description": text} for name, (unit, text) in points
        }

    # Data

    def results(self, fields: Mapping[str, Any]) -> Answer:
        """Return stored values of points in a range of times, inclusive."""
        names = parsing.names(parsing.require(fields, "point_names"), "point_names")
        start_s = parsing.number(parsing.require(fields, "start_time"), "start_time")
        final_s = parsing.number(parsing.require(fields, "final_time"), "final_time")
        if unknown := [name for name in names if name not in self._state_names]:
            raise parsing.unknown_names(unknown, "point_names")
        begin_s, timestep_s = self._begin_s, self._timestep_s
        first, after = row_range(start_s, final_s, begin_s, timestep_s, len(self.recorder))
        times = begin_s + timestep_s * np.arange(first, after)
        result: dict[str, list[Any]] = {"time": times.tolist()}
        for name in names:
            if name != "time":
                result[name] = self._column(name, first, after, times.astype(np.float64)).tolist()
        return "Queried results data successfully.", result

    def _column(self, name: str, first: int, after: int, times_s: Floats) -> NDArray[Any]:
        table, rows = self.table, slice(first, after)
        if (index := table.measured.get(name)) is not None:
            return table.si_values(self.trajectory.fault_free_values[rows])[:, index]
        if (index := table.commanded.get(name)) is not None:
            return table.si_inputs(self.trajectory.effective[rows])[:, index]
        if (index := table.activated.get(name)) is not None:
            return self._activated(rows)[:, index]
        return self.beginning.weather.at(self._weather_points[name], times_s)

    def _activated(self, rows: int | slice) -> NDArray[np.int_]:
        """Return which inputs the client had activated, 0 or 1, shape (rows, inputs)."""
        orders = self.trajectory.orders
        assert orders is not None
        return np.isfinite(orders[rows]).astype(int)

    def kpis(self) -> Answer:
        """Return the KPIs."""
        return "Queried KPIs successfully.", {
            **self._kpis.read(self.trajectory), "time_rat": self.time_ratio.result(),
        }  # fmt: skip

    def forecast(self, fields: Mapping[str, Any]) -> Answer:
        """Return forecasts."""
        names = parsing.names(parsing.require(fields, "point_names"), "point_names")
        horizon_s = parsing.positive(parsing.require(fields, "horizon"), "horizon")
        interval_s = parsing.positive(parsing.require(fields, "interval"), "interval", allow_zero=False)
        baseline = self.beginning.baseline
        result = self.forecaster.forecast(names, self.time_s, horizon_s, interval_s, self.scenario, baseline)
        return "Queried the forecast data successfully.", result

    # Scenario

    def get_scenario(self) -> Answer:
        """Return the scenario."""
        return "Queried the scenario successfully.", dict(self.scenario)

    def set_scenario(self, fields: Mapping[str, Any]) -> Answer:
        """Set the scenario; with a test period, begin there after its warm-up."""
        answer = {name: self._read_scenario(name, fields.get(name)) for name in _SCENARIO}
        price, period = answer["electricity_price"], answer["time_period"]
        start_s = None
        if period is not None:
            self._check_no_branch("begin a time period; branch again instead")
            start_s = self._day(period) * DAY_S - WARMUP_S
        kept = [name for name in ("electricity_price", "time_period") if answer[name] is None]
        self.scenario = {**answer, **{name: self.scenario[name] for name in kept}}
        self.forecaster.forget_errors()
        if start_s is not None:
            self._begin(start_s, WARMUP_S, start_s + PERIOD_S)
            answer["time_period"] = self.state()
        elif price is not None:
            self._restart_kpis()
        return "Test case scenario was set successfully.", answer

    @staticmethod
    def _read_scenario(name: str, value: Any) -> Any:
        if value is None:
            return None
        if name == "seed":
            return parsing.seed(value)
        return parsing.choice(value, name, _CHOICES[name])

    def _day(self, period: str) -> int:
        days = self._days()
        if period not in days:
            known = ", ".join(days)
            raise BadRequest(f"Invalid value {period!r} for time_period. This building has: {known}.")
        return days[period]

    def submit(self, fields: Mapping[str, Any]) -> Answer:
        """Return the record that BOPTEST's dashboard would get; there is none to which it could be sent."""
        tags = [name for name in fields if name.startswith("tag")]
        if not isinstance(fields.get("api_key"), str) or len(tags) > 10:
            raise BadRequest("Invalid api_key or tags: the key is a text, and there are at most 10 tags.")
        if not (self.is_over or self.time_s >= self.end_s):
            raise PeriodNotOver(
                "Results cannot be submitted before the end of the scenario's time period; advance to its end first."
            )
        if str(fields.get("unit_test", "")).lower() not in ("1", "true"):
            raise BadRequest("This service has no dashboard; with unit_test=True the record is returned.")
        record = {
            "results": [
                {
                    "buildingType": {"uid": self.case.name},
                    "controlStep": str(self.step_s),
                    "kpis": self.kpis()[1],
                    "scenario": dict(self.scenario),
                    "tags": [str(fields[name]) for name in tags],
                }
            ]
        }
        return "Results have been prepared.", {"dash_url": None, "payload": record}

    def interrupt(self) -> None:
        """Stop the test while a request is in progress, which then ends; `close` is still needed."""
        self._is_stopped = True
        if self._branch is None:
            self.episodes.interruption.interrupt()

    def close(self) -> None:
        """End the building, or the branch."""
        self._is_stopped = True
        if self._branch is not None:
            self._branch.close()
        else:
            self.episodes.close()


def _weather_name(point: str) -> str:
    """Return the name of the measurement of a weather point: `weaSta_reaWeaTDryBul_y`."""
    return f"weaSta_reaWea{point[0].upper()}{point[1:]}_y"
