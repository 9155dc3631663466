"""Evaluation: controllers on the same episodes, metrics of an episode, and probes of actuators."""

from zenostat.lab.evaluate import Evaluation, evaluate, run_episode
from zenostat.lab.probe import ProbeReport, probe
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder

__all__ = [
    "EpisodeMetrics",
    "Evaluation",
    "MetricsAccumulator",
    "ProbeReport",
    "Trajectory",
    "TrajectoryRecorder",
    "evaluate",
    "probe",
    "run_episode",
]
