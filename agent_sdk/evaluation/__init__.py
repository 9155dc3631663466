"""Evaluation: controllers side by side on the same episodes, metrics, and probes of what actuators do."""

from agent_sdk.evaluation.evaluate import Evaluation, evaluate, run_episode
from agent_sdk.evaluation.metrics import EpisodeMetrics, MetricsAccumulator
from agent_sdk.evaluation.probe import ProbeReport, probe

__all__ = ["EpisodeMetrics", "Evaluation", "MetricsAccumulator", "ProbeReport", "evaluate", "probe", "run_episode"]
