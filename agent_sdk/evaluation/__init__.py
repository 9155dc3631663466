"""Evaluation: compare controllers on the same episodes, metrics of an episode, and probes of actuators."""

from zenostat.agent_sdk.evaluation.evaluate import Evaluation, evaluate, run_episode
from zenostat.agent_sdk.evaluation.metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.agent_sdk.evaluation.probe import ProbeReport, probe
from zenostat.agent_sdk.evaluation.trace import TraceRecorder

__all__ = [
    "EpisodeMetrics",
    "Evaluation",
    "MetricsAccumulator",
    "ProbeReport",
    "TraceRecorder",
    "evaluate",
    "probe",
    "run_episode",
]
