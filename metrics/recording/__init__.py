"""Recordings as NumPy arrays by name, as tables, and as a log of what was requested.

recording = zenostat.recording.load("run.mcap")
recording.episodes[0]["core_zn_air_temperature"]
"""

from __future__ import annotations

from zenostat.metrics.recording.data import Recording
from zenostat.metrics.recording.export import write_csv, write_parquet
from zenostat.metrics.recording.load import load, load_log
from zenostat.metrics.recording.log import LogEntry
from zenostat.metrics.recording.mcap_export import write_mcap
from zenostat.metrics.trajectory import Trajectory

__all__ = ["LogEntry", "Recording", "Trajectory", "load", "load_log", "write_csv", "write_mcap", "write_parquet"]
