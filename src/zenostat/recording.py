"""Recordings: as NumPy arrays by name, as tables, as a log of requests, and repeated on another node."""

from zenostat.lab.drive import DriveResult, drive
from zenostat.metrics.recording import Episode, LogEntry, Recording, load, write_csv, write_mcap, write_parquet

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
