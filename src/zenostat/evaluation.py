"""Evaluation: controllers on the same episodes, metrics of an episode, and probes of actuators."""

from zenostat.lab.evaluate import Evaluation, evaluate, run_episode
from zenostat.lab.probe import ProbeReport, probe
from zenostat.metrics.district_balance import (
    CarrierBalance,
    connection_balances,
    district_balances,
    plant_trajectory,
)
from zenostat.metrics.district_kpis import DistrictPoints, district_kpis, relative
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics.connection_balance import ConnectionBalance

__all__ = [
    "CarrierBalance",
    "ConnectionBalance",
    "DistrictPoints",
    "EpisodeMetrics",
    "Evaluation",
    "MetricsAccumulator",
    "ProbeReport",
    "Trajectory",
    "TrajectoryRecorder",
    "connection_balances",
    "district_balances",
    "district_kpis",
    "evaluate",
    "plant_trajectory",
    "probe",
    "relative",
    "run_episode",
]
