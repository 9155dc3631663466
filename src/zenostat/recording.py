"""Recordings: as NumPy arrays by name, as tables, as a log of requests, and repeated on another node."""

from zenostat.lab.drive import DriveResult, drive
from zenostat.metrics.recording import LogEntry, Recording, load, load_log, write_csv, write_mcap, write_parquet
from zenostat.metrics.trajectory import Trajectory

__all__ = [
    "DriveResult",
    "LogEntry",
    "Recording",
    "Trajectory",
    "drive",
    "load",
    "load_log",
    "write_csv",
    "write_mcap",
    "write_parquet",
]
