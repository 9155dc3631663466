"""A Python class as a plant: one process per slot, which is kept from episode to episode."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.bridge.engine.client import EngineClient
from zenostat.bridge.engine.group import EngineGroup
from zenostat.bridge.engine.lists import start_all
from zenostat.bridge.engine.spec import EngineSpec
from zenostat.bridge.node.plant import PlantContext, PlantDefaults, RunningPlant, SlotPlacement
from zenostat.bridge.python_plant.class_plan import PYTHON, ClassPlan
from zenostat.bridge.python_plant.kept_copies import KeptCopies
from zenostat.topics.errors import EngineDied, ForkFailed, InvalidRecording
from zenostat.topics.messages import EngineStart, EpisodeStart
from zenostat.topics.seed_validation import MAX_SEED

CLOSE_S = 1.0
"""Time that the `close` of a plant may take; a node ends within two seconds."""


class PythonEngines(EngineGroup, PlantDefaults):
    """Running processes of a plant's class: of a node, a snapshot or a branch.

    Args:
        plan: the checked class.
        cpus: cores on which copies may run; empty leaves them to the system.
    """

    def __init__(self, plan: ClassPlan, cpus: tuple[int, ...]) -> None:
        self.description = plan.description
        super().__init__(len(self.description.actuators))
        self._plan, self._copy_cpus = plan, cpus
        self._numbers = itertools.count(1)
        self._kept = KeptCopies(self._copy)

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> PythonEngines:
        """Copy the processes of some slots; see `RunningPlant.fork`."""
        copies = self._copy_all(self.members(slots, baseline=baseline), folder)
        copy = PythonEngines(self._plan, self._copy_cpus)
        copy.adopt(copies, self, slots)
        return copy

    def fork_for_trial(
        self,
        slots: Sequence[int],
        folder: Path,
        timesteps: int,  # noqa: ARG002
        *,
        baseline: bool = False,
    ) -> PythonEngines:
        """Return a copy for a trial; see `TryingPlant`. A class that saves its state has processes kept for them."""
        if not self._plan.has_state:
            return self.fork(slots, folder, baseline=baseline)
        copies = self._kept.lend(self.members(slots, baseline=baseline), folder)
        copy = TriedEngines(self._plan, self._copy_cpus, self._kept)
        copy.adopt(copies, self, slots)
        return copy

    def end(self, *, failed: bool = False) -> None:
        """End all processes, also those that are kept for trials; idempotent."""
        self._kept.close()
        super().end(failed=failed)

    def _copy_all(self, clients: Sequence[EngineClient], folder: Path) -> list[EngineClient]:
        if not self._plan.forkable and not self._plan.has_state:
            raise ForkFailed(
                self._plan.copy_error
                or f"plant {self._plan.plant!r} cannot be copied: give its class save() and restore(state), or "
                "forkable = True if its process has no threads and no connections"
            )
        return start_all(clients, lambda client: self._copy(client, folder / str(next(self._numbers))))

    def _copy(self, client: EngineClient, folder: Path, placement: SlotPlacement | None = None) -> EngineClient:
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise ForkFailed(f"the node has no room for a copy's files: {error}") from None
        cpus, poll = (self._copy_cpus, False) if placement is None else (placement.cpus, placement.poll)
        spec = replace(client.spec, folder=folder, cpus=cpus, poll=poll)
        if self._plan.forkable:
            copy = client.fork(replace(spec, close_s=0.0))  # what is to be released belongs to the original
        else:
            state = folder / "state.pickle"
            client.save(state)
            copy = EngineClient(replace(spec, state=state), registry=client.registry)
        _receive(copy)
        return copy


class TriedEngines(PythonEngines):
    """Processes of a trial, which go back to those that are kept for the next one.

    Args:
        plan, cpus: as of `PythonEngines`.
        source: of the processes.
    """

    def __init__(self, plan: ClassPlan, cpus: tuple[int, ...], source: KeptCopies) -> None:
        super().__init__(plan, cpus)
        self._source = source
        self._are_waiting = True

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:
        """Simulate a timestep; see `EngineGroup.step`."""
        self._are_waiting = False
        last = super().step(commands, active_slots)
        self._are_waiting = True
        return last

    def run(self, commands: Sequence[bytes], active_slots: Sequence[int]) -> Iterator[list[bool]]:
        """Simulate several timesteps; see `EngineGroup.run`."""
        self._are_waiting = False
        yield from super().run(commands, active_slots)
        self._are_waiting = True

    def order_close(self) -> None:
        """Give the processes back, or let them end if the trial has failed; see `ClosingPlant`."""
        if self._are_waiting and not any(client.interrupted for client in self.all):
            self._source.give_back(self.all)
            self.clients, self.baselines = [], []
        super().order_close()


def _receive(client: EngineClient) -> None:
    try:
        client.receive()
    except BaseException:
        client.close()
        raise


class PythonPlant(PythonEngines):
    """The processes of a node; implements `zenostat.bridge.node.plant.Plant`.

    Args:
        plan: the checked class.
        context: folder, cores and registry of the node.
    """

    def __init__(self, plan: ClassPlan, context: PlantContext) -> None:
        super().__init__(plan, context.cpus)
        self._context = context
        self._random = [np.random.default_rng() for _ in context.placement]
        self._seeds = [self._draw(slot, None) for slot in range(context.slots)]
        self._replaced: list[EngineClient] = []
        self._first: EngineClient | None = None
        self._warnings: list[str] = []

    def _draw(self, slot: int, seed: int | None) -> int:
        """Return the seed of an episode; None draws the next one after the last seed."""
        if seed is None:
            return int(self._random[slot].integers(MAX_SEED, dtype=np.uint64, endpoint=True))
        self._random[slot] = np.random.default_rng(seed)
        return seed

    def next_episode(
        self,
        slots: Sequence[int],
        seeds: Sequence[int | None],
        episode: Sequence[int],  # noqa: ARG002
        untouched: Sequence[bool],  # noqa: ARG002
    ) -> list[EpisodeStart]:
        """Draw the seed of the next episode of some slots; see `Plant.next_episode`."""
        for slot, seed in zip(slots, seeds, strict=True):
            self._seeds[slot] = self._draw(slot, seed)
        again = EngineStart.RESET if self._first is None else EngineStart.FORKED
        return [
            EpisodeStart(engine_start=again if self._runs(slot) else EngineStart.STARTED, weather="") for slot in slots
        ]

    def episode_inputs(self, slot: int) -> dict[str, Any]:
        """Return the seed; see `RepeatablePlant.episode_inputs`."""
        return {"seed": self._seeds[slot]}

    def repeat_episode(
        self,
        slots: Sequence[int],
        inputs: Sequence[Mapping[str, Any]],
        episode: Sequence[int],  # noqa: ARG002
    ) -> None:
        """Choose the seed of a recorded episode; see `RepeatablePlant.repeat_episode`."""
        for slot, fields in zip(slots, inputs, strict=True):
            seed = fields.get("seed")
            if not isinstance(seed, int) or not 0 <= seed <= MAX_SEED:
                raise InvalidRecording(f"an episode of a Python class has a seed, not {dict(fields)}")
            self._seeds[slot] = seed

    def _runs(self, slot: int) -> bool:
        return bool(self.clients) and self.clients[slot].alive

    def start(self, slots: Sequence[int]) -> None:
        """Reset the class of some slots, in new processes where the previous ones have ended; see `Plant.start`."""
        if not self.clients:
            self.clients = start_all(slots, self._start)
            if self._context.baseline:
                self.baselines = start_all(slots, self._start)
            for client in self.all:
                client.receive()
            self._keep_first()
        elif self._plan.begins_alike and self._plan.forkable:
            for clients in (self.clients, self.baselines):
                for slot in slots if clients else ():
                    self._begin_alike(clients, slot)
        else:
            for clients in (self.clients, self.baselines):
                self._restart(clients, slots)
        self.begin(slots)

    def _keep_first(self) -> None:
        """Keep a fork at sample 0, of which later episodes are forks; without one, they have new processes."""
        if not self._plan.begins_alike or not self._plan.forkable:
            return
        with suppress(ForkFailed):
            self._first = self._copy(self.clients[0], self._context.folder / f"first-{next(self._numbers)}")

    def _begin_alike(self, clients: list[EngineClient], slot: int) -> None:
        clients[slot].close()
        if self._first is not None:
            try:
                folder = self._context.folder / f"plant-{next(self._numbers)}"
                clients[slot] = self._copy(self._first, folder, self._context.placement[slot])
                return
            except (EngineDied, ForkFailed) as error:
                if self._context.registry.closing:
                    raise
                self._warnings.append(f"the process that waits at sample 0 is abandoned: {error}")
                self._first.close()
                self._first = None
        clients[slot] = self._start(slot)
        clients[slot].receive()

    def _restart(self, clients: list[EngineClient], slots: Sequence[int]) -> None:
        slots = [slot for slot in slots if slot < len(clients)]
        is_reset = {slot: self._send_reset(clients, slot) for slot in slots}
        for slot in slots:
            try:
                clients[slot].receive()
            except EngineDied as error:
                if not is_reset[slot] or clients[slot].interrupted or self._context.registry.closing:
                    raise
                self._warnings.append(f"the process of slot {slot} is replaced: {error}")
                self._replace(clients, slot)
                clients[slot].receive()

    def _send_reset(self, clients: list[EngineClient], slot: int) -> bool:
        """Order an episode of a process that runs; return whether it does, or start another one."""
        with suppress(EngineDied):
            if clients[slot].alive:
                clients[slot].send_reset(self._seeds[slot])
                return True
        self._replace(clients, slot)
        return False

    def _replace(self, clients: list[EngineClient], slot: int) -> None:
        clients[slot].close()
        clients[slot] = self._start(slot)

    def _start(self, slot: int) -> EngineClient:
        placement: SlotPlacement = self._context.placement[slot]
        folder = self._context.folder / f"plant-{next(self._numbers)}"
        try:
            folder.mkdir(parents=True)
            return EngineClient(self._spec(folder, slot, placement), registry=self._context.registry)
        except OSError as error:
            raise EngineDied(f"cannot start the plant's process: {error}") from None

    def _spec(self, folder: Path, slot: int, placement: SlotPlacement) -> EngineSpec:
        description = self.description
        values = [*(sensor.name for sensor in description.sensors), *(meter.name for meter in description.meters)]
        return EngineSpec(
            program=PYTHON,
            folder=folder,
            values=len(values),
            actuators=len(description.actuators),
            feedback=tuple(range(len(description.actuators))),
            run={
                "plant": self._plan.plant,
                "arguments": dict(self._plan.arguments),
                "values": values,
                "actuators": [(a.name, a.default) for a in description.actuators],
                "steps": description.run_period.steps,
                "seed": self._seeds[slot],
            },
            cpus=placement.cpus,
            poll=placement.poll,
            close_s=CLOSE_S if self._plan.has_close else 0.0,
        )

    def restore(self, saved: RunningPlant, episode: Sequence[int]) -> list[EpisodeStart]:  # noqa: ARG002
        """Continue from a snapshot; see `Plant.restore`."""
        assert isinstance(saved, PythonEngines)
        copies = self._copy_all(saved.all, self._context.folder / f"restored-{next(self._numbers)}")
        self._replaced = self.all
        slots = range(len(self.clients))
        self.adopt(copies, saved, slots)
        return [EpisodeStart(engine_start=EngineStart.SNAPSHOT, weather="") for _ in slots]

    def clean_up(self) -> None:
        """End the processes that were replaced."""
        replaced, self._replaced = self._replaced, []
        for client in replaced:
            client.close()

    def drain_warnings(self) -> list[str]:
        """Return warnings about processes that were replaced, since the last call."""
        warnings, self._warnings = self._warnings, []
        return warnings

    def abandon(self, reason: str, *, is_starting: bool) -> None:  # noqa: ARG002
        """Kill all processes, also those whose `reset` is running; see `AbandonablePlant`."""
        super().abandon(reason, is_starting=False)

    def interrupt(self) -> None:
        """Kill all processes, also those that are starting; thread-safe."""
        self._context.registry.interrupt()

    def close(self) -> None:
        """End all processes; idempotent."""
        self.clean_up()
        if self._first is not None:
            self._first.close()
        self.end()
