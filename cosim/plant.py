"""A district as the plant of a node; see `zenostat.bridge.node.plant`."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from math import fsum
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.bridge.node.plant import (
    PlantDescription,
    Provenance,
    RunningPlant,
    Site,
    WeatherTable,
    without_weather,
)
from zenostat.cosim.balance import Balance
from zenostat.cosim.binding import Binding, Member
from zenostat.cosim.coupled import Floats, GuardedPlant, Rows
from zenostat.cosim.file import SolverSpec
from zenostat.cosim.orchestrator import LoopState, Orchestrator
from zenostat.topics import VERSION
from zenostat.topics.errors import ForkFailed, InvalidRecording
from zenostat.topics.messages import (
    Action,
    Actuator,
    Aggregation,
    EngineStart,
    EpisodeStart,
    Meter,
    Sensor,
    Task,
    Versions,
)
from zenostat.topics.seed_validation import MAX_SEED

_UNCOPIED = (
    "a district has no snapshots and branches: its plants are nodes of their own; take snapshots of these, or reset it"
)


def describe(
    binding: Binding, name: str, scenario: str, provenance: Provenance, reward: dict[str, Any] | None = None
) -> PlantDescription:
    """Return the description of a district: the points of its plants, and its own.

    Args:
        binding: the district.
        name: of the district.
        scenario: text of its file.
        provenance: what creates it again.
        reward: of environments; None: there is none.
    """
    sensors = [*_plant_sensors(binding), *_own_sensors(binding)]
    meters = [
        Meter(name=f"{m.name}.{meter.name}", unit=meter.unit, low=meter.low, high=meter.high, observed=meter.observed)
        for m in binding.members.values()
        for meter in m.manifest.meters
    ]
    actuators = [actuator for actuators in free_actuators(binding).values() for _, actuator in actuators]
    return PlantDescription(
        name=name,
        run_period=binding.run_period,
        sensors=tuple(sensors),
        meters=tuple(meters),
        actuators=tuple(actuators),
        versions=Versions(zenostat=VERSION, energyplus=_energyplus(binding)),
        task=_task(binding, name, {actuator.name for actuator in actuators}, reward),
        scenario=scenario,
        warnings=(
            *binding.warnings,
            *(f"{m.name}: {text}" for m in binding.members.values() for text in m.manifest.warnings),
        ),
        without_geometry="a district has no geometry; ask the nodes of its buildings",
        provenance=provenance,
    )


def _energyplus(binding: Binding) -> str:
    versions = {m.manifest.versions.energyplus for m in binding.members.values()} - {""}
    return ", ".join(sorted(versions))


def _plant_sensors(binding: Binding) -> list[Sensor]:
    return [
        Sensor(
            name=f"{m.name}.{sensor.name}",
            unit=sensor.unit,
            aggregation=sensor.aggregation,
            lead_s=sensor.lead_s,
            low=sensor.low,
            high=sensor.high,
            observed=sensor.observed,
        )
        for m in binding.members.values()
        for sensor in m.manifest.sensors
    ]


def _own_sensors(binding: Binding) -> list[Sensor]:
    """Return the sensors of the orchestration, in the order of `DistrictPlant.values`."""

    def own(name: str, unit: str, low: float | None = None, high: float | None = None) -> Sensor:
        return Sensor(name=name, unit=unit, low=low, high=high, observed=False)

    sensors = [own(f"exchange.{transfer.name}", transfer.unit) for transfer in binding.transfers]
    sensors += [own(f"residual.{transfer.name}", transfer.unit) for transfer in binding.transfers if transfer.tolerance]
    for block in binding.topology.loops:
        sensors += [
            own(f"loop.{block.name}.trials", "count", 0.0),
            own(f"loop.{block.name}.residual", "1", 0.0),
            own(f"loop.{block.name}.solved", "on_off", 0.0, 1.0),
            own(f"loop.{block.name}.unsolved_steps", "count", 0.0),
        ]
    return [*sensors, *(own(f"plant.{name}.available", "on_off", 0.0, 1.0) for name in binding.members)]


def free_actuators(binding: Binding) -> dict[str, list[tuple[int, Actuator]]]:
    """Return the actuators of each plant that no connection feeds: column in the plant, and the district's actuator."""
    fed = {(target.plant, target.column) for target in binding.inputs}
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
            for column, actuator in enumerate(m.manifest.actuators)
            if (m.name, column) not in fed
        ]
        for m in binding.members.values()
    }


