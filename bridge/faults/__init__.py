"""Injected faults, between a node and its bus. No I/O, except that `read_plan` reads a file."""

from zenostat.bridge.faults.link_faults import LinkFaults
from zenostat.bridge.faults.plan_file import read_plan
from zenostat.bridge.faults.point_faults import PointFaults
from zenostat.bridge.faults.schedule import FaultTransition, Transition

__all__ = ["FaultTransition", "LinkFaults", "PointFaults", "Transition", "read_plan"]
