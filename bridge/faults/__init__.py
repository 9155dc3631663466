"""Injected faults, between a node and its bus. No I/O, except that `read_plan` reads a file."""

from bridge.faults.link_faults import LinkFaults
from bridge.faults.plan_file import read_plan
from bridge.faults.point_faults import PointFaults
from bridge.faults.schedule import FaultTransition, Transition

__all__ = ["FaultTransition", "LinkFaults", "PointFaults", "Transition", "read_plan"]
