"""A plant that does nothing, in the node's own process: what a step costs without a simulator.

`python -m bench.empty_plant` runs a node with it for another program; see `zenostat.bridge.node.program`. Its settings
are those of `NodeSettings`, and `steps`, the length of an episode. It is also the smallest complete implementation of
`zenostat.bridge.node.plant.Plant`: without engines, files and weather.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from datetime import datetime
from math import nan
from typing import Any

from zenostat.bridge.node.node import Node
from zenostat.bridge.node.plant import Plant, PlantContext, PlantDefaults, PlantDescription, RunPeriod
from zenostat.bridge.node.program import main
from zenostat.bridge.node.settings import NodeSettings
from zenostat.topics import VERSION
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Action, Actuator, EngineStart, EpisodeStart, Sensor, Task, Versions

BEGIN, STEP_S, STEPS = datetime(2001, 1, 1), 1.0, 1_000_000_000
LOW, HIGH = -1e9, 1e9


def describe(steps: int) -> PlantDescription:
    """Describe a plant with one sensor and one actuator."""
    actuator = Actuator(name="command", unit="1", low=LOW, high=HIGH)
    action = Action(name=actuator.name, unit="1", low=LOW, high=HIGH, actuators=(actuator.name,))
    return PlantDescription(
        name="empty",
        run_period=RunPeriod(BEGIN, STEP_S, steps),
        sensors=(Sensor(name="measured", unit="1"),),
        meters=(),
        actuators=(actuator,),
        versions=Versions(zenostat=VERSION),
        task=Task(scenario="empty", actions=(action,)),
    )


class EmptyPlant(PlantDefaults):
    """A plant whose sensor shows the latest command: 0.0 while there is none, and the seed at sample 0.

    Args:
        steps: timesteps of an episode.
        context: of the node.
    """

    simulators = 0

    def __init__(self, steps: int, context: PlantContext) -> None:
        if context.baseline:
            raise InvalidConfig("the empty plant has no baseline; leave out baseline")
        self.description = describe(steps)
        self._seeds, self._steps = [0] * context.slots, [0] * context.slots
        self._values, self._effective = array("d", [0.0] * context.slots), array("d", [nan] * context.slots)

    @property
    def effective(self) -> bytes:
        """The commands of the latest timestep."""
        return self._effective.tobytes()

    def next_episode(
        self, slots: Sequence[int], seeds: Sequence[int | None], episode: Sequence[int], untouched: Sequence[bool]
    ) -> list[EpisodeStart]:
        """Take over the seeds; None is the previous seed plus one."""
        for slot, seed in zip(slots, seeds, strict=True):
            self._seeds[slot] = self._seeds[slot] + 1 if seed is None else seed
        return [EpisodeStart(engine_start=EngineStart.RESET, weather="") for _ in slots]

    def start(self, slots: Sequence[int]) -> None:
        """Show the seeds."""
        for slot in slots:
            self._steps[slot], self._values[slot], self._effective[slot] = 0, float(self._seeds[slot]), nan

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:
        """Copy the commands to the sensors."""
        values = array("d", commands)
        for slot in active_slots:
            value = self._effective[slot] = values[slot]
            self._values[slot] = value if value == value else 0.0
            self._steps[slot] += 1
        return [self._steps[slot] >= self.description.run_period.steps for slot in active_slots]

    def values(self) -> bytes:
        """Return the sensors."""
        return self._values.tobytes()


def empty_node(settings: Mapping[str, Any], plant: type[EmptyPlant] = EmptyPlant) -> Node:
    """Return a node that is not started yet."""
    steps = settings.get("steps", STEPS)
    node_settings = NodeSettings.model_validate({name: value for name, value in settings.items() if name != "steps"})

    def create(context: PlantContext) -> Plant:
        return plant(steps, context)

    return Node(node_settings, lambda: create, program=True)


if __name__ == "__main__":
    main(empty_node)
