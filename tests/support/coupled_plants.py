"""Plants of a district without processes: functions of commands and states, for rules of the orchestration."""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zenostat.cosim.binding import Binding, bind
from zenostat.cosim.coupled import GuardedPlant, Rows
from zenostat.cosim.file import DistrictFile, OnLost, read_district
from zenostat.cosim.orchestrator import Orchestrator
from zenostat.cosim.topology import check_file
from zenostat.topics import VERSION
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import NodeLost
from zenostat.topics.messages import Actuator, Manifest, Meter, Mode, Policy, Sensor, Versions

Step = Callable[[list[float], list[float]], tuple[list[float], list[float]]]
"""A timestep: of state and commands, the next state and the values."""


def manifest_of(
    sensors: Mapping[str, str],
    actuators: Mapping[str, tuple[str, float | None, float | None]],
    *,
    meters: Mapping[str, str] | None = None,
    step_s: float = 900.0,
    steps: int = 96,
    **fields: Any,
) -> Manifest:
    """A manifest with points by name and unit; actuators also have bounds."""
    return Manifest(
        node="node",
        instance="1",
        building="fake",
        begin=fields.pop("begin", "2001-01-01T00:00:00"),
        end="2001-01-02T00:00:00",
        step_s=step_s,
        steps=steps,
        mode=Mode.LOCKSTEP,
        policy=Policy.WAIT,
        sensors=tuple(Sensor(name=name, unit=unit) for name, unit in sensors.items()),
        meters=tuple(Meter(name=name, unit=unit) for name, unit in (meters or {}).items()),
        actuators=tuple(Actuator(name=name, unit=u, low=low, high=high) for name, (u, low, high) in actuators.items()),
        versions=Versions(zenostat=VERSION),
        **fields,
    )


class FakeCoupled:
    """A coupled plant that is a function of its state and its commands.

    Args:
        manifest: its points.
        step: a timestep.
        first: state at sample 0.
        values: at sample 0.

    Attributes:
        commands: of each timestep so far.
        tries: number of alternatives that were tried.
        fails_at: number of timesteps after which it is lost, until `is_back`.
        log: names and calls, shared by the plants of a district.
    """

    def __init__(
        self,
        manifest: Manifest,
        step: Step,
        *,
        first: Sequence[float] = (),
        values: Sequence[float] | None = None,
        name: str = "",
        log: list[str] | None = None,
    ) -> None:
        self.manifest, self._step, self._first = manifest, step, [*first]
        self._values = [0.0] * len(manifest.points) if values is None else [*values]
        self.name, self.log = name, [] if log is None else log
        self.commands: list[list[float]] = []
        self.tries = 0
        self.fails_at: int | None = None
        self.is_back = False
        self.seeds: list[int] = []
        self._pending: Floats | None = None
        self._tried: Sequence[Floats] = ()

    def reset(self, seed: int) -> Rows:
        self._check()
        self.seeds.append(seed)
        self._state, self.commands = [*self._first], []
        return Rows(np.array([self._values]), np.full((1, len(self.manifest.actuators)), np.nan))

    def _check(self) -> None:
        if self.fails_at is not None and len(self.commands) >= self.fails_at and not self.is_back:
            raise NodeLost("node 'node' is gone")

    def begin(self, commands: Floats) -> None:
        self.log.append(f"{self.name} begins")
        self._check()
        self._pending = commands

    def finish(self) -> Rows:
        commands = self._pending
        assert commands is not None
        values = []
        for row in commands.tolist():
            self._check()
            self._state, outputs = self._step(self._state, row)
            self.commands.append(row)
            values.append(outputs)
        self.log.append(f"{self.name} ends")
        return Rows(np.array(values), commands)

    def begin_trial(self, commands: Sequence[Floats]) -> None:
        self.log.append(f"{self.name} tries")
        self._check()
        self._tried = commands

    def cancel_trial(self) -> None:
        pass

    def finish_trial(self) -> list[Rows]:
        self._check()
        results = []
        for alternative in self._tried:
            self.tries += 1
            state, values = copy.deepcopy(self._state), []
            for row in alternative.tolist():
                state, outputs = self._step(state, row)
                values.append(outputs)
            results.append(Rows(np.array(values), alternative))
        self.log.append(f"{self.name} has tried")
        return results

    def is_reachable(self) -> bool:
        return self.is_back

    def drain_warnings(self) -> list[str]:
        return []

    def interrupt(self) -> None:
        pass

    close = interrupt


def gain(factor: float, offset: float = 0.0) -> Step:
    """A plant without state: its value is linear in its command, 0 where it is relinquished."""
    return lambda state, row: (state, [factor * np.nan_to_num(row[0]) + offset])


def district_file(folder: Path, text: str) -> DistrictFile:
    """Write a district's file, and read it."""
    path = folder / "district.yaml"
    path.write_text(text)
    return read_district(path)


def orchestrated(
    file: DistrictFile, plants: Mapping[str, FakeCoupled], on_lost: OnLost = OnLost.STOP, **guard: Any
) -> tuple[Orchestrator, Binding, dict[str, GuardedPlant]]:
    """An orchestrator of fake plants at sample 0."""
    binding = bind(file, check_file(file), {name: plant.manifest for name, plant in plants.items()})
    stop = guard.pop("stop", threading.Event())
    guarded = {
        name: GuardedPlant(name, plant, on_lost, timeout_s=guard.get("timeout_s", 60.0), stop=stop, **_retry(guard))
        for name, plant in plants.items()
    }
    orchestrator = Orchestrator(binding, guarded, file.spec.solver)
    orchestrator.start(dict.fromkeys(plants, 7))
    return orchestrator, binding, guarded


def _retry(guard: Mapping[str, Any]) -> dict[str, Any]:
    return {"retry": guard["retry"]} if "retry" in guard else {}


def free(plants: Mapping[str, FakeCoupled], **values: Sequence[float]) -> dict[str, Floats]:
    """Commands that relinquish all actuators but those of the plants that are named."""
    return {
        name: np.array(values[name]) if name in values else np.full(len(plant.manifest.actuators), np.nan)
        for name, plant in plants.items()
    }
