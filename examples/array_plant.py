"""A node for a plant of arrays: tanks that step together in the node's own process, without engines.

It implements `zenostat.bridge.node.plant.Plant`; docs/own-plants.md explains when that is worth it.

Run it: `python examples/array_plant.py [--slots 4] [--listen tcp/127.0.0.1:7447]`, and then, in another terminal,
`zenostat run --node tanks --controller fixed --set heater=800`
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from datetime import datetime

import numpy as np

from zenostat.bridge.node.node import Node
from zenostat.bridge.node.plant import PlantContext, PlantDefaults, PlantDescription, RunPeriod
from zenostat.bridge.node.settings import NodeSettings
from zenostat.topics import VERSION
from zenostat.topics.messages import Action, Actuator, EngineStart, EpisodeStart, Meter, Sensor, Task, Versions

STEP_S, AMBIENT_DEGC, CAPACITY_J_K, LOSS_W_K = 60.0, 20.0, 8.4e5, 2.0

DESCRIPTION = PlantDescription(
    name="tanks",
    run_period=RunPeriod(datetime(2026, 1, 1), STEP_S, steps=24 * 60),
    sensors=(Sensor(name="temperature", unit="degC", low=0.0, high=2000.0),),
    meters=(Meter(name="electricity", unit="J", low=0.0),),
    actuators=(Actuator(name="heater", unit="W", low=0.0, high=3000.0),),
    versions=Versions(zenostat=VERSION),
    task=Task(actions=(Action(name="heater", unit="W", low=0.0, high=3000.0, actuators=("heater",)),)),
)


class Tanks(PlantDefaults):
    """One tank per slot: C dT/dt = heater - loss (T - ambient), solved exactly for constant power over a timestep."""

    description = DESCRIPTION

    def __init__(self, context: PlantContext) -> None:
        self.simulators = context.slots
        self._random = [np.random.default_rng() for _ in range(context.slots)]
        self._temperature, self._energy = np.zeros(context.slots), np.zeros(context.slots)
        self._heater = np.full(context.slots, np.nan)
        self._steps = np.zeros(context.slots, int)

    # An episode

    def next_episode(
        self,
        slots: Sequence[int],
        seeds: Sequence[int | None],
        episode: Sequence[int],  # noqa: ARG002
        untouched: Sequence[bool],  # noqa: ARG002
    ) -> list[EpisodeStart]:
        """Seed the generators; None continues them."""
        for slot, seed in zip(slots, seeds, strict=True):
            if seed is not None:
                self._random[slot] = np.random.default_rng(seed)
        return [EpisodeStart(engine_start=EngineStart.RESET, weather="") for _ in slots]

    def start(self, slots: Sequence[int]) -> None:
        """Draw the temperatures of sample 0."""
        for slot in slots:
            self._temperature[slot] = self._random[slot].uniform(20.0, 60.0)
            self._energy[slot], self._heater[slot], self._steps[slot] = 0.0, np.nan, 0

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:
        """Simulate a minute."""
        slots = list(active_slots)
        self._heater[slots] = np.frombuffer(commands)[slots]
        power = np.nan_to_num(self._heater[slots])  # relinquished: off
        steady = AMBIENT_DEGC + power / LOSS_W_K
        decay = np.exp(-STEP_S * LOSS_W_K / CAPACITY_J_K)
        self._temperature[slots] = steady + (self._temperature[slots] - steady) * decay
        self._energy[slots] = power * STEP_S
        self._steps[slots] += 1
        return [bool(last) for last in self._steps[slots] == DESCRIPTION.run_period.steps]

    def values(self) -> bytes:
        """Return temperature and energy of each slot."""
        return np.column_stack([self._temperature, self._energy]).tobytes()

    @property
    def effective(self) -> bytes:
        """Power of each heater."""
        return self._heater.tobytes()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--slots", type=int, default=1)
    parser.add_argument("--listen", default="tcp/127.0.0.1:7447")
    options = parser.parse_args()
    settings = NodeSettings(name="tanks", slots=options.slots, listen=[options.listen])
    with Node(settings, lambda: Tanks, program=True) as node:
        print(f"{node.manifest.node} on {options.listen}", flush=True)
        node.serve()
