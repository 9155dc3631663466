"""The content of a report from recordings: the metrics that `evaluate` computes, from the recorded samples."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zenostat.agent_sdk.envs.arguments import FROM_SCENARIO
from zenostat.agent_sdk.envs.termination import TerminationLimits
from zenostat.agent_sdk.rewards import AnyReward, Reward, read_reward
from zenostat.agent_sdk.rewards.base import BoundReward
from zenostat.agent_sdk.rewards.reward_reader import CUSTOM
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.metrics.episode_weather import EpisodeWeather
from zenostat.metrics.fuel_rates import Rate, read_emissions, read_prices
from zenostat.metrics.recording.load import read_trajectories
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, InvalidRecording
from zenostat.topics.extras import requires_extra
from zenostat.topics.messages import Flag, Manifest
from zenostat.topics.printable import replace_controls
from zenostat.views.report.runs import Comparison, Run

if TYPE_CHECKING:
    from zenostat.bridge.recording.reader import RecordingReader

_BASELINE = "baseline"
"""Name of the run of a baseline that was simulated in parallel."""

_UNIQUE_NAME = re.compile(r"(.+)-\d+-\d+")
_ENVIRONMENT = "env"


def compare_recordings(
    paths: Sequence[str | Path],
    *,
    prices: Mapping[str, Rate] | None = None,
    emissions: Mapping[str, Rate] | None = None,
    reward: AnyReward | None = FROM_SCENARIO,
    command: str = "",
) -> Comparison:
    """Return the content of a report with a run for each recording, baseline control first.

    A run has the complete episodes of all slots; if there is none, those that were recorded in part. If
    none of them is under baseline control, the first baseline that a node simulated as well has a run too.

    Args:
        paths: of the recordings, of the same run period and timestep.
        prices: as for `zenostat.evaluation.evaluate`.
        emissions: as for `zenostat.evaluation.evaluate`.
        reward: the reward; by default the one that a recorded node's own environment paid, else that of the scenario.
            Code of the user's is not in a recording: without `reward` such a run has no reward.
        command: the command line that repeats the report.

    Raises:
        InvalidConfig: no recording, the same one twice, or different run periods; or the extra is not installed.
        InvalidRecording: a file is not a recording, or has no timestep.

    Warns:
        UserWarning: a recording ends early, has episodes that are not in the report, or was paid by code that is not
            in it.
    """
    with requires_extra("recording", "a recording", "mcap and zstandard"):
        from zenostat.bridge.recording.reader import RecordingReader
    files = [Path(path) for path in paths]
    if not files or len({file.resolve() for file in files}) < len(files):
        raise InvalidConfig(f"expected at least one recording, each of them once; got {', '.join(map(str, files))}")
    rates = read_prices(prices), read_emissions(emissions)
    results: list[_Result] = []
    scenario = ""
    for file in files:
        with RecordingReader(file) as reader:
            if results:
                _check_period(results[0], file, reader.manifest)
            results += _results(reader, reward, rates)
            scenario = reader.scenario if not scenario or results[-1].has_controller else scenario
    parallel = [result for result in results if result.is_parallel]
    results = [result for result in results if not result.is_parallel]
    if all(result.has_controller for result in results):
        results += parallel[:1]
    results.sort(key=lambda result: (result.has_controller, result.is_parallel))
    names = _names(results)
    sources: dict[str, str] = {}
    for result in results:
        sources = MetricsAccumulator(result.manifest, result.reward, *rates).sources | sources
    runs = tuple(result.run(name) for name, result in zip(names, results, strict=True))
    return Comparison(runs, scenario, command, sources=sources)


@dataclass(frozen=True, slots=True)
class _Episode:
    """An episode as a report lists it; `step` is the last one."""

    slot: int
    number: int
    first_step: int
    step: int
    is_complete: bool
    metrics: EpisodeMetrics
    seed: int | None
    weather_name: str
    weather: EpisodeWeather | None


class _Result:
    """The episodes of a recording, or of the baseline that its node simulated in parallel (`is_parallel`).

    Attributes:
        episodes: of all slots, in the order in which they ended.
        chosen: those to report: the complete ones; if there is none, those that were recorded in part.
        trajectory: the first one of these.
    """

    def __init__(self, path: Path, manifest: Manifest, reward: Reward | None, rates: Any, *, is_parallel: bool) -> None:
        self.path, self.manifest, self.reward, self.is_parallel = path, manifest, reward, is_parallel
        self._rates = rates
        self._bound: dict[int, BoundReward] = {}
        self.episodes: list[_Episode] = []
        self._trajectories: dict[bool, Trajectory] = {}

    def add(self, recorded: Trajectory) -> None:
        """Add an episode, up to the timestep at whose end a limit terminates it."""
        if not recorded.steps:
            return
        trajectory, terminated = _rewarded(recorded, self._begin_reward(recorded.slot))
        metrics = MetricsAccumulator(self.manifest, self.reward, *self._rates)
        assert trajectory.flags is not None
        first, last = int(trajectory.step[0]), int(trajectory.step[-1])
        is_complete = first == 0 and (terminated or bool(trajectory.flags[-1] & Flag.TRUNCATED))
        self.episodes.append(
            _Episode(
                recorded.slot, trajectory.number, first, last, is_complete,
                metrics.measure(trajectory, terminated=terminated), trajectory.seed,
                trajectory.weather or self.manifest.weather,
                trajectory.outdoor if first == 0 else None,
            )
        )  # fmt: skip
        self._trajectories.setdefault(is_complete, trajectory)

    def _begin_reward(self, slot: int) -> BoundReward | None:
        """Return the reward of a slot at the start of an episode; some keep a state from one to the next."""
        if self.reward is None:
            return None
        bound = self._bound[slot] = self._bound.get(slot) or self.reward.bind(self.manifest)
        bound.reset()
        return bound

    @property
    def chosen(self) -> list[_Episode]:
        has_complete = True in self._trajectories
        return [episode for episode in self.episodes if episode.is_complete or not has_complete]

    @property
    def trajectory(self) -> Trajectory:
        return self._trajectories[True in self._trajectories]

    @property
    def has_controller(self) -> bool:
        """Whether anything but baseline control has set a value."""
        return bool(self.trajectory.source_index.any())

    def check(self) -> None:
        """Raise `InvalidRecording` if there is no timestep; warn of episodes that are not complete."""
        if not self.episodes:
            raise InvalidRecording(f"{self.path} has no timestep; there is nothing to report")
        what = "is not in the report" if True in self._trajectories else "is reported in part"
        for episode in self.episodes:
            if not episode.is_complete and not self.is_parallel:
                slot = f" of slot {episode.slot}" if self.manifest.slots > 1 else ""
                warnings.warn(
                    f"{self.path}: episode {episode.number}{slot} {what}: it has steps {episode.first_step} to "
                    f"{episode.step} of {self.manifest.steps}",
                    stacklevel=4,
                )

    def run(self, name: str) -> Run:
        def label(source: str) -> str:
            match = _UNIQUE_NAME.fullmatch(source)
            plain = match[1] if match else source
            return name if match and plain == _ENVIRONMENT else plain

        chosen = self.chosen
        return Run(
            name, tuple(episode.metrics for episode in chosen),
            replace(self.trajectory, sources=tuple(map(label, self.trajectory.sources))),
            tuple(episode.seed for episode in chosen), tuple(episode.weather_name for episode in chosen),
            tuple(episode.weather for episode in chosen), self.reward,
        )  # fmt: skip


def _names(results: Sequence[_Result]) -> list[str]:
    """Name each run after its node; where nodes have the same name, after its file."""
    nodes = [result.manifest.node for result in results if not result.is_parallel]
    stems = [result.path.stem for result in results if not result.is_parallel]
    names = []
    for result in results:
        node, stem = result.manifest.node, result.path.stem
        name = node if nodes.count(node) == 1 else stem if stems.count(stem) == 1 else str(result.path)
        names.append(_BASELINE if result.is_parallel else replace_controls(name))
    return names


def _check_period(first: _Result, file: Path, manifest: Manifest) -> None:
    reference = first.manifest
    period, other = ((m.begin, m.end, m.step_s) for m in (reference, manifest))
    if period != other:
        texts = (f"{p} simulates {b} to {e} in steps of {s:g} s" for p, (b, e, s) in (
            (first.path, period), (file, other),
        ))  # fmt: skip
        raise InvalidConfig(f"{'; '.join(texts)}: a report compares recordings of the same run period and timestep")


def _rewarded(trajectory: Trajectory, bound: BoundReward | None) -> tuple[Trajectory, bool]:
    """Return an episode with the terms of a reward, and whether a limit terminated it, which is where it then ends."""
    manifest, values = trajectory.manifest, trajectory.fault_free_values
    limits = TerminationLimits(manifest) if manifest.task.terminate else None
    terms: dict[str, Floats] = {}
    row, terminated = 0, False
    for row, begin in enumerate(trajectory.begins(), 1):
        for name, term in ({} if bound is None else bound(values[row], begin).terms).items():
            terms.setdefault(name, np.full(trajectory.steps, np.nan))[row - 1] = term
        terminated = limits is not None and bool(limits.violated(values[row]))
        if terminated:
            break
    return replace(trajectory, terms=terms).between_steps(None, int(trajectory.step[row])), terminated


def _results(reader: RecordingReader, reward: AnyReward | None, rates: Any) -> list[_Result]:
    """Return what was recorded and, first, the baseline that was simulated in parallel."""
    manifest = reader.manifest
    bound = _recorded_reward(reader) if reward == FROM_SCENARIO else None if reward is None else read_reward(reward)
    parts = [True, False] if manifest.baseline else [False]
    results = [_Result(reader.path, manifest, bound, rates, is_parallel=is_parallel) for is_parallel in parts]
    for trajectory in read_trajectories(reader):
        for result in results:
            result.add(trajectory.under_baseline() if result.is_parallel else trajectory)
    if reader.end.text:
        warnings.warn(f"{reader.path}: {reader.end.text}", stacklevel=3)
    for result in results:
        result.check()
    return results


def _recorded_reward(reader: RecordingReader) -> Reward | None:
    data = reader.manifest.task.reward
    if data is not None and data.get("kind") == CUSTOM:
        warnings.warn(
            f"{reader.path}: its reward {data.get('name', '')} was code of the environment's program, which is not in "
            "the recording: the run is reported without a reward",
            stacklevel=4,
        )
        return None
    return None if data is None else read_reward(data)
