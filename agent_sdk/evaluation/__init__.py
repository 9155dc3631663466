"""Evaluation: compare controllers on the same episodes, metrics of an episode, and probes of actuators."""

from agent_sdk.evaluation.evaluate import Evaluation, evaluate, run_episode
from agent_sdk.evaluation.metrics import EpisodeMetrics, MetricsAccumulator
from agent_sdk.evaluation.probe import ProbeReport, probe

__all__ = ["EpisodeMetrics", "Evaluation", "MetricsAccumulator", "ProbeReport", "evaluate", "probe", "run_episode"]
