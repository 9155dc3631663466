"""Point faults of a node with two rooms, and their plans."""

import math
from datetime import datetime
from typing import Any

from zenostat.bridge.faults import PointFaults
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import Actuator

BEGIN = datetime(2017, 7, 3)  # a Monday


STEP_S = 900


HOUR = 4


NAMES = ("room_temperature", "hall_temperature", "power")


NAN = math.nan


def actuator(name: str, low: float | None = 10.0, high: float | None = 30.0) -> Actuator:
    return Actuator(name=name, component_type="a", control_type="b", key="c", unit="degC", low=low, high=high)


ACTUATORS = (actuator("cooling"), actuator("heating"), actuator("damper", None, None))


def plan_of(*faults: dict[str, Any], seed: int = 1) -> FaultPlan:
    return FaultPlan.model_validate({"seed": seed, "faults": faults})


def point_faults(*faults: dict[str, Any], seed: int = 1, slots: int = 1, **arguments: Any) -> PointFaults:
    named: dict[str, Any] = {"points": NAMES, "actuators": ACTUATORS, "step_s": STEP_S, "begin": BEGIN} | arguments
    return PointFaults(plan_of(*faults, seed=seed), slots=slots, **named)


def room(kind: str, **arguments: Any) -> dict[str, Any]:
    return {"kind": kind, "points": "room_temperature", **arguments}
