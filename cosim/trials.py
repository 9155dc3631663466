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

from zenostat.cosim.coupled import CoupledPlant, Floats, GuardedPlant, Rows
from zenostat.cosim.file import OnLost
from zenostat.cosim.market_plant import MarketPlant
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


class TriedPlant:
    """A plant in a trial, which stays at its sample; implements `zenostat.cosim.coupled.CoupledPlant`.

    Args:
        plant: that tries.
    """

    def __init__(self, plant: CoupledPlant) -> None:
        self._plant = plant
        self._taken: list[Floats] = []  # commands of the steps of this trial
        self._steps = 0  # timesteps of the step or of the trial of one that is pending

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
        self._steps = len(commands)
        self._plant.begin_trial([np.concatenate(self._taken)])

    def finish(self) -> Rows:
        """Return its samples."""
        (rows,) = self.finish_trial()
        return rows

    def begin_trial(self, commands: Sequence[Floats]) -> None:
        """Begin to try the next step of the trial."""
        self._steps = len(commands[0])
        self._plant.begin_trial([np.concatenate([*self._taken, rows]) for rows in commands])

    def finish_trial(self) -> list[Rows]:
        """Return the samples of each alternative."""
        last = slice(-self._steps, None)
        return [Rows(rows.values[last], rows.effective[last]) for rows in self._plant.finish_trial()]

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

    def __len__(self) -> int:
        """Return the number of plants."""
        return len(self._plants)

    def branches(self, stop: threading.Event, state: RunState) -> dict[str, GuardedPlant]:  # noqa: ARG002
        """Return each plant as one that tries; the state is that of the present sample."""
        return {
            name: _GuardedTrial(
                name,
                plant.branch("") if isinstance(plant, MarketPlant) else TriedPlant(plant),
                OnLost.STOP,
                timeout_s=0.0,
                stop=stop,
            )
            for name, plant in self._plants.items()
        }

    def use(self) -> PlantTrials:
        """Return these plants."""
        return self

    def release(self) -> None:
        """Do nothing: nothing is held."""
