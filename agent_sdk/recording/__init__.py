"""Recordings as NumPy arrays by name, as tables, and as a log of what was requested.

recording = agent_sdk.recording.load("run.mcap")
recording.episodes[0]["core_zn_air_temperature"]
"""

from __future__ import annotations

from agent_sdk.recording.data import Episode, Recording
from agent_sdk.recording.drive import DriveResult, drive
from agent_sdk.recording.export import write_csv, write_parquet
from agent_sdk.recording.load import load
from agent_sdk.recording.log import LogEntry
from agent_sdk.recording.mcap_export import write_mcap

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
