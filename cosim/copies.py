"""Snapshots and branches of a whole district: all plants at the same step, or none.

A copy is a snapshot in the node of each plant, with the state of the orchestration. A slot of it that is stepped
continues in branches of these nodes. Since branches cannot be copied, a copy of such a slot begins at the same
snapshots, and gives the plants the commands that they have had since, which brings them to the same step to the bit.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from zenostat.bridge.node.plant import PlantDefaults, PlantDescription, RunningPlant, Site
from zenostat.cosim.coupled import CoupledPlant, GuardedPlant, Rows
from zenostat.cosim.file import OnLost
from zenostat.cosim.trials import PlantTrials, is_short
from zenostat.topics.errors import EngineDied, ForkFailed, ZenostatError

if TYPE_CHECKING:
    from zenostat.cosim.run import DistrictRun, RunState


class PlantSource(Protocol):
    """The source of the plants of a copy's slots: snapshots, or trials from the present sample."""

    def __len__(self) -> int:
        """Return the number of plants."""

    def branches(self, stop: threading.Event, state: RunState) -> dict[str, GuardedPlant]:
        """Return plants at the step of a state."""

    def use(self) -> PlantSource:
        """Return this source for another copy, which releases it as well."""

    def release(self) -> None:
        """Free what it holds, with the last copy that uses it."""


@runtime_checkable
class CopiedPlant(CoupledPlant, Protocol):
    """A coupled plant with snapshots and branches. All methods are for one thread."""

    def snapshot(self) -> tuple[str, int]:
        """Take a snapshot; return its name, and the step of its episode; -1 of a plant without a state."""

    def drop(self, snapshot: str) -> None:
        """Free a snapshot; does nothing if it is gone."""

    def restore(self, snapshot: str) -> Rows:
        """Return to a snapshot; return its sample as one timestep."""

    def branch(self, snapshot: str) -> CoupledPlant:
        """Create a branch that continues from a snapshot."""


class PlantSnapshots:
    """The snapshots of all plants of a district at one step, dropped with the last copy that uses them.

    Args:
        plants: by name.
        steps: number of timesteps of each plant so far.
        base: number of steps of the district so far.

    Raises:
        ForkFailed: a plant has no snapshots, is lost, or is at another step; there are none of the others either.
    """

    def __init__(self, plants: Mapping[str, GuardedPlant], steps: Mapping[str, int], base: int) -> None:
        self._base = base
        self._plants: dict[str, CopiedPlant] = {}
        self.names: dict[str, str] = {}
        self._users, self._lock = 1, threading.Lock()
        try:
            for name, plant in plants.items():
                self._add(name, plant, steps[name])
        except BaseException:
            self.release()
            raise

    def _add(self, name: str, guarded: GuardedPlant, steps: int) -> None:
        plant = guarded.plant
        if not guarded.is_available:
            raise ForkFailed(f"plant {name!r} is lost, and a snapshot has all plants or none")
        if not isinstance(plant, CopiedPlant):
            raise ForkFailed(f"plant {name!r} has no snapshots")
        try:
            snapshot, at = plant.snapshot()
        except ZenostatError as error:
            raise ForkFailed(f"plant {name!r} has no snapshot: {error}; the others have none either") from None
        self._plants[name], self.names[name] = plant, snapshot
        if at >= 0 and at != steps:
            raise ForkFailed(f"plant {name!r} is at its step {at}, and not at {steps}: somebody else steps it")

    def __len__(self) -> int:
        """Return the number of plants."""
        return len(self.names)

    def use(self) -> PlantSnapshots:
        """Return these snapshots for another copy, which releases them as well."""
        with self._lock:
            self._users += 1
        return self

    def release(self) -> None:
        """Drop them if no copy uses them any more."""
        with self._lock:
            self._users -= 1
            is_last = not self._users
        if is_last:
            for name, snapshot in self.names.items():
                with suppress(ZenostatError):
                    self._plants[name].drop(snapshot)

    def restore(self) -> None:
        """Return all plants to their snapshots; raises the error of the first one that cannot."""
        for name, snapshot in self.names.items():
            self._plants[name].restore(snapshot)

    def branches(self, stop: threading.Event, state: RunState) -> dict[str, GuardedPlant]:
        """Create a branch of each plant, and bring it to the step of a state that continued from these snapshots.

        Raises:
            EngineDied: a branch cannot be created, or be brought to that step.
        """
        plants: dict[str, GuardedPlant] = {}
        try:
            for name, snapshot in self.names.items():
                branch = self._plants[name].branch(snapshot)
                plants[name] = GuardedPlant(name, branch, OnLost.STOP, timeout_s=1.0, stop=stop)
            for step in range(self._base, state.steps):
                for name, plant in plants.items():
                    plant.plant.begin(state.plants[name].history[step])
                for plant in plants.values():
                    plant.plant.finish()
        except ZenostatError as error:
            for plant in plants.values():
                plant.plant.close()
            raise EngineDied(f"a branch of the district cannot be created: {error}") from None
        return plants


