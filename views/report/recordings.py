"""The content of a report from recordings: the metrics that `evaluate` computes, from the recorded samples."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zenostat.agent_sdk.envs.arguments import FROM_SCENARIO
from zenostat.agent_sdk.envs.termination import TerminationLimits
from zenostat.agent_sdk.rewards import AnyReward, Reward, read_reward
from zenostat.agent_sdk.rewards.read import CUSTOM
from zenostat.bridge.client.sample import SampleView
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.metrics.episode_weather import EpisodeWeather, read_weather
from zenostat.metrics.tariffs import Rate, read_emissions, read_prices
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics import codec
from zenostat.topics.errors import BadMessage, InvalidConfig, InvalidRecording
from zenostat.topics.extras import requires_extra
from zenostat.topics.messages import Manifest, Sample
from zenostat.topics.points import PointIndex, value_index
from zenostat.topics.recording import RecordedEpisode, RecordedWeather
from zenostat.views.report.runs import Comparison, Run

if TYPE_CHECKING:
    from zenostat.bridge.recording.reader import RecordingReader

_BASELINE = "baseline"
"""Name of the run of a baseline that was simulated in parallel."""

_SCHEMAS = frozenset(("Sample", "RecordedEpisode", "RecordedWeather"))
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

    A run has the complete episodes of all slots; if there is none, those that were recorded in part. A recording of a
    node that simulates its baseline as well, without another one under baseline control, has a run for each.

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
    if sum(not result.has_controller for result in results) > 1:
        results = [result for result in results if not result.is_parallel]
    results.sort(key=lambda result: (result.has_controller, result.is_parallel))
    names = _names(results)
    sources: dict[str, str] = {}
    for result in results:
        sources = MetricsAccumulator(result.trajectory.manifest, result.reward, *rates).sources | sources
    runs = tuple(result.run(name) for name, result in zip(names, results, strict=True))
    return Comparison(runs, scenario, command, sources=sources)


@dataclass(slots=True)
class _Result:
    """The episodes of a recording, or of the baseline that its node simulated in parallel (`is_parallel`)."""

    path: Path
    is_parallel: bool
    reward: Reward | None
    trajectory: Trajectory
    metrics: list[EpisodeMetrics] = field(default_factory=list)
    seeds: list[int | None] = field(default_factory=list)
    weather_names: list[str] = field(default_factory=list)
    weathers: list[EpisodeWeather | None] = field(default_factory=list)

    @property
    def has_controller(self) -> bool:
        """Whether anything but baseline control has set a value."""
        return bool(self.trajectory.source_index.any())

    def run(self, name: str) -> Run:
        def label(source: str) -> str:
            match = _UNIQUE_NAME.fullmatch(source)
            plain = match[1] if match else source
            return name if match and plain == _ENVIRONMENT else plain

        trajectory = replace(self.trajectory, sources=tuple(map(label, self.trajectory.sources)))
        return Run(
            name, tuple(self.metrics), trajectory, tuple(self.seeds), tuple(self.weather_names), tuple(self.weathers),
            self.reward,
        )  # fmt: skip


def _names(results: Sequence[_Result]) -> list[str]:
    """Name each run after its node; where nodes have the same name, after its file."""
    nodes = [result.trajectory.manifest.node for result in results if not result.is_parallel]
    stems = [result.path.stem for result in results if not result.is_parallel]
    names = []
    for result in results:
        node, stem = result.trajectory.manifest.node, result.path.stem
        name = node if nodes.count(node) == 1 else stem if stems.count(stem) == 1 else str(result.path)
        names.append(_BASELINE if result.is_parallel else name)
    return names


def _check_period(first: _Result, file: Path, manifest: Manifest) -> None:
    reference = first.trajectory.manifest
    period, other = ((m.begin, m.end, m.step_s) for m in (reference, manifest))
    if period != other:
        texts = (f"{p} simulates {b} to {e} in steps of {s:g} s" for p, (b, e, s) in (
            (first.path, period), (file, other),
        ))  # fmt: skip
        raise InvalidConfig(f"{'; '.join(texts)}: a report compares recordings of the same run period and timestep")


class _Episode:
    """Metrics and trajectory of an episode in one slot, from its samples.

    Args:
        first: its first sample.
        reward: of the scenario, or of the caller.
        rates: prices and emission factors.
    """

    def __init__(self, first: SampleView, reward: Reward | None, rates: Any) -> None:
        manifest = first.manifest
        self.number, self.slot, self.first_step, self.step = first.episode, first.slot, first.step, first.step
        self._metrics, self._recorder = MetricsAccumulator(manifest, reward, *rates), TrajectoryRecorder(manifest)
        self._reward = None if reward is None else reward.bind(manifest)
        self._limits = TerminationLimits(manifest) if manifest.task.terminate else None
        self._timestep = manifest.timestep
        self.terminated = self.truncated = False
        self._metrics.begin(first)
        self._recorder.add(first)

    @property
    def is_complete(self) -> bool:
        return self.first_step == 0 and (self.truncated or self.terminated)

    def add(self, sample: SampleView) -> None:
        if self.terminated:
            return  # the environment's episode has ended
        self.step, values = sample.step, sample.fault_free_values
        terms = None if self._reward is None else self._reward(values, sample.time - self._timestep).terms
        self._metrics.add(sample, terms)
        self._recorder.add(sample, terms)
        self.terminated = self._limits is not None and bool(self._limits.violated(values))
        self.truncated = sample.truncated

    def metrics(self) -> EpisodeMetrics:
        return self._metrics.result(terminated=self.terminated)

    def trajectory(self) -> Trajectory:
        return self._recorder.trajectory()


class _Episodes:
    """Divides samples into the episodes of each slot; keeps the trajectory of the first complete one."""

    def __init__(self, reward: Reward | None, rates: Any) -> None:
        self._reward, self._rates = reward, rates
        self._running: dict[int, _Episode] = {}
        self.ended: list[tuple[_Episode, EpisodeMetrics]] = []
        self._traces: dict[bool, Trajectory] = {}

    def add(self, sample: SampleView) -> None:
        running = self._running.get(sample.slot)
        if running is None or sample.episode != running.number:
            self._end(running)
            self._running[sample.slot] = _Episode(sample, self._reward, self._rates)
        elif sample.step > running.step:  # samples are repeated while other slots step
            running.add(sample)

    def _end(self, episode: _Episode | None) -> None:
        if episode is not None and episode.step > episode.first_step:
            self.ended.append((episode, episode.metrics()))
            if episode.is_complete not in self._traces:
                self._traces[episode.is_complete] = episode.trajectory()

    def finish(self) -> tuple[list[tuple[_Episode, EpisodeMetrics]], Trajectory | None, list[_Episode]]:
        """Return the episodes to report, in order, the trajectory of the first, and the episodes that are left out."""
        for episode in self._running.values():
            self._end(episode)
        self._running.clear()
        has_complete = True in self._traces
        chosen = [entry for entry in self.ended if entry[0].is_complete or not has_complete]
        left_out = [episode for episode, _ in self.ended if not episode.is_complete and has_complete]
        return chosen, self._traces.get(has_complete), left_out


def _results(reader: RecordingReader, reward: AnyReward | None, rates: Any) -> list[_Result]:
    """Return what was recorded and, first, the baseline that was simulated in parallel."""
    manifest, index = reader.manifest, value_index(reader.manifest)
    bound = _recorded_reward(reader) if reward == FROM_SCENARIO else None if reward is None else read_reward(reward)
    recorded = _Episodes(bound, rates)
    baseline = _Episodes(bound, rates) if manifest.baseline else None
    starts: dict[tuple[int, int], tuple[int | None, str]] = {}
    weathers: dict[tuple[int, int], EpisodeWeather] = {}
    span = manifest.steps * manifest.timestep
    for item in reader.messages(_SCHEMAS):
        try:
            if item.schema == "Sample":
                sample = codec.decode(Sample, item.payload)
                _add(recorded, sample, manifest, index)
                if baseline is not None:
                    _add(baseline, _under_baseline(sample), manifest, index)
            elif item.schema == "RecordedEpisode":
                record = codec.decode(RecordedEpisode, item.payload)
                for slot, number, seed, name in zip(
                    record.slots, record.episode, record.seeds, record.weather, strict=True
                ):
                    starts[number, slot] = seed, name
            else:
                weather = codec.decode(RecordedWeather, item.payload)
                weathers[weather.episode, weather.slot] = read_weather(weather, span)
        except BadMessage as error:
            raise InvalidRecording(f"{reader.path} is damaged: {item.topic}: {error}") from None
    if reader.end.text:
        warnings.warn(f"{reader.path}: {reader.end.text}", stacklevel=3)
    parts = ([(baseline, True)] if baseline is not None else []) + [(recorded, False)]
    return [_result(reader, episodes, bound, starts, weathers, is_parallel=flag) for episodes, flag in parts]


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


def _add(episodes: _Episodes, sample: Sample, manifest: Manifest, index: PointIndex) -> None:
    for slot in range(manifest.slots):
        episodes.add(SampleView(sample, manifest, index, slot=slot))


def _under_baseline(sample: Sample) -> Sample:
    return sample.model_copy(
        update={
            "values": sample.baseline,
            "fault_free_values": b"",
            "effective": sample.baseline_effective,
            "source_index": bytes(len(sample.source_index)),
            "late": 0,
            "rejected": 0,
        }
    )


def _result(
    reader: RecordingReader,
    episodes: _Episodes,
    reward: Reward | None,
    starts: Mapping[tuple[int, int], tuple[int | None, str]],
    weathers: Mapping[tuple[int, int], EpisodeWeather],
    *,
    is_parallel: bool,
) -> _Result:
    chosen, trajectory, left_out = episodes.finish()
    if trajectory is None:
        raise InvalidRecording(f"{reader.path} has no timestep; there is nothing to report")
    if not is_parallel:
        for episode in left_out or [entry[0] for entry in chosen if not entry[0].is_complete]:
            what = "is not in the report" if left_out else "is reported in part"
            warnings.warn(
                f"{reader.path}: episode {episode.number} {what}: it has steps {episode.first_step} to {episode.step} "
                f"of {reader.manifest.steps}",
                stacklevel=4,
            )
    result = _Result(reader.path, is_parallel, reward, trajectory)
    for episode, metrics in chosen:
        seed, name = starts.get((episode.number, episode.slot), (None, reader.manifest.weather))
        result.metrics.append(metrics)
        result.seeds.append(seed)
        result.weather_names.append(name)
        weather = weathers.get((episode.number, episode.slot))
        result.weathers.append(weather if episode.first_step == 0 else None)
    return result
