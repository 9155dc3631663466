"""Episodes that rate the parameters of a controller, all in one environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym

from zenostat.agent_sdk.controllers import Agent, ControllerProtocol, make_controller
from zenostat.lab.evaluate import run_episode
from zenostat.lab.scenario_context import within_context
from zenostat.lab.scenario_env import pop_env_id
from zenostat.lab.tuning.trial import TrialReport, mean_metric
from zenostat.metrics.episode_metrics import EpisodeMetrics


class ControllerEpisodes:
    """An environment with an episode for each seed and weather, the same for each set of parameters.

    It stays open, so only the first episode of each weather waits for a building that starts. The order is that of the
    seeds, and within a seed that of the weathers: a reset with the seed, then resets that continue its sequence.

    Args:
        arguments: of `gym.make`; with the scenario's id as `scenario`, or its file as `file`.
        weathers: weather files; by default those of the scenario.
        seeds: seeds of the episodes.

    Raises:
        UsageError, SimulatorError: as of `BuildingEnv`.
    """

    def __init__(self, arguments: Mapping[str, Any], weathers: Sequence[str] = (), seeds: Sequence[int] = (0,)) -> None:
        settings = dict(arguments)
        if weathers:
            settings |= {"weather": list(weathers), "weather_order": "sequence"}
        building: Any = gym.make(pop_env_id(settings), **settings).unwrapped
        self._env = within_context(building)
        self._resets = [seed if number == 0 else None for seed in seeds for number in range(max(len(weathers), 1))]

    def value(
        self,
        factory: Callable[..., ControllerProtocol],
        parameters: Mapping[str, Any],
        metric: str,
        report: TrialReport | None = None,
    ) -> float:
        """Return the mean of a metric over all episodes of a new controller; report that of the episodes so far.

        Raises:
            Pruned: the pruner ends the trial.
            InvalidConfig: the controller does not fit, a parameter is invalid, or the episodes have no such metric.
        """
        building: Any = self._env.unwrapped
        building.renew_reward()
        agent = Agent(make_controller(factory, building.manifest, parameters), building)
        results: list[EpisodeMetrics] = []
        for number, seed in enumerate(self._resets, 1):
            result, _ = run_episode(self._env, lambda _: agent.action(building.sample), seed=seed)
            results.append(result)
            if report is not None:
                report.add(mean_metric(results, metric), number, is_last=number == len(self._resets))
        return mean_metric(results, metric)

    def close(self) -> None:
        """Close the environment."""
        self._env.close()
