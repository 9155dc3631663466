"""Samples of a controller on the bus, for the report of `zenostat run`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping

from zenostat import Bus, ControllerLink, SampleView
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.metrics.episode_weather import EpisodeWeather, query_weather
from zenostat.metrics.fuel_rates import Rate
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics.points import value_index
from zenostat.views.report import Comparison, Run


class RunTrace:
    """Samples of a controller on the bus, and of the baseline that the node runs beside it, for a report.

    Args:
        bus: the bus of the node.
        node: name of the node.
        title: name of the controller in the report.
        prices, emissions: as for `MetricsAccumulator`.
    """

    def __init__(
        self, bus: Bus, node: str, title: str, prices: Mapping[str, Rate] | None, emissions: Mapping[str, Rate] | None
    ) -> None:
        self._bus, self._node, self._title = bus, node, title
        self._manifest = bus.manifest(node)
        self._recorder = TrajectoryRecorder(self._manifest)
        self._baseline_metrics = MetricsAccumulator(self._manifest, None, prices, emissions)
        self._name = ""
        self._results: list[EpisodeMetrics] = []
        self._baseline_results: list[EpisodeMetrics] = []
        self._seeds: list[int | None] = []
        self._weathers: list[tuple[str, EpisodeWeather | None]] = []
        self._is_first = True

    def add(self, sample: SampleView) -> None:
        """Add a sample; the samples of the first episode are drawn."""
        if not self._results:
            self._recorder.add(sample)
        if self._manifest.baseline:
            view = _baseline_view(sample)
            if self._is_first:
                self._baseline_metrics.begin(view)
            else:
                self._baseline_metrics.add(view)
        self._is_first = False

    def end_episode(self, link: ControllerLink, result: EpisodeMetrics, seed: int | None) -> None:
        """End an episode that was started with a seed (None: joined, or the next of the sequence)."""
        self._name, self._is_first = link.name, True
        self._results.append(result)
        self._baseline_results.append(self._baseline_metrics.result())
        self._seeds.append(seed)
        starts = getattr(getattr(link, "accepted", None), "episode_starts", ())
        name = starts[0].weather if starts else self._manifest.weather
        self._weathers.append((name, query_weather(self._bus, self._manifest)))

    def comparison(self, command: str) -> Comparison:
        """Return the content of the report."""
        trajectory = self._recorder.trajectory({self._name: self._title})
        names, weathers = zip(*self._weathers, strict=True)
        runs = [Run(self._title, tuple(self._results), trajectory, tuple(self._seeds), names, weathers)]
        if self._manifest.baseline:
            results = tuple(self._baseline_results)
            baseline = Run("baseline", results, trajectory.under_baseline(), tuple(self._seeds), names, weathers)
            runs.insert(0, baseline)
        sources = self._baseline_metrics.sources
        options = " --baseline" if self._manifest.baseline else ""
        start = f"zenostat node --scenario scenario.yaml --name {shlex.quote(self._node)}{options}"
        text = f"{start}  # scenario.yaml: the text above\n{command}"
        return Comparison(tuple(runs), self._bus.scenario(self._node), text, sources=sources)


def _baseline_view(sample: SampleView) -> SampleView:
    """Return the sample of the building under baseline control."""
    message = sample.message
    baseline = message.model_copy(
        update={
            "values": message.baseline, "effective": message.baseline_effective, "fault_free_values": b"",
            "source_index": bytes(len(message.source_index)), "late": 0, "rejected": 0,
        }
    )  # fmt: skip
    return SampleView(baseline, sample.manifest, value_index(sample.manifest), slot=sample.slot)
