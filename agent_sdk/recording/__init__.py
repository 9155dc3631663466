"""Recordings as NumPy arrays by name, as tables, and as a log of what was requested.

recording = agent_sdk.recording.load("run.mcap")
recording.episodes[0]["core_zn_air_temperature"]
"""

from __future__ import annotations

from agent_sdk.recording.data import Episode, Recording
from agent_sdk.recording.export import write_csv, write_parquet
from agent_sdk.recording.load import load
from agent_sdk.recording.log import LogEntry

__all__ = ["Episode", "LogEntry", "Recording", "load", "write_csv", "write_parquet"]