def _task(binding: Binding, name: str, actuators: set[str], reward: dict[str, Any] | None) -> Task:
    """Return the actions of all plants whose actuators are free; the time features are those of the first plant."""
    actions = []
    for m in binding.members.values():
        for action in m.manifest.task.actions:
            renamed = tuple(f"{m.name}.{actuator}" for actuator in action.actuators)
            if actuators.issuperset(renamed):
                fields = action.model_copy(update={"name": f"{m.name}.{action.name}", "actuators": renamed})
                actions.append(Action.model_validate(fields.model_dump()))
    first = next(iter(binding.members.values())).manifest.task
    return Task(scenario=name, time=first.time, actions=tuple(actions), reward=reward)


class DistrictPlant:
    """A district as the plant of a node; implements `zenostat.bridge.node.plant.RepeatablePlant` for one slot.

    Args:
        binding: the district.
        description: of it.
        plants: its plants by name; it closes them.
        solver: limits of the solver.
        stop: that the plants have; set when the district is to end.
    """

    has_baseline = False

    def __init__(
        self,
        binding: Binding,
        description: PlantDescription,
        plants: Mapping[str, GuardedPlant],
        solver: SolverSpec,
        stop: threading.Event,
    ) -> None:
        self.description = description
        self._binding, self._plants, self._stop = binding, plants, stop
        self.orchestrator = Orchestrator(binding, plants, solver)
        self._columns = {name: [column for column, _ in each] for name, each in free_actuators(binding).items()}
        self._random = np.random.default_rng()
        self._seed = self._draw(None)
        self._steps = 0
        self._values = b""
        self.effective = b""

    # Episodes

    def _draw(self, seed: int | None) -> int:
        if seed is None:
            return int(self._random.integers(MAX_SEED, dtype=np.uint64, endpoint=True))
        self._random = np.random.default_rng(seed)
        return seed

    def next_episode(
        self,
        slots: Sequence[int],  # noqa: ARG002
        seeds: Sequence[int | None],
        episode: Sequence[int],  # noqa: ARG002
        untouched: Sequence[bool],  # noqa: ARG002
    ) -> list[EpisodeStart]:
        """Draw the seed of the next episode; see `Plant.next_episode`."""
        self._seed = self._draw(seeds[0])
        return [EpisodeStart(engine_start=EngineStart.RESET, weather="")]

    def start(self, slots: Sequence[int]) -> None:  # noqa: ARG002
        """Begin an episode of all plants; see `Plant.start`."""
        self._stop.clear()
        self.orchestrator.start(self._seeds())
        self._steps = 0
        self._keep()

    def _seeds(self) -> dict[str, int]:
        """Return a seed for each plant, which depends on that of the episode and the order of the plants."""
        words = np.random.SeedSequence(self._seed).generate_state(len(self._plants), np.uint64)
        return dict(zip(self._plants, (int(word) for word in words), strict=True))

    def episode_inputs(self, slot: int) -> dict[str, Any]:  # noqa: ARG002
        """Return the seed; see `RepeatablePlant.episode_inputs`."""
        return {"seed": self._seed}

    def repeat_episode(
        self,
        slots: Sequence[int],  # noqa: ARG002
        inputs: Sequence[Mapping[str, Any]],
        episode: Sequence[int],  # noqa: ARG002
    ) -> None:
        """Choose the seed of a recorded episode; see `RepeatablePlant.repeat_episode`."""
        seed = inputs[0].get("seed")
        if not isinstance(seed, int) or not 0 <= seed <= MAX_SEED:
            raise InvalidRecording(f"an episode of a district has a seed, not {dict(inputs[0])}")
        self._seed = seed

    # Steps

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:  # noqa: ARG002
        """Simulate a step of all plants; see `RunningPlant.step`."""
        row, own, first = np.frombuffer(commands), dict[str, Floats](), 0
        for name, columns in self._columns.items():
            own[name] = np.full(len(self._binding.members[name].manifest.actuators), np.nan)
            own[name][columns] = row[first : first + len(columns)]
            first += len(columns)
        self.orchestrator.step(own)
        self._steps += 1
        self._keep()
        return [self._steps == self.description.run_period.steps]

    def _keep(self) -> None:
        """Keep the values of the present sample."""
        orchestrator, members = self.orchestrator, self._binding.members.values()
        rows = orchestrator.rows
        sensors = [_combined(m, rows[m.name], range(len(m.manifest.sensors))) for m in members]
        meters = [_combined(m, rows[m.name], range(len(m.manifest.sensors), len(m.manifest.points))) for m in members]
        self._values = np.concatenate([*sensors, self._own_values(), *meters]).tobytes()
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
        available = [plant.is_available for plant in self._plants.values()]
        return np.array(
            [*orchestrator.received, *orchestrator.residuals[is_solved], *loops, *available], dtype=np.float64
        )

    def values(self) -> bytes:
        """Return the values of all plants, and of the orchestration; see `RunningPlant.values`."""
        return self._values

    def balances(self) -> list[Balance]:
        """Return the balance of each connection since sample 0."""
        return self.orchestrator.balances()

    def loops(self) -> dict[str, LoopState]:
        """Return the state of each loop by its name."""
        names = [block.name for block in self._binding.topology.loops]
        return dict(zip(names, self.orchestrator.loops, strict=True))

    def drain_warnings(self) -> list[str]:
        """Return texts about plants and loops since the last call; see `WarningPlant`."""
        return self.orchestrator.drain_warnings()

    drain_step_warnings = drain_warnings

    # What a district does not have

    def baseline_values(self) -> bytes:
        """Return nothing."""
        return b""

    baseline_effective = baseline_values

    def site(self, slot: int) -> Site:  # noqa: ARG002
        """Return the site of the first plant that has one."""
        for m in self._binding.members.values():
            if m.manifest.weather:
                manifest = m.manifest
                return Site(manifest.weather, manifest.location, manifest.latitude_deg, manifest.longitude_deg)
        return Site()

    def notes(self, slot: int) -> list[str]:  # noqa: ARG002
        """Return the names of the plants."""
        return [f"plants: {', '.join(self._plants)}"]

    def weather(self, slot: int, columns: Sequence[str]) -> WeatherTable:  # noqa: ARG002
        """Raise `RequestRejected`."""
        raise without_weather()

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> RunningPlant:  # noqa: ARG002
        """Raise `ForkFailed`."""
        raise ForkFailed(_UNCOPIED)

    def restore(self, saved: RunningPlant, episode: Sequence[int]) -> list[EpisodeStart]:  # noqa: ARG002
        """Raise `ForkFailed`: there are no copies."""
        raise ForkFailed(_UNCOPIED)

    # Processes

    def check(self) -> None:
        """Do nothing: a plant that has ended is noticed in the next step."""

    clean_up = check

    def memory_bytes(self, *, private: bool = False) -> int:  # noqa: ARG002
        """Return 0: the plants' processes belong to their nodes."""
        return 0

    @property
    def simulators(self) -> int:
        """Number of plants."""
        return len(self._plants)

    def interrupt(self) -> None:
        """End the plants' nodes, or leave them; thread-safe."""
        self._stop.set()
        for plant in self._plants.values():
            plant.plant.interrupt()

    def end(self, *, failed: bool = False) -> None:
        """Do nothing: the nodes wait for the next episode."""

    def close(self) -> None:
        """End the plants' nodes, or leave them; idempotent."""
        self.interrupt()  # all at once: a node takes a while to end
        for plant in self._plants.values():
            plant.plant.close()


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
