"""A district as the plant of a node; see `zenostat.bridge.node.plant`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.bridge.node.plant import PlantDefaults, PlantDescription, Provenance, RunningPlant, Site
from zenostat.cosim.binding import Binding
from zenostat.cosim.copies import DistrictCopy, PlantSnapshots, PlantSource
from zenostat.cosim.coupled import GuardedPlant, RepeatedPlant
from zenostat.cosim.file import SolverSpec
from zenostat.cosim.orchestrator import LoopState
from zenostat.cosim.run import DistrictRun, RunState, free_actuators, tried_plants
from zenostat.cosim.trials import PlantTrials, is_short
from zenostat.topics import VERSION
from zenostat.topics.connection_balance import ConnectionBalance
from zenostat.topics.errors import EngineDied, ForkFailed, InvalidRecording, SimulatorError, ZenostatError
from zenostat.topics.messages import (
    Action,
    Aggregation,
    EngineStart,
    EpisodeStart,
    Meter,
    Sensor,
    Systems,
    Task,
    Versions,
)
from zenostat.topics.seed_validation import MAX_SEED


def describe(
    binding: Binding,
    name: str,
    scenario: str,
    provenance: Provenance,
    reward: dict[str, Any] | None = None,
    systems: Systems | None = None,
) -> PlantDescription:
    """Return the description of a district: the points of its plants, and its own.

    Args:
        binding: the district.
        name: of the district.
        scenario: text of its file.
        provenance: what creates it again.
        reward: of environments; None: there is none.
        systems: its members and their grids.
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
        connected=_connected(binding),
        warnings=(
            *binding.warnings,
            *(f"{m.name}: {text}" for m in binding.members.values() for text in m.manifest.warnings),
        ),
        without_geometry="a district has no geometry; ask the nodes of its buildings",
        without_semantic="a district has no semantic model; ask the nodes of its buildings",
        systems=systems,
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

    def mean(name: str, unit: str) -> Sensor:
        return Sensor(name=name, unit=unit, aggregation=Aggregation.MEAN, observed=False)

    sensors = [mean(f"exchange.{transfer.name}", transfer.unit) for transfer in binding.transfers]
    sensors += [own(f"residual.{transfer.name}", transfer.unit) for transfer in binding.transfers if transfer.tolerance]
    sensors += [
        mean(f"balance.{transfer.name}.{term}", transfer.unit)
        for transfer in binding.transfers
        for term in transfer.balance_terms
    ]
    for block in binding.topology.loops:
        sensors += [
            own(f"loop.{block.name}.trials", "count", 0.0),
            own(f"loop.{block.name}.residual", "1", 0.0),
            own(f"loop.{block.name}.solved", "on_off", 0.0, 1.0),
            own(f"loop.{block.name}.unsolved_steps", "count", 0.0),
        ]
    sensors += [own(available_name(name), "on_off", 0.0, 1.0) for name in binding.members]
    return [*sensors, *(own(tried_name(name), "on_off", 0.0, 1.0) for name in tried_plants(binding))]


def available_name(plant: str) -> str:
    """Return the name of the sensor whether the values of a plant are its own."""
    return f"plant.{plant}.available"


def tried_name(plant: str) -> str:
    """Return the name of the sensor whether the trials of a plant were its own."""
    return f"plant.{plant}.trials_available"


