"""A Python class as a plant: one process per slot, which is kept from episode to episode."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from zenostat.bridge.engine.client import EngineClient
from zenostat.bridge.engine.group import EngineGroup
from zenostat.bridge.engine.lists import start_all
from zenostat.bridge.engine.spec import EngineProgram, EngineSpec
from zenostat.bridge.node.plant import (
    PlantContext,
    PlantDescription,
    Provenance,
    RunningPlant,
    RunPeriod,
    Site,
    SlotPlacement,
    WeatherTable,
    without_weather,
)
from zenostat.bridge.python_plant.description import split_name
from zenostat.bridge.runtime.idle_watch import LOOK_S, IdleWatch
from zenostat.topics import VERSION, errors
from zenostat.topics.errors import EngineDied, EngineUnresponsive, ForkFailed, InvalidRecording, PlantFailed
from zenostat.topics.messages import (
    Action,
    Actuator,
    EngineStart,
    EpisodeStart,
    Meter,
    Sensor,
    Task,
    TimeField,
    Versions,
)
from zenostat.topics.seed_validation import MAX_SEED

HOST = (sys.executable, "-P", "-m", "zenostat.bridge.python_plant.host")

PYTHON = EngineProgram(
    command=HOST,
    failure=lambda text, _: PlantFailed(text),
    explain=lambda *_: "its output is in that of the node",
    # A process with threads, such as those of linear algebra libraries, cannot be forked.
    environment=dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    prints=True,
    leads_session=True,
)

CLOSE_S = 1.0
"""Time that the `close` of a plant may take; a node ends within two seconds."""


@dataclass(frozen=True, slots=True)
class ClassPlan:
    """A class that has been checked.

    Attributes:
        plant: file or module, and class.
        arguments: of the class, JSON built-ins.
        forkable, has_state: whether it can be copied by a fork, or by its state.
        has_close: whether it has something to release at its end.
    """

    plant: str
    arguments: Mapping[str, Any]
    description: PlantDescription
    forkable: bool
    has_state: bool
    has_close: bool = False


def plan_class(
    plant: str, arguments: Mapping[str, Any], unresponsive_s: float, *, own_class: bool = False
) -> ClassPlan:
    """Check a plant's class and describe it, in a process of its own.

    Args:
        plant: `FILE.py:CLASS` or `MODULE:CLASS`.
        arguments: of the class, JSON built-ins.
        unresponsive_s: time after which a process that does not use processor time is killed.
        own_class: reject a class that the file or the module only imports.

    Raises:
        InvalidConfig: there is no such class, it does not take the arguments, or it lacks something; lists all errors.
        PlantFailed: its code raised an error; the text has the traceback.
        EngineDied, EngineUnresponsive: the process ended, or does not answer.
    """
    request = json.dumps({"plant": plant, "arguments": dict(arguments), "own_class": own_class, "parent": os.getpid()})
    environment = {**os.environ, **PYTHON.environment}
    process = subprocess.Popen(
        [*HOST, "describe"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,  # Ctrl-C in the terminal is for the node
    )
    with process:
        try:
            output = _communicate(process, request + "\n", plant, unresponsive_s)
        finally:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)  # with what the class has started
            process.wait()  # after a KeyboardInterrupt, `with` does not wait
    try:
        fields = json.loads(output)
    except ValueError:
        raise EngineDied(f"plant {plant!r} could not be created: its process {_end(process.returncode)}") from None
    if "error" in fields:
        raise errors.from_wire(fields)
    description = replace(_describe(fields), provenance=_provenance(plant, arguments, fields["file"]))
    return ClassPlan(plant, dict(arguments), description, fields["forkable"], fields["has_state"], fields["has_close"])


def _provenance(plant: str, arguments: Mapping[str, Any], source: str) -> Provenance:
    """Name the class and the file that defines it, `source`; modules that it imports are not among the files."""
    place, name = split_name(plant)
    is_file = place.endswith(".py")
    file = Path(place if is_file else source).absolute()
    files = {"class": file} if is_file or source.endswith(".py") else {}
    path = f"{file}:{name}" if is_file else plant
    return Provenance("python", {"plant": path, "plant_arguments": dict(arguments)}, files)


def _end(code: int) -> str:
    return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"


def _communicate(process: subprocess.Popen[str], request: str, plant: str, unresponsive_s: float) -> str:
    watch, last_s = IdleWatch(process.pid), monotonic()
    text: str | None = request
    while True:
        try:
            return process.communicate(text, timeout=LOOK_S)[0]
        except subprocess.TimeoutExpired:
            text, waited_s, last_s = None, monotonic() - last_s, monotonic()
        if watch.look(min(waited_s, 2.0 * LOOK_S)) >= unresponsive_s:
            raise EngineUnresponsive(
                f"plant {plant!r} could not be created: its process used no processor time for {unresponsive_s:g} s"
            )


def _describe(fields: Mapping[str, Any]) -> PlantDescription:
    def measured(points: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        return [{name: point[name] for name in ("name", "unit", "low", "high")} for point in points]

    actuators = tuple(Actuator(**point) for point in fields["actuators"])
    actions = tuple(Action(name=a.name, unit=a.unit, low=a.low, high=a.high, actuators=(a.name,)) for a in actuators)
    return PlantDescription(
        name=fields["name"],
        run_period=RunPeriod(datetime.fromisoformat(fields["begin"]), fields["step_s"], fields["steps"]),
        sensors=tuple(Sensor(**point) for point in measured(fields["sensors"])),
        meters=tuple(Meter(**point) for point in measured(fields["meters"])),
        actuators=actuators,
        versions=Versions(zenostat=VERSION),
        task=Task(
            scenario=fields["name"],
            time=tuple(TimeField(field) for field in fields["time"]),
            actions=actions,
            reward=fields["reward"],
        ),
        without_geometry=f"the plant {fields['name']!r} is a Python class, which has no geometry",
    )


class PythonEngines(EngineGroup):
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

    def site(self, slot: int) -> Site:  # noqa: ARG002
        """Return an empty site: the class has no weather that the node knows of."""
        return Site()

    def notes(self, slot: int) -> list[str]:  # noqa: ARG002
        """Return no texts."""
        return []

    def weather(self, slot: int, columns: Sequence[str]) -> WeatherTable:  # noqa: ARG002
        """Raise `RequestRejected`."""
        raise without_weather()

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> PythonEngines:
        """Copy the processes of some slots; see `RunningPlant.fork`."""
        copies = self._copy_all(self.members(slots, baseline=baseline), folder)
        copy = PythonEngines(self._plan, self._copy_cpus)
        copy.adopt(copies, self, slots)
        return copy

    def _copy_all(self, clients: Sequence[EngineClient], folder: Path) -> list[EngineClient]:
        if not self._plan.forkable and not self._plan.has_state:
            raise ForkFailed(
                f"plant {self._plan.plant!r} cannot be copied: give its class save() and restore(state), or "
                "forkable = True if its process has no threads and no connections"
            )
        return start_all(clients, lambda client: self._copy(client, folder / str(next(self._numbers))))

    def _copy(self, client: EngineClient, folder: Path) -> EngineClient:
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise ForkFailed(f"the node has no room for a copy's files: {error}") from None
        spec = replace(client.spec, folder=folder, cpus=self._copy_cpus, poll=False)
        if self._plan.forkable:
            copy = client.fork(replace(spec, close_s=0.0))  # what is to be released belongs to the original
        else:
            state = folder / "state.pickle"
            client.save(state)
            copy = EngineClient(replace(spec, run={**spec.run, "state": str(state)}), registry=client.registry)
        _receive(copy)
        return copy


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
        return [
            EpisodeStart(engine_start=EngineStart.RESET if self._runs(slot) else EngineStart.STARTED, weather="")
            for slot in slots
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
        else:
            for clients in (self.clients, self.baselines):
                self._restart(clients, slots)
        self.begin(slots)

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
        self.end()
