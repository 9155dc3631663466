"""Trials of a whole district, each step of which is one trial in the node of each plant.

A trial of a few timesteps needs neither snapshots nor branches: every plant tries from its present sample, with the
commands of all timesteps of the trial so far. Only the orchestration is copied. Its loops and markets try as they do in
a step of the district, so the samples are those of this step to the bit.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from zenostat.cosim.coupled import LOST, CoupledPlant, GuardedPlant, Rows
from zenostat.cosim.file import OnLost
from zenostat.cosim.market_plant import MarketPlant
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import EngineDied, ForkFailed, SimulatorError

if TYPE_CHECKING:
    from zenostat.cosim.run import RunState
    from zenostat.topics.messages import Manifest

MAX_TIMESTEPS = 6
"""Longest trial that is simulated so: each of its timesteps repeats the earlier ones. Longer ones take a branch."""

MAX_PLANT_TIMESTEPS = 48
"""Greatest number of a plant's own timesteps in a trial of several timesteps, so that a reply has room for them."""


def is_short(timesteps: int, step_s: float, plants: Mapping[str, GuardedPlant]) -> bool:
    """Return whether a trial of so many timesteps of `step_s` is to be simulated by trials of these plants."""
    shortest_s = min(plant.plant.manifest.step_s for plant in plants.values())
    return timesteps == 1 or timesteps <= min(MAX_TIMESTEPS, MAX_PLANT_TIMESTEPS * shortest_s / step_s)


class _Requests:
    """The steps that the slots of a trial have begun: one request to each plant has those of all slots.

    Each plant is for one thread; loops that are solved at the same time have plants of their own.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._begun: dict[str, tuple[CoupledPlant, list[tuple[TriedPlant, Floats]]]] = {}
        self._sent: dict[str, tuple[CoupledPlant, list[TriedPlant]]] = {}
        self._results: dict[TriedPlant, Rows] = {}
        self._errors: dict[str, Exception] = {}

    def add(self, name: str, plant: CoupledPlant, tried: TriedPlant, commands: Floats) -> None:
        """Add the commands of a slot, from the present sample on."""
        with self._lock:
            self._begun.setdefault(name, (plant, []))[1].append((tried, commands))

    def result(self, name: str, tried: TriedPlant) -> Rows:
        """Return the samples of a slot; the requests to all plants are sent before the first one is waited for."""
        with self._lock:
            if tried in self._results:
                return self._results.pop(tried)
            if name not in self._sent:
                self._send()
            if name in self._errors:
                raise self._errors[name]
            plant, slots = self._sent.pop(name)
        rows = dict(zip(slots, plant.finish_trial(), strict=True))
        with self._lock:
            self._results |= rows
            return self._results.pop(tried)

    def _send(self) -> None:
        begun, self._begun = self._begun, {}
        for name, (plant, orders) in begun.items():
            try:
                plant.begin_trial([commands for _, commands in orders])
            except LOST as error:
                self._errors[name] = error
                continue
            self._sent[name] = plant, [tried for tried, _ in orders]


class TriedPlant:
    """A plant in a slot of a trial, which stays at its sample; implements `zenostat.cosim.coupled.CoupledPlant`.

    Args:
        name: of the plant.
        plant: that tries.
        requests: of all slots.
    """

    def __init__(self, name: str, plant: CoupledPlant, requests: _Requests) -> None:
        self._name, self._plant, self._requests = name, plant, requests
        self._taken: list[Floats] = []  # commands of the steps of this trial
        self._steps = 0  # timesteps of the step that is tried

    @property
    def manifest(self) -> Manifest:
        """Manifest of its node."""
        return self._plant.manifest

    def reset(self, seed: int) -> Rows:  # noqa: ARG002
        """Raise `EngineDied`: a trial has no other episode."""
        raise EngineDied("a trial cannot be reset")

    def begin(self, commands: Floats) -> None:
        """Begin the next step of the trial."""
        self._taken.append(commands)
        self._requests.add(self._name, self._plant, self, np.concatenate(self._taken))

    def finish(self) -> Rows:
        """Return its samples."""
        return _last(self._requests.result(self._name, self), len(self._taken[-1]))

    def begin_trial(self, commands: Sequence[Floats]) -> None:
        """Begin to try the next step of the trial."""
        self._steps = len(commands[0])
        self._plant.begin_trial([np.concatenate([*self._taken, rows]) for rows in commands])

    def finish_trial(self) -> list[Rows]:
        """Return the samples of each alternative."""
        return [_last(rows, self._steps) for rows in self._plant.finish_trial()]

    def cancel_trial(self) -> None:
        """Make `finish` raise soon; thread-safe."""
        self._plant.cancel_trial()

    interrupt = cancel_trial

    def is_reachable(self) -> bool:
        """Return False: a trial does not wait for a plant that is lost."""
        return False

    def drain_warnings(self) -> list[str]:
        """Return no texts."""
        return []

    def close(self) -> None:
        """Do nothing: the plant goes on."""


def _last(rows: Rows, timesteps: int) -> Rows:
    return Rows(rows.values[-timesteps:], rows.effective[-timesteps:])


class _GuardedTrial(GuardedPlant):
    """A plant in a trial, which ends with the first error."""

    def _failure(self, error: Exception) -> SimulatorError:
        if isinstance(error, ForkFailed):
            return ForkFailed(f"plant {self.name!r} cannot try a step: {error}")
        return super()._failure(error)


class PlantTrials:
    """The plants of a district, for trials from the present sample; see `zenostat.cosim.copies.PlantSource`.

    Args:
        plants: by name; they must not step as long as this is used.

    Raises:
        ForkFailed: a plant is lost.
    """

    def __init__(self, plants: Mapping[str, GuardedPlant]) -> None:
        for name, plant in plants.items():
            if not plant.is_available:
                raise ForkFailed(f"plant {name!r} is lost, and a trial has all plants or none")
        self._plants = {name: plant.plant for name, plant in plants.items()}
        self._requests = _Requests()

    def __len__(self) -> int:
        """Return the number of plants."""
        return len(self._plants)

    def branches(self, stop: threading.Event, state: RunState) -> dict[str, GuardedPlant]:  # noqa: ARG002
        """Return each plant as one that tries; the state is that of the present sample."""
        return {
            name: _GuardedTrial(
                name,
                plant.branch("") if isinstance(plant, MarketPlant) else TriedPlant(name, plant, self._requests),
                OnLost.STOP,
                timeout_s=0.0,
                stop=stop,
            )
            for name, plant in self._plants.items()
        }

    def use(self) -> PlantTrials:
        """Raise `ForkFailed`: these plants are at the present sample, and not at that of a copy."""
        raise ForkFailed("a trial has no copies")

    def release(self) -> None:
        """Do nothing: nothing is held."""
