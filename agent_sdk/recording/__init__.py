"""Recordings as NumPy arrays by name, as tables, and as a log of what was requested.

recording = zenostat.recording.load("run.mcap")
recording.episodes[0]["core_zn_air_temperature"]
"""

from __future__ import annotations

from zenostat.agent_sdk.recording.data import Episode, Recording
from zenostat.agent_sdk.recording.drive import DriveResult, drive
from zenostat.agent_sdk.recording.export import write_csv, write_parquet
from zenostat.agent_sdk.recording.load import load
from zenostat.agent_sdk.recording.log import LogEntry
from zenostat.agent_sdk.recording.mcap_export import write_mcap

__all__ = [
    "DriveResult",
    "Episode",
    "LogEntry",
    "Recording",
    "drive",
    "load",
    "write_csv",
    "write_mcap",
    "write_parquet",
]