def _connected(binding: Binding) -> dict[str, str]:
    """Return the sources of each input that connections determine, by its name."""
    names = [f"{t.source}.{binding.members[t.source].manifest.names[t.column]}" for t in binding.transfers]
    return {
        f"{fed.plant}.{fed.actuator.name}": ", ".join(dict.fromkeys(names[index] for index in fed.transfers))
        for fed in binding.inputs
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


class DistrictPlant(PlantDefaults):
    """A district as the plant of a node; implements `zenostat.bridge.node.plant.RepeatablePlant` for one slot.

    Args:
        binding: the district.
        description: of it.
        plants: its plants by name; it closes them.
        solver: limits of the solver.
        stop: that the plants have; set when the district is to end.
        seed: of the first episode; None draws it.

    Attributes:
        lost_steps: of a verification: number of steps in which a plant was lost, by the recording.
        on_waiting: see `zenostat.bridge.node.plant.WaitingPlant`.
    """

    def __init__(
        self,
        binding: Binding,
        description: PlantDescription,
        plants: Mapping[str, GuardedPlant],
        solver: SolverSpec,
        stop: threading.Event,
        seed: int | None = None,
    ) -> None:
        self.description = description
        self._binding, self._plants, self._solver, self._stop = binding, plants, solver, stop
        self.run = DistrictRun(binding, plants, solver)
        self.lost_steps: dict[str, int] = {}
        self._random = np.random.default_rng()
        self._seed = self._draw(seed)
        self._broken = self._abandoned = ""
        self.on_waiting: Callable[[str], None] = lambda _: None
        self._reporting = threading.Lock()  # plants of several loops may wait at the same time
        for plant in plants.values():
            plant.on_waiting = self._report_waiting

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
        self.run.start(self._seeds())
        self._broken = self._abandoned = ""

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

    def expect(self, recorded: Mapping[str, float]) -> None:
        """Let plants be lost in the next step that were by its recorded values; see `ExpectingPlant`."""
        for name, plant in self._plants.items():
            if isinstance(plant, RepeatedPlant):
                is_available = recorded.get(available_name(name), 1.0) != 0.0
                plant.expect(available=is_available, tried=recorded.get(tried_name(name), 1.0) != 0.0)
                self.lost_steps[name] = self.lost_steps.get(name, 0) + (not is_available)

    # Steps

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:  # noqa: ARG002
        """Simulate a step of all plants; see `RunningPlant.step`."""
        if self._broken:
            raise EngineDied(self._broken)
        try:
            return [self.run.step(commands)]
        except SimulatorError:
            if self._abandoned:
                raise EngineDied(self._abandoned) from None
            raise

    def _report_waiting(self, reason: str) -> None:
        with self._reporting:
            self.on_waiting(reason)

    @property
    def waiting(self) -> str:
        """For which plants a step waits, and why; see `WaitingPlant`."""
        return "; ".join(plant.waiting for plant in self._plants.values() if plant.waiting)

    def values(self) -> bytes:
        """Return the values of all plants, and of the orchestration; see `RunningPlant.values`."""
        return self.run.values

    @property
    def effective(self) -> bytes:
        """Effective values of the actuators; see `RunningPlant`."""
        return self.run.effective

    def balances(self) -> list[ConnectionBalance]:
        """Return the balance of each connection since sample 0."""
        return self.run.orchestrator.balances()

    def loops(self) -> dict[str, LoopState]:
        """Return the state of each loop by its name."""
        names = [block.name for block in self._binding.topology.loops]
        return dict(zip(names, self.run.orchestrator.loops, strict=True))

    def drain_warnings(self) -> list[str]:
        """Return texts about plants and loops since the last call; see `WarningPlant`."""
        return self.run.orchestrator.drain_warnings()

    drain_step_warnings = drain_warnings

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

    # Snapshots and branches

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> RunningPlant:  # noqa: ARG002
        """Return a copy of all plants at the present step; see `RunningPlant.fork` and `zenostat.cosim.copies`."""
        if self._broken:
            raise ForkFailed(self._broken)
        steps = {name: self.run.steps * member.steps for name, member in self._binding.members.items()}
        return self._copy(PlantSnapshots(self._plants, steps, self.run.steps), len(slots))

    def fork_for_trial(
        self, slots: Sequence[int], folder: Path, timesteps: int, *, baseline: bool = False
    ) -> RunningPlant:
        """Return a copy for a trial; see `TryingPlant` and `zenostat.cosim.trials`."""
        if not is_short(timesteps, self.description.run_period.step_s, self._plants):
            return self.fork(slots, folder, baseline=baseline)
        if self._broken:
            raise ForkFailed(self._broken)
        return self._copy(PlantTrials(self._plants), len(slots))

    def _copy(self, source: PlantSource, slots: int) -> DistrictCopy:
        def create(plants: Mapping[str, GuardedPlant], state: RunState) -> DistrictRun:
            run = DistrictRun(self._binding, plants, self._solver)
            run.adopt(state)
            return run

        states = [self.run.capture()] * slots
        return DistrictCopy(self.description, source, create, states, site=self.site(0), notes=self.notes(0))

    def restore(self, saved: RunningPlant, episode: Sequence[int]) -> list[EpisodeStart]:  # noqa: ARG002
        """Return all plants to a copy; see `Plant.restore`.

        If a plant cannot return, the others may have: the episode then ends with its next step.
        """
        assert isinstance(saved, DistrictCopy)
        assert isinstance(saved.source, PlantSnapshots)
        self._stop.clear()
        try:
            saved.source.restore()
        except ZenostatError as error:
            self._broken = f"the district cannot return to its snapshot, and must be reset: {error}"
            raise EngineDied(self._broken) from None
        self.run.adopt(saved.states[0])
        self._broken = self._abandoned = ""
        return [EpisodeStart(engine_start=EngineStart.SNAPSHOT, weather="")]

    # Processes

    @property
    def simulators(self) -> int:
        """Number of plants."""
        return len(self._plants)

    def interrupt(self) -> None:
        """End the plants' nodes, or leave them; thread-safe."""
        self._stop.set()
        for plant in self._plants.values():
            plant.plant.interrupt()

    def abandon(self, reason: str, *, is_starting: bool) -> None:  # noqa: ARG002
        """End or leave the plants' nodes, which are started or joined again; see `AbandonablePlant`."""
        self._abandoned = reason
        self.interrupt()

    def close(self) -> None:
        """End the plants' nodes, or leave them; idempotent."""
        self.interrupt()  # all at once: a node takes a while to end
        for plant in self._plants.values():
            plant.plant.close()
