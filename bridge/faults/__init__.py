"""Faults on purpose, between a node and its bus. Rules without I/O; only `read_plan` reads a file."""

from bridge.faults.files import read_plan
from bridge.faults.link import LinkFaults
from bridge.faults.points import PointFaults
from bridge.faults.windows import Told, Turn

__all__ = ["LinkFaults", "PointFaults", "Told", "Turn", "read_plan"]
