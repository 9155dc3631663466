"""What each actuator of a scenario does to the building, found by holding it in branches of the same steps."""

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
from math import ceil, inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent_sdk.bus.controller_link import ControllerLink
from agent_sdk.bus.sample import SampleView
from agent_sdk.envs.arguments import NODE_ARGUMENTS, of_scenario
from agent_sdk.envs.building_env import BuildingEnv
from agent_sdk.evaluation.probe_effects import Effect, HoldExperiment, Ranges, Side, effect_of
from topics.errors import BusError, ErrorCollector, InvalidConfig, SimulatorError, UnknownName, did_you_mean
from topics.messages import Actuator, CreateBranch, Manifest
from topics.units import with_unit

Progress = Callable[[int, int], None]
"""Told of simulated timesteps: how many are done, and how many there will be."""

_OFFSET_K = 2.0
"""Less than the 3 K that heating and cooling setpoints lie apart in most models: crossed ones end EnergyPlus."""
_TEMPERATURES = ("C", "degC")
_MOST_THREADS = 8
_FRIDAY = 4
_EVERY = 96


@dataclass(frozen=True, slots=True)
class ProbeReport:
    """What came of it.

    Attributes:
        manifest: of the node that was probed.
        times: where the branches began.
        hours: how long each was.
        effects: of each actuator, in the manifest's order.
    """

    manifest: Manifest
    times: tuple[datetime, ...]
    hours: float
    effects: tuple[Effect, ...]


