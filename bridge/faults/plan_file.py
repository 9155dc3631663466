"""Reading of fault plan files."""

from __future__ import annotations

from pathlib import Path

from zenostat.topics.fault_plan import FaultPlan


def read_plan(path: Path) -> FaultPlan:
    """Read a fault plan from a YAML file.

    Raises:
        InvalidConfig: the file cannot be read, or is not a valid plan; the text lists all errors.
    """
    from zenostat.topics import yaml12  # slow to import, and only files need it

    return yaml12.read_model(path, FaultPlan)
