"""The running episode of a district: its plants, its orchestration, and the values of the present sample."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import fsum
from typing import Any

import numpy as np

from zenostat.cosim.binding import Binding, Member
from zenostat.cosim.coupled import GuardedPlant, PlantState, Rows
from zenostat.cosim.file import SolverSpec
from zenostat.cosim.market import Bids
from zenostat.cosim.orchestrator import Orchestrator
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Actuator, Aggregation, Meter


def free_columns(binding: Binding) -> dict[str, list[int]]:
    """Return the columns of the actuators of each plant that no connection feeds."""
    fed = {(target.plant, target.column) for target in binding.inputs}
    return {
        m.name: [column for column in range(len(m.manifest.actuators)) if (m.name, column) not in fed]
        for m in binding.members.values()
    }


def free_actuators(binding: Binding) -> dict[str, list[tuple[int, Actuator]]]:
    """Return the actuators of each plant that no connection feeds: column in the plant, and the district's actuator."""
    columns = free_columns(binding)
    return {
        m.name: [
            (
                column,
                Actuator(
                    name=f"{m.name}.{actuator.name}",
                    unit=actuator.unit,
                    low=actuator.low,
                    high=actuator.high,
                    default=actuator.default,
                    feedback=actuator.feedback,
                    baseline_sensor=actuator.baseline_sensor and f"{m.name}.{actuator.baseline_sensor}",
                ),
            )
            for column in columns[m.name]
            for actuator in (m.manifest.actuators[column],)
        ]
        for m in binding.members.values()
    }


def tried_plants(binding: Binding) -> list[str]:
    """Return the plants of which steps are tried: those of solved loops, and bidders of markets."""
    tried = {name for block in binding.topology.loops for name in block.plants}
    tried |= {name for market in binding.markets.values() if market.spec.bids is Bids.TRIALS for name in market.plants}
    return [name for name in binding.members if name in tried]


@dataclass(frozen=True, slots=True)
class RunState:
    """The state of a run at a sample, besides that of the plants' nodes.

    Attributes:
        orchestration: of `Orchestrator.capture`.
        plants: by name.
        steps: number of steps so far.
        values, effective: of the sample.
    """

    orchestration: dict[str, Any]
    plants: dict[str, PlantState]
    steps: int
    values: bytes
    effective: bytes


class DistrictRun:
    """An episode of a district.

    Args:
        binding: the district.
        plants: its plants by name.
        solver: limits of the solver.

    Attributes:
        steps: number of steps so far.
        values: of the sensors and meters of the district, raw float64.
        effective: of its actuators, raw float64.
    """

    def __init__(self, binding: Binding, plants: Mapping[str, GuardedPlant], solver: SolverSpec) -> None:
        self.plants = plants
        self._binding = binding
        self.orchestrator = Orchestrator(binding, plants, solver)
        self._columns = free_columns(binding)
        self._tried = tried_plants(binding)
        self.steps, self.values, self.effective = 0, b"", b""

    def start(self, seeds: Mapping[str, int]) -> None:
        """Begin an episode of all plants with these seeds."""
        self.orchestrator.start(seeds)
        self.steps = 0
        self._keep()

    def step(self, commands: bytes) -> bool:
        """Simulate a step of all plants; return whether it was the last one."""
        for _ in self.parts(commands):
            pass
        return self.is_over

    @property
    def is_over(self) -> bool:
        """Whether the sample is the last one."""
        return self.steps == self._binding.run_period.steps

    def parts(self, commands: bytes) -> Iterator[None]:
        """Simulate a step in parts, between which other runs can simulate theirs; see `Orchestrator.parts`."""
        row, own, first = np.frombuffer(commands), dict[str, Floats](), 0
        for name, columns in self._columns.items():
            own[name] = np.full(len(self._binding.members[name].manifest.actuators), np.nan)
            own[name][columns] = row[first : first + len(columns)]
            first += len(columns)
        yield from self.orchestrator.parts(own)
        self.steps += 1
        self._keep()

    def capture(self) -> RunState:
        """Return the state at the present sample."""
        plants = {name: plant.capture() for name, plant in self.plants.items()}
        return RunState(self.orchestrator.capture(), plants, self.steps, self.values, self.effective)

    def adopt(self, state: RunState) -> None:
        """Continue from a state; the plants' nodes are there already."""
        self.orchestrator.adopt(state.orchestration)
        for name, plant in self.plants.items():
            plant.adopt(state.plants[name])
        self.steps, self.values, self.effective = state.steps, state.values, state.effective

    def _keep(self) -> None:
        """Keep the values of the present sample."""
        orchestrator, members = self.orchestrator, self._binding.members.values()
        rows = orchestrator.rows
        sensors = [_combined(m, rows[m.name], range(len(m.manifest.sensors))) for m in members]
        meters = [_combined(m, rows[m.name], range(len(m.manifest.sensors), len(m.manifest.points))) for m in members]
        self.values = np.concatenate([*sensors, self._own_values(), *meters]).tobytes()
        effective = [rows[name].effective[-1, columns] for name, columns in self._columns.items()]
        self.effective = np.concatenate(effective).tobytes()

    def _own_values(self) -> Floats:
        orchestrator = self.orchestrator
        is_solved = [transfer.tolerance is not None for transfer in self._binding.transfers]
        loops = [
            value
            for state in orchestrator.loops
            for value in (state.trials, state.error, state.is_solved, state.unsolved)
        ]
        available = [plant.is_available for plant in self.plants.values()]
        available += [self.plants[name].is_tried for name in self._tried]
        return np.array(
            [
                *orchestrator.received,
                *orchestrator.residuals[is_solved],
                *orchestrator.balance_terms,
                *loops,
                *available,
            ],
            dtype=np.float64,
        )


def _combined(member: Member, rows: Rows, columns: range) -> Floats:
    """Return the values of some points over several timesteps: sums, means, or the last ones."""
    values = rows.values[:, columns.start : columns.stop]
    combined: Floats = values[-1].copy()
    if len(values) == 1:
        return combined
    for position, column in enumerate(columns):
        point = member.manifest.points[column]
        kind = Aggregation.SUM if isinstance(point, Meter) else point.aggregation
        if kind is not Aggregation.INSTANT:
            total = fsum(values[:, position].tolist())
            combined[position] = total if kind is Aggregation.SUM else total / len(values)
    return combined