class DistrictCopy(PlantDefaults):
    """A copy of a district with one or more slots; implements `zenostat.bridge.node.plant.RunningPlant`.

    Args:
        description: of the district.
        source: of its plants; the copy releases it.
        create: creates the run of a slot from a state, in branches of the plants that are at its step.
        states: of each slot.
        site: of the episode.
        notes: of the episode.
    """

    def __init__(
        self,
        description: PlantDescription,
        source: PlantSource,
        create: Callable[[Mapping[str, GuardedPlant], RunState], DistrictRun],
        states: Sequence[RunState],
        *,
        site: Site,
        notes: list[str],
    ) -> None:
        self.description, self.source, self.states = description, source, states
        self._create, self._site, self._notes = create, site, notes
        self._runs: list[DistrictRun | None] = [None] * len(states)
        self._stop = threading.Event()
        self._is_closed = False

    def _run(self, slot: int) -> DistrictRun:
        run = self._runs[slot]
        if run is None:
            state = self.states[slot]
            run = self._runs[slot] = self._create(self.source.branches(self._stop, state), state)
        return run

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:
        """Simulate a step in each active slot, at the same time; see `RunningPlant.step`."""
        size = len(commands) // len(self._runs)
        runs = [self._run(slot) for slot in active_slots]
        steps = [
            run.parts(commands[slot * size : (slot + 1) * size]) for slot, run in zip(active_slots, runs, strict=True)
        ]
        for _ in zip(*steps, strict=True):  # the plants of all slots begin before those of one are waited for
            pass
        return [run.is_over for run in runs]

    def values(self) -> bytes:
        """Return the values of all slots; see `RunningPlant.values`."""
        return b"".join(current.values for current in self._current())

    @property
    def effective(self) -> bytes:
        """Effective values of all slots."""
        return b"".join(current.effective for current in self._current())

    def _current(self) -> Iterator[RunState | DistrictRun]:
        """Yield what has the present values of each slot."""
        for state, run in zip(self.states, self._runs, strict=True):
            yield state if run is None else run

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> RunningPlant:  # noqa: ARG002
        """Return a copy of slots; see `RunningPlant.fork`. Its first step repeats those of this copy."""
        states = []
        for slot in slots:
            run = self._runs[slot]
            states.append(self.states[slot] if run is None else run.capture())
        return DistrictCopy(
            self.description, self.source.use(), self._create, states, site=self._site, notes=self._notes
        )

    def fork_for_trial(
        self, slots: Sequence[int], folder: Path, timesteps: int, *, baseline: bool = False
    ) -> RunningPlant:
        """Return a copy for a trial; see `TryingPlant`. A slot that was not stepped yet gets its branches by it."""
        if len(self._runs) > 1:
            return self.fork(slots, folder, baseline=baseline)
        run = self._run(0)
        if not is_short(timesteps, self.description.run_period.step_s, run.plants):
            return self.fork(slots, folder, baseline=baseline)
        return DistrictCopy(
            self.description, PlantTrials(run.plants), self._create, [run.capture()] * len(slots),
            site=self._site, notes=self._notes,
        )  # fmt: skip

    def site(self, slot: int) -> Site:  # noqa: ARG002
        """Return the site of the district."""
        return self._site

    def notes(self, slot: int) -> list[str]:  # noqa: ARG002
        """Return the notes of the district's episode."""
        return self._notes

    @property
    def simulators(self) -> int:
        """Number of copied plants."""
        return len(self.source) * len(self._runs)

    def interrupt(self) -> None:
        """Make a running step raise soon; thread-safe."""
        self._stop.set()
        for run in self._runs:
            for plant in run.plants.values() if run is not None else ():
                plant.plant.interrupt()

    def close(self) -> None:
        """End the branches, and release the snapshots; idempotent."""
        if self._is_closed:
            return
        self._is_closed = True
        for run in self._runs:
            for plant in run.plants.values() if run is not None else ():
                plant.plant.close()
        self.source.release()
