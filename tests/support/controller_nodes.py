"""Manifests and tasks for tests of controllers."""

from typing import Any

from support.builders import actuator, manifest, sensor
from zenostat.topics.messages import Actuator, DiscreteAction, Manifest, Task

HEAT, COOL = actuator("heating_setpoint", 15.0, 22.5), actuator("cooling_setpoint", 22.5, 30.0)
ROOM = sensor("air", key="ROOM")
PEOPLE = sensor("people", "Zone People Occupant Count", "ROOM", "1")


def node(*actuators: Actuator, sensors: tuple[Any, ...] = (ROOM,), task: Task | None = None) -> Manifest:
    return manifest(sensors=sensors, actuators=actuators or (HEAT, COOL), task=task)


def single(name: str, low: float | None, high: float | None) -> Manifest:
    return node(actuator(name, low, high))


def discrete(*choices: DiscreteAction) -> Task:
    return Task(actions=node().task.actions, discrete_actions=choices)