@dataclass(frozen=True, slots=True)
class _Run:
    """What came of a branch; shorter, and with the reason, where EnergyPlus gave up."""

    points: NDArray[np.float64]
    effective: NDArray[np.float64]
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
    **given: Any,
) -> ProbeReport:
    """Holds each actuator low and high for some hours, from several steps, and compares with leaving all alone.

    The building runs under its own control. At each of the steps, branches go on from the same sample: one that is
    left alone, and for each actuator one that holds it low and one that holds it high, all others alone. What differs
    between them is the actuator's doing, and nothing else's.

    An actuator is held at its bounds. One without a bound whose unit is a temperature is held 2 K from what it was;
    any other needs `low` and `high`.

    Args:
        scenario: an id, a scenario file (.yaml), or arguments of `BuildingEnv` by name.
        hours: simulated, of each branch.
        days: how many of the run period branches begin on, spread evenly; the Monday after where it is a weekend.
        at: hours of the day at which they begin, 0 to below 24.
        points: names of the sensors and meters that are compared, or patterns (`*temperature`); empty: all.
        low: by actuator, what it is held at in place of its lower bound.
        high: the same of its upper bound.
        seed: of the episode.
        progress: told of the simulated timesteps.
        given: arguments of `BuildingEnv` that go before those of the scenario.

    Raises:
        UsageError: something that cannot be; no branch has been made then.
        SimulatorError, BusError: the episode itself failed. A branch that EnergyPlus gives up in is a note.
    """
    settings = {**of_scenario(scenario), **given, "reward": None}  # it decides nothing here
    if unknown := sorted(set(settings) - {*NODE_ARGUMENTS, "affinity", "reward"}):
        raise InvalidConfig(
            f"{', '.join(unknown)}: no settings of a scenario; {did_you_mean(unknown[0], NODE_ARGUMENTS)}"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the manifest has them; they stand with their actuator
        env = BuildingEnv(**settings)
    with closing(env):
        asked = ProbeRequest(env.manifest, hours, days, at, points, low or {}, high or {})
        link = env.link
        assert isinstance(link, ControllerLink)
        with _Branches(link, asked.length) as branches:
            return _Episode(asked, branches, progress).run(link, seed)


class ProbeRequest:
    """What was asked for, checked against the node.

    Attributes:
        steps: where branches begin.
        length: timesteps of each.
        compared: positions of the points that count.
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
            raise InvalidConfig("the scenario has no actuators; there is nothing to hold")
        faults = ErrorCollector()
        self.length = round(hours * manifest.steps_per_hour) if isfinite(hours) else 0
        self.steps: list[int] = faults.collect(lambda: _steps(manifest, self.length, days, at)) or []
        self.compared = faults.collect(lambda: _matching(manifest.names, points)) or []
        for said in (low, high):
            for name in said:
                faults.collect(lambda name=name: _known(name, manifest))  # type: ignore[misc]
        for actuator in manifest.actuators:
            faults.collect(lambda actuator=actuator: self._decidable(actuator))  # type: ignore[misc]
        faults.raise_if_any()

    def _decidable(self, actuator: Actuator) -> None:
        low, high = self._bounds(actuator)
        offset = actuator.unit in _TEMPERATURES and actuator.feedback is not None
        missing = [side for side, bound in (("low", low), ("high", high)) if bound is None and not offset]
        if missing:
            unit = actuator.unit or "none"
            ways = " and ".join(f"--{side} {actuator.name}=VALUE" for side in missing)
            raise InvalidConfig(f"{actuator.name} has no bound to be held at (its unit: {unit}); say {ways}")
        if low is not None and high is not None and low >= high:
            raise InvalidConfig(f"{actuator.name}: low {low:g} is not below high {high:g}")
        least = -inf if actuator.low is None else actuator.low
        most = inf if actuator.high is None else actuator.high
        for side, value in (("low", low), ("high", high)):
            if value is not None and not least <= value <= most:
                limits = with_unit(f"{least:g} to {most:g}", actuator.unit)
                raise InvalidConfig(f"--{side} {actuator.name}={value:g}: its bounds are {limits}")

    def _bounds(self, actuator: Actuator) -> tuple[float | None, float | None]:
        return self._low.get(actuator.name, actuator.low), self._high.get(actuator.name, actuator.high)

    def held_at(self, actuator: Actuator, was: float) -> tuple[tuple[Side, float], tuple[Side, float]]:
        """What it is held at from a sample at which it was `was`."""
        low, high = self._bounds(actuator)
        if (low is None or high is None) and not isfinite(was):
            ways = f"--low {actuator.name}=VALUE and --high {actuator.name}=VALUE"
            raise InvalidConfig(f"{actuator.name}: EnergyPlus does not tell what it is; say {ways}")
        low, high = was - _OFFSET_K if low is None else low, was + _OFFSET_K if high is None else high
        return ("low", low), ("high", high)


def _known(name: str, manifest: Manifest) -> None:
    names = [actuator.name for actuator in manifest.actuators]
    if name not in names:
        raise UnknownName(f"no actuator {name!r}; {did_you_mean(name, names)}")


def _matching(names: Sequence[str], patterns: Sequence[str]) -> list[int]:
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise UnknownName(f"no sensor or meter {pattern!r}; {did_you_mean(pattern, names)}")
    return [i for i, name in enumerate(names) if not patterns or any(fnmatchcase(name, one) for one in patterns)]


def _steps(manifest: Manifest, length: int, days: int, at: Sequence[float]) -> list[int]:
    """Samples at which branches begin, in order: at these hours of days that are spread over the run period."""
    if length < 1 or days < 1 or not at or not all(0 <= hour < 24 for hour in at):
        raise InvalidConfig(
            f"at least a timestep ({60 / manifest.steps_per_hour:g} minutes), a day and an hour from 0 to below 24 "
            f"expected, got {length} timesteps, days={days}, at={[*at]}"
        )
    begin, step = datetime.fromisoformat(manifest.begin), timedelta(hours=1 / manifest.steps_per_hour)
    period = ceil(manifest.steps * step / timedelta(days=1))
    found: set[int] = set()
    for number in range(days):
        # From a sixth on: of a year and four days, these are in the middle of January, April, July and October.
        day = int((number + 1 / 6) / days * period)
        midnight = datetime.combine(begin.date() + timedelta(days=day), time())
        if midnight.weekday() > _FRIDAY:
            monday = midnight + timedelta(days=7 - midnight.weekday())
            midnight = monday if (monday - begin) / step < manifest.steps else midnight
        found |= {round((midnight + timedelta(hours=hour) - begin) / step) for hour in at}
    kept = sorted(one for one in found if 0 <= one <= manifest.steps - length)
    if not kept:
        raise InvalidConfig(
            f"no branch of {length} timesteps at {[*at]} o'clock fits into the run period {manifest.begin} to "
            f"{manifest.end}"
        )
    return kept


class _Branches:
    """Makes branches in a few threads, each of which waits for its engine; use it with `with`."""

    def __init__(self, parent: ControllerLink, length: int) -> None:
        self._parent, self._length = parent, length
        self._stop = threading.Event()
        self._pool = ThreadPoolExecutor(min(os.cpu_count() or 1, _MOST_THREADS), thread_name_prefix="probe")

    def __enter__(self) -> _Branches:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()  # those that run end at their next sample
        self._pool.shutdown(cancel_futures=True)

    def run(self, sample: SampleView, holds: Sequence[Mapping[str, float]]) -> Iterator[_Run]:
        """A branch for each of what is held, in this order."""
        return self._pool.map(lambda hold: self._run(sample, hold), holds)

    def _run(self, sample: SampleView, hold: Mapping[str, float]) -> _Run:
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
                    came = link.receive()
                    points[done], effective[done] = came.values, came.effective
                    done += 1
            except SimulatorError as error:
                failure = str(error)
        return _Run(points[:done], effective[:done], failure)

    @contextmanager
    def _branch(self, sample: SampleView) -> Iterator[ControllerLink]:
        bus, parent = self._parent.bus, self._parent
        name = bus.branch(parent.manifest.node, CreateBranch(controller=parent.name))
        try:
            with bus.controller(name, name="probe") as link:
                link.set_current(sample.message)
                yield link
        finally:
            with suppress(BusError):  # it has ended with its node
                bus.stop(name)


class _Episode:
    """One episode under the building's own control, and the branches along it."""

    def __init__(self, asked: ProbeRequest, branches: _Branches, progress: Progress | None) -> None:
        self._asked, self._branches, self._progress = asked, branches, progress
        self._actuators = asked.manifest.actuators
        self._ranges = Ranges(len(asked.manifest.names))
        self._held: dict[str, list[HoldExperiment]] = {actuator.name: [] for actuator in self._actuators}
        self._done = 0
        self._total = asked.steps[-1] + len(asked.steps) * (1 + 2 * len(self._actuators)) * asked.length

    def run(self, link: ControllerLink, seed: int) -> ProbeReport:
        """From sample 0 to the last of the steps."""
        sample, times = link.reset(seed=seed), []
        for step in self._asked.steps:
            sample = self._go_on(link, sample, step)
            times.append(sample.time)
            self._hold_each(sample)
        asked, spans = self._asked, self._ranges.spans
        effects = [effect_of(asked.manifest, a, self._held[a.name], asked.compared, spans) for a in self._actuators]
        return ProbeReport(asked.manifest, tuple(times), asked.hours, tuple(effects))

    def _go_on(self, link: ControllerLink, sample: SampleView, step: int) -> SampleView:
        self._ranges.add(sample.values)
        while sample.step < step:
            link.send()
            sample = link.receive()
            self._ranges.add(sample.values)
            self._tell(1, always=False)
        return sample

    def _hold_each(self, sample: SampleView) -> None:
        was = sample.effective.tolist()
        sides = [
            (place, side, value)
            for place, actuator in enumerate(self._actuators)
            for side, value in self._asked.held_at(actuator, was[place])
        ]
        holds: list[Mapping[str, float]] = [{}]
        holds += [{self._actuators[place].name: value} for place, _, value in sides]
        runs = self._branches.run(sample, holds)
        alone = self._take(next(runs))
        if alone.failure:
            raise SimulatorError(f"a branch from {sample.time} that was left alone failed: {alone.failure}")
        for (place, side, value), run in zip(sides, runs, strict=True):
            self._take(run)
            held = HoldExperiment(
                side, value, sample.time, run.points, alone.points, run.effective[:, place], run.failure
            )
            self._held[self._actuators[place].name].append(held)

    def _take(self, run: _Run) -> _Run:
        self._ranges.add(run.points)
        self._tell(self._asked.length, always=True)
        return run

    def _tell(self, timesteps: int, *, always: bool) -> None:
        self._done += timesteps
        if self._progress is not None and (always or self._done % _EVERY == 0):
            self._progress(self._done, self._total)
