"""Measure the effect of each actuator of a scenario by holding it in branches of an episode."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, time, timedelta
from fnmatch import fnmatchcase
from math import ceil, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.agent_sdk.envs.arguments import of_scenario
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.bridge.client.controller_link import ControllerLink, open_link
from zenostat.bridge.client.sample import SampleView
from zenostat.lab.probe_effects import Effect, HoldExperiment, Ranges, Side, effect_of
from zenostat.topics.arrays import Floats
from zenostat.topics.calendar import format_duration
from zenostat.topics.errors import (
    BusError,
    ErrorCollector,
    InvalidConfig,
    RequestRejected,
    SimulatorError,
    did_you_mean,
)
from zenostat.topics.messages import Actuator, CreateBranch, Manifest
from zenostat.topics.points import PointIndex, actuator_index, contains, describe_bounds, value_index
from zenostat.topics.scenario_fields import NODE_ARGUMENTS

Progress = Callable[[int, int], None]
"""Callback for simulated timesteps: number done, total number."""

_OFFSET_K = 2.0
"""Below the usual deadband of 3 K: EnergyPlus stops if heating and cooling setpoints cross."""
_TEMPERATURES = ("C", "degC")
_MAX_THREADS = 8
_FRIDAY = 4
_PROGRESS_INTERVAL = 96


@dataclass(frozen=True, slots=True)
class ProbeReport:
    """Result of a probe.

    Attributes:
        manifest: manifest of the probed node.
        times: simulated times at which the branches started.
        hours: simulated hours of each branch.
        effects: effect of each actuator, in the manifest's order.
    """

    manifest: Manifest
    times: tuple[datetime, ...]
    hours: float
    effects: tuple[Effect, ...]


@dataclass(frozen=True, slots=True)
class _BranchResult:
    """Values of one branch; shorter, and with the error text, if EnergyPlus failed."""

    points: Floats
    effective: Floats
    failure: str


def probe(
    scenario: str | Path | Mapping[str, Any],
    *,
    hours: float = 3.0,
    days: int = 4,
    at: Sequence[float] = (7, 15),
    points: Sequence[str] = (),
    low: Mapping[str, float] | None = None,
    high: Mapping[str, float] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    **overrides: Any,
) -> ProbeReport:
    """Hold each actuator low and high for some hours, from several samples, and compare with baseline control.

    The building runs under baseline control. At each of the selected samples, branches start: a reference under
    baseline control, and for each actuator one branch that holds it low and one that holds it high, without any other
    command. So all differences from the reference are caused by the actuator.

    An actuator is held at its bounds. A temperature without a bound is held 2 K from its value at the sample; any
    other actuator without bounds needs `low` and `high`.

    Args:
        scenario: an id, a scenario file (.yaml), or arguments of `BuildingEnv` by name.
        hours: simulated hours of each branch.
        days: number of days on which branches start, spread evenly over the run period; a weekend is moved to the
            Monday after it.
        at: hours of the day at which branches start, from 0 to below 24.
        points: names of sensors and meters to compare, or patterns (`*temperature`); empty: all.
        low: by actuator, the value to use instead of its lower bound.
        high: by actuator, the value to use instead of its upper bound.
        seed: seed of the episode.
        progress: callback for simulated timesteps.
        overrides: arguments of `BuildingEnv` that override those of the scenario.

    Raises:
        UsageError: an argument is invalid; no branch was created.
        SimulatorError, BusError: the episode itself failed. A failure of EnergyPlus in a branch becomes a note.
    """
    settings = {**of_scenario(scenario), **overrides, "reward": None}  # a probe needs no reward
    if unknown := sorted(set(settings) - {*NODE_ARGUMENTS, "affinity", "reward"}):
        raise InvalidConfig(
            f"{', '.join(unknown)}: not an argument of a scenario; {did_you_mean(unknown[0], NODE_ARGUMENTS)}"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the notes of each effect contain them
        env = BuildingEnv(**settings)
    with closing(env):
        request = ProbeRequest(env.manifest, hours, days, at, points, low or {}, high or {})
        link = env.link
        assert isinstance(link, ControllerLink)
        with _BranchRunner(link, request.length) as branches:
            return _ProbeEpisode(request, branches, progress).run(link, seed)


class ProbeRequest:
    """Arguments of a probe, checked against the node.

    Attributes:
        steps: steps at which branches start.
        length: timesteps of each branch.
        compared: indices of the points to compare.
    """

    def __init__(
        self,
        manifest: Manifest,
        hours: float,
        days: int,
        at: Sequence[float],
        points: Sequence[str],
        low: Mapping[str, float],
        high: Mapping[str, float],
    ) -> None:
        self.manifest, self.hours, self._low, self._high = manifest, hours, low, high
        if not manifest.actuators:
            raise InvalidConfig("the scenario has no actuators to probe")
        errors = ErrorCollector()
        self.length = round(hours * 3600.0 / manifest.step_s) if isfinite(hours) else 0
        self.steps: list[int] = errors.collect(lambda: _steps(manifest, self.length, days, at)) or []
        self.compared = errors.collect(lambda: _matching(value_index(manifest), points)) or []
        known = actuator_index(manifest)
        for overrides in (low, high):
            errors.collect(lambda overrides=overrides: known.require(overrides))  # type: ignore[misc]
        for actuator in manifest.actuators:
            errors.collect(lambda actuator=actuator: self._check_bounds(actuator))  # type: ignore[misc]
        errors.raise_if_any()

    def _check_bounds(self, actuator: Actuator) -> None:
        low, high = self._bounds(actuator)
        has_offset = actuator.unit in _TEMPERATURES and actuator.feedback is not None
        missing = [side for side, bound in (("low", low), ("high", high)) if bound is None and not has_offset]
        if missing:
            unit = actuator.unit or "none"
            options = " and ".join(f"--{side} {actuator.name}=VALUE" for side in missing)
            raise InvalidConfig(f"{actuator.name} has no bound to hold it at (its unit: {unit}); add {options}")
        if low is not None and high is not None and low >= high:
            raise InvalidConfig(f"{actuator.name}: low {low:g} is not below high {high:g}")
        for side, value in (("low", low), ("high", high)):
            if value is not None and not contains(actuator, value):
                raise InvalidConfig(f"--{side} {actuator.name}={value:g}: its bounds are {describe_bounds(actuator)}")

    def _bounds(self, actuator: Actuator) -> tuple[float | None, float | None]:
        return self._low.get(actuator.name, actuator.low), self._high.get(actuator.name, actuator.high)

    def hold_values(self, actuator: Actuator, present: float) -> tuple[tuple[Side, float], tuple[Side, float]]:
        """Return the values to hold an actuator at, for a sample with the effective value `present`."""
        low, high = self._bounds(actuator)
        if (low is None or high is None) and not isfinite(present):
            options = f"--low {actuator.name}=VALUE and --high {actuator.name}=VALUE"
            raise InvalidConfig(f"{actuator.name}: EnergyPlus does not report its value; add {options}")
        low, high = present - _OFFSET_K if low is None else low, present + _OFFSET_K if high is None else high
        return ("low", low), ("high", high)


def _matching(index: PointIndex, patterns: Sequence[str]) -> list[int]:
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in index):
            raise index.unknown(pattern)
    return [i for name, i in index.items() if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)]


def _steps(manifest: Manifest, length: int, days: int, at: Sequence[float]) -> list[int]:
    """Return the steps at which branches start, in order: the given hours of days spread over the run period."""
    if length < 1 or days < 1 or not at or not all(0 <= hour < 24 for hour in at):
        raise InvalidConfig(
            f"expected at least one timestep ({format_duration(manifest.step_s)}), one day and one hour from 0 "
            f"to below 24, got {length} timesteps, days={days}, at={[*at]}"
        )
    begin, step = manifest.time_at(0), manifest.timestep
    period = ceil(manifest.steps * step / timedelta(days=1))
    candidates: set[int] = set()
    for number in range(days):
        # Starting at 1/6: four days of a year are then in the middle of January, April, July and October.
        day = int((number + 1 / 6) / days * period)
        midnight = datetime.combine(begin.date() + timedelta(days=day), time())
        if midnight.weekday() > _FRIDAY:
            monday = midnight + timedelta(days=7 - midnight.weekday())
            midnight = monday if (monday - begin) / step < manifest.steps else midnight
        candidates |= {round((midnight + timedelta(hours=hour) - begin) / step) for hour in at}
    steps = sorted(candidate for candidate in candidates if 0 <= candidate <= manifest.steps - length)
    if not steps:
        raise InvalidConfig(
            f"no branch of {length} timesteps at {[*at]} o'clock fits into the run period {manifest.begin} to "
            f"{manifest.end}"
        )
    return steps


class _BranchRunner:
    """Run branches in a few threads, each of which waits for its engine; a context manager."""

    def __init__(self, parent: ControllerLink, length: int) -> None:
        self._parent, self._length = parent, length
        self._stop = threading.Event()
        self._pool = ThreadPoolExecutor(min(os.cpu_count() or 1, _MAX_THREADS), thread_name_prefix="probe")

    def __enter__(self) -> _BranchRunner:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()  # running branches stop at their next sample
        self._pool.shutdown(cancel_futures=True)

    def run(self, sample: SampleView, holds: Sequence[Mapping[str, float]]) -> Iterator[_BranchResult]:
        """Run one branch for each set of held values, and yield the results in this order."""
        return self._pool.map(lambda hold: self._run(sample, hold), holds)

    def _run(self, sample: SampleView, hold: Mapping[str, float]) -> _BranchResult:
        manifest, failure = self._parent.manifest, ""
        points, effective = (
            np.empty((self._length, len(manifest.names))),
            np.empty((self._length, len(manifest.actuators))),
        )
        done = 0
        with self._branch(sample) as link:
            try:
                while done < self._length and not self._stop.is_set():
                    link.send(None if done else hold)
                    received = link.receive()
                    points[done], effective[done] = received.values, received.effective
                    done += 1
            except SimulatorError as error:
                failure = str(error)
        return _BranchResult(points[:done], effective[:done], failure)

    @contextmanager
    def _branch(self, sample: SampleView) -> Iterator[ControllerLink]:
        bus, parent = self._parent.bus, self._parent
        name = bus.branch(parent.manifest.node, CreateBranch(controller=parent.name))
        try:
            with open_link(bus, name, name="probe") as link:
                link.set_current(sample.message)
                yield link
        finally:
            with suppress(BusError, RequestRejected):  # it ended with its node
                bus.stop(name, instance=parent.manifest.instance)


class _ProbeEpisode:
    """One episode under baseline control, with the branches along it."""

    def __init__(self, request: ProbeRequest, branches: _BranchRunner, progress: Progress | None) -> None:
        self._request, self._branches, self._progress = request, branches, progress
        self._actuators = request.manifest.actuators
        self._ranges = Ranges(len(request.manifest.names))
        self._experiments: dict[str, list[HoldExperiment]] = {actuator.name: [] for actuator in self._actuators}
        self._done = 0
        branches_per_step = 1 + 2 * len(self._actuators)
        self._total = request.steps[-1] + len(request.steps) * branches_per_step * request.length

    def run(self, link: ControllerLink, seed: int) -> ProbeReport:
        """Run the episode from sample 0 to the last of the selected steps."""
        sample, times = link.reset(seed=seed), []
        for step in self._request.steps:
            sample = self._advance(link, sample, step)
            times.append(sample.time)
            self._probe_actuators(sample)
        request, spans = self._request, self._ranges.spans
        effects = [
            effect_of(request.manifest, a, self._experiments[a.name], request.compared, spans) for a in self._actuators
        ]
        return ProbeReport(request.manifest, tuple(times), request.hours, tuple(effects))

    def _advance(self, link: ControllerLink, sample: SampleView, step: int) -> SampleView:
        self._ranges.add(sample.values)
        while sample.step < step:
            link.send()
            sample = link.receive()
            self._ranges.add(sample.values)
            self._report(1, always=False)
        return sample

    def _probe_actuators(self, sample: SampleView) -> None:
        present = sample.effective.tolist()
        sides = [
            (index, side, value)
            for index, actuator in enumerate(self._actuators)
            for side, value in self._request.hold_values(actuator, present[index])
        ]
        holds: list[Mapping[str, float]] = [{}]
        holds += [{self._actuators[index].name: value} for index, _, value in sides]
        results = self._branches.run(sample, holds)
        reference = self._add(next(results))
        if reference.failure:
            raise SimulatorError(f"the reference branch from {sample.time} failed: {reference.failure}")
        for (index, side, value), result in zip(sides, results, strict=True):
            self._add(result)
            experiment = HoldExperiment(
                side, value, sample.time, result.points, reference.points, result.effective[:, index], result.failure
            )
            self._experiments[self._actuators[index].name].append(experiment)

    def _add(self, result: _BranchResult) -> _BranchResult:
        self._ranges.add(result.points)
        self._report(self._request.length, always=True)
        return result

    def _report(self, timesteps: int, *, always: bool) -> None:
        self._done += timesteps
        if self._progress is not None and (always or self._done % _PROGRESS_INTERVAL == 0):
            self._progress(self._done, self._total)
