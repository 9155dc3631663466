"""A node whose plant computes in the node's own process and can be copied: rooms with two actuators and a memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from bench.empty_plant import EmptyPlant, describe
from zenostat.bridge.node.node import Node
from zenostat.bridge.node.plant import Plant, PlantContext, RunningPlant, RunPeriod, SlotPlacement
from zenostat.bridge.node.program import main
from zenostat.bridge.node.settings import NodeSettings
from zenostat.topics.errors import PlantFailed
from zenostat.topics.messages import Action, Actuator, EngineStart, EpisodeStart, Sensor

FATAL = 13.0
ACTUATORS = tuple(Actuator(name=name, unit="W", low=-100.0, high=100.0) for name in ("heater", "fan"))
ACTIONS = tuple(Action(name=a.name, unit="W", low=a.low, high=a.high, actuators=(a.name,)) for a in ACTUATORS)


class Rooms(EmptyPlant):
    """x' = 0.9 x + heater - 0.5 fan + r, with r from the seed; both actuators relinquished: 1. Fails at one value."""

    def __init__(self, steps: int, context: PlantContext) -> None:
        super().__init__(steps, context)
        description = describe(steps)
        self.description = replace(
            description,
            name="rooms",
            run_period=RunPeriod(datetime(2001, 1, 1), 60.0, steps),
            sensors=(Sensor(name="temperature", unit="degC"), Sensor(name="flow", unit="kg/s")),
            actuators=ACTUATORS,
            task=description.task.model_copy(update={"actions": ACTIONS}),
        )
        self._state = np.zeros((context.slots, 2))
        self._acted = np.full((context.slots, 2), nan)

    @property
    def effective(self) -> bytes:
        return self._acted.tobytes()

    def start(self, slots: Sequence[int]) -> None:
        super().start(slots)
        for slot in slots:
            self._state[slot], self._acted[slot] = (float(self._seeds[slot] % 1000), 0.0), nan

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:
        rows = np.frombuffer(commands).reshape(-1, 2)
        for slot in active_slots:
            heater, fan = np.where(np.isnan(rows[slot]), 1.0, rows[slot])
            if heater == FATAL:
                raise PlantFailed(f"the heater broke at {FATAL:g} W")
            self._steps[slot] += 1
            noise = float(np.random.default_rng([self._seeds[slot], self._steps[slot]]).normal())
            self._state[slot] = 0.9 * self._state[slot, 0] + heater - 0.5 * fan + noise, fan / 3.0
            self._acted[slot] = rows[slot]
        return [self._steps[slot] >= self.description.run_period.steps for slot in active_slots]

    def values(self) -> bytes:
        return self._state.tobytes()

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> Rooms:
        copy = Rooms(self.description.run_period.steps, PlantContext(folder, (SlotPlacement(),) * len(slots)))
        copy._take(self, slots)
        return copy

    def restore(self, saved: RunningPlant, episode: Sequence[int]) -> list[EpisodeStart]:
        assert isinstance(saved, Rooms)
        self._take(saved, range(len(self._steps)))
        return [EpisodeStart(engine_start=EngineStart.SNAPSHOT, weather="") for _ in self._steps]

    def _take(self, other: Rooms, slots: Sequence[int]) -> None:
        self._state, self._acted = other._state[list(slots)], other._acted[list(slots)]
        self._steps, self._seeds = [other._steps[slot] for slot in slots], [other._seeds[slot] for slot in slots]


def rooms_node(settings: Mapping[str, Any]) -> Node:
    steps = settings.get("steps", 50)
    node_settings = NodeSettings.model_validate({name: value for name, value in settings.items() if name != "steps"})

    def create(context: PlantContext) -> Plant:
        return Rooms(steps, context)

    return Node(node_settings, lambda: create, program=True)


if __name__ == "__main__":
    main(rooms_node)
