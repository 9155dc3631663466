"""The interface of a Python class that can be a plant. It is a protocol: a plant need not import anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

PointSpec = str | Sequence[str | float | None]
"""A unit, or a unit with bounds: `"degC"`, `("degC", 0.0, 100.0)`; None is no bound.

A sensor's aggregation may follow, such as `("W", 0.0, None, "mean")`, and an actuator's default."""


class Plant(Protocol):
    """Protocol of a class that can be a plant. `None` as a bound means unbounded.

    Further attributes are optional:

    - `meters`, like `sensors` but without aggregation: consumption in the timestep (J for energy).
    - `begin`: simulated time of sample 0, a `datetime` or `"2026-01-01T00:00"`; by default 2001-01-01, a Monday.
    - `duration_s`: length of an episode in seconds, a multiple of `step_s`; by default a day.
    - `time`: time features of the observation, such as `("hour",)`; see `zenostat.topics.messages.TimeField`.
    - `reward`: the reward of `gym.make`, a kind with its parameters.
    - `actions`: names of the actuators that are an agent's actions; by default all.
    - `model_name`: name of what is simulated, in the manifest; by default that of the class.
    - `files`: paths of the files that define what is simulated, by role; a recording keeps their digests.
    - `warnings`: texts for the manifest, which users see once.
    - `begins_alike`: True if all episodes begin alike, whatever their seed. With `forkable`, each reset is then a fork
      of the first sample 0 in place of a call of `reset`.
    - `drain_warnings()`: returns the warnings of the timestep as a list of texts, for events; called after each `reset`
      and `step`.
    - `forkable`: True if the process may be forked while it waits (no threads, no connections); snapshots and branches
      then take milliseconds.
    - `save()`, which returns a state that can be pickled, and `restore(state)`: for snapshots and branches of plants
      that cannot be forked, and for trials without a fork. `restore` is called on a new instance, without `reset`, and
      in trials on one that has gone on since: it has to replace all that a step depends on.
    - `close()`: releases what the instance holds (processes, files, connections); called once, when its process is
      ended, and must return within a second. Not called if the process is killed, or in a forked copy.

    Attributes:
        step_s: length of a timestep in seconds.
        sensors: unit and bounds of each measured point, by name, and optionally its aggregation: `instant` (default),
            `mean` or `sum`.
        actuators: unit, low, high and optionally a default of each point that can be commanded, by name.
    """

    step_s: float
    sensors: Mapping[str, PointSpec]
    actuators: Mapping[str, PointSpec]

    def reset(self, seed: int) -> Mapping[str, float]:
        """Begin an episode; return the values of all sensors and meters at sample 0.

        Args:
            seed: from 0 to 2**64 - 1; equal seeds must give equal episodes.
        """

    def step(self, commands: Mapping[str, float]) -> Mapping[str, float]:
        """Simulate a timestep; return the values of all sensors and meters at its end.

        Args:
            commands: values of the actuators, within their bounds. An actuator that nobody commands has its default,
                or is missing if it has none.
        """
