"""Wrappers that add, remove or combine values of the observation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import date, datetime, timedelta
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from zenostat.agent_sdk.wrappers.names import indices_of, require_mapping, require_units
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import TimeField

FIELDS = ("hour", "day_of_week", "day_of_year")


def _year_part(time: datetime) -> float:
    day = time.timetuple().tm_yday
    return (day - 1) / date(time.year, 12, 31).timetuple().tm_yday


_PARTS: dict[str, Callable[[datetime], float]] = {
    "hour": lambda t: (t.hour + t.minute / 60 + t.second / 3600) / 24,
    "day_of_week": lambda t: t.isoweekday() % 7 / 7,
    "day_of_year": _year_part,
}
_EQUIVALENT_FIELDS = {
    "hour": (TimeField.HOUR, TimeField.MINUTES, TimeField.CURRENT_TIME),
    "day_of_week": (TimeField.DAY_OF_WEEK,),
    "day_of_year": (TimeField.DAY_OF_YEAR, TimeField.MONTH, TimeField.DAY_OF_MONTH),
}


def cyclic(parts: Floats) -> Floats:
    """Return the sine and cosine of fractions of a turn.

    Args:
        parts: fractions, 0 to 1, shape (…, n).

    Returns:
        Shape (…, 2 n), sine and cosine of each fraction side by side.
    """
    turn = 2 * np.pi * parts
    pairs: Floats = np.stack([np.sin(turn), np.cos(turn)], axis=-1)
    return pairs.reshape(*parts.shape[:-1], -1)


class _CyclicTimeLogic(ObservationLogic):
    def __init__(self, view: EnvView, fields: Sequence[str] = FIELDS, *, replace: bool = True) -> None:
        super().__init__(view)
        indices_of(fields, FIELDS, view.wrapper_name, "field")
        manifest = view.manifest
        self._timestep = manifest.timestep
        self._parts = [_PARTS[field] for field in fields]
        equivalent = {name for field in fields for name in _EQUIVALENT_FIELDS[field]}
        replaced = equivalent & set(manifest.task.time) if replace else set()
        self._kept = [i for i, name in enumerate(view.names) if name not in replaced]
        added = [f"{field}_{function}" for field in fields for function in ("sin", "cos")]
        ones = np.ones(len(added), np.float32)
        self.extend(added, -ones, ones, self._kept)

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:
        infos = batch.infos
        times = [
            infos.time(row) - (timedelta(0) if is_reset and not infos.step(row) else self._timestep)
            for row in range(len(batch.slots))
        ]
        parts = np.array([[part(time) for part in self._parts] for time in times], np.float64)
        return append(batch.observations[:, self._kept], cyclic(parts))


class CyclicTime(BuildingWrapper):
    """Append the sine and cosine of the hour, the day of the week and the day of the year, each from -1 to 1.

    They refer to the beginning of the timestep that ends with the sample, as the time features do (at sample 0, to the
    beginning of the episode). The hour includes minutes; a week begins on Sunday, a year on 1 January.

    Args:
        fields: any of `hour`, `day_of_week`, `day_of_year`, by default all; `hour` adds `hour_sin` and `hour_cos`.
        replace: whether to remove the equivalent time features from the observation; True by default.

    Raises:
        InvalidConfig: there is no such field.
    """

    logic = _CyclicTimeLogic


class _PreviousLogic(ObservationLogic):
    def __init__(self, view: EnvView, names: Sequence[str]) -> None:
        super().__init__(view)
        box = view.box
        self._indices = indices_of(names, view.names, view.wrapper_name)
        self.extend([f"previous_{name}" for name in names], box.low[self._indices], box.high[self._indices])
        self._before = np.zeros((view.slots, len(self._indices)), np.float32)

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:
        now = batch.observations[:, self._indices]
        before = now if is_reset else self._before[batch.slots]
        self._before[batch.slots] = now
        return append(batch.observations, before)

    def get_state(self) -> list[dict[str, Any]]:
        return [{"before": row} for row in self._before.tolist()]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        rows = np.array([state["before"] for state in slots], np.float32)
        self._before[:] = rows.reshape(self._before.shape)


class PreviousObservation(BuildingWrapper):
    """Append the values of named observations one step ago, named `previous_` and the name.

    At sample 0, which has no previous sample, they are the current values.

    Args:
        names: names of observations, in the order in which to append them.

    Raises:
        InvalidConfig: the observation does not have one of the names.
    """

    logic = _PreviousLogic


class _MetricLogic(ObservationLogic):
    def __init__(self, view: EnvView, metrics: Sequence[str]) -> None:
        super().__init__(view)
        indices_of(metrics, metrics, view.wrapper_name, "metric")
        if not metrics:
            raise InvalidConfig(f"{view.wrapper_name}: name at least one metric")
        self._metrics = list(metrics)
        infinite = np.full(len(metrics), np.inf, np.float32)
        self.extend(self._metrics, -infinite, infinite)
        self._latest = np.zeros((view.slots, len(metrics)))

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:
        for row, slot in enumerate(batch.slots):
            if not is_reset:
                self._latest[slot] = self._read(batch.infos.get(row, "reward_metrics") or {})
            elif not batch.infos.step(row):  # at a snapshot, the values are those of its state
                self._latest[slot] = 0.0
        return append(batch.observations, self._latest[batch.slots])

    def _read(self, metrics: Mapping[str, Any]) -> list[float]:
        unknown = [name for name in self._metrics if name not in metrics]
        if unknown:
            raise InvalidConfig(
                f"{self.view.wrapper_name}: the reward has no metric {unknown[0]!r}; "
                + did_you_mean(unknown[0], metrics)
            )
        return [float(metrics[name]) for name in self._metrics]

    def get_state(self) -> list[dict[str, Any]]:
        return [{"latest": row} for row in self._latest.tolist()]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        self._latest[:] = np.array([state["latest"] for state in slots]).reshape(self._latest.shape)


class MetricObservation(BuildingWrapper):
    """Append metrics of the reward, such as `peak_kw`, the month's peak demand so far; 0 at the start of an episode.

    A reward with a demand charge depends on the peak so far. With this observation it is a function of what the agent
    observes and does.

    Args:
        metrics: names of entries of `info["reward_metrics"]`.

    Raises:
        InvalidConfig: no metric is named; or, at the first step, the reward does not have one of them.
    """

    logic = _MetricLogic


class _ReducedLogic(ObservationLogic):
    def __init__(self, view: EnvView, keep: Sequence[str]) -> None:
        super().__init__(view)
        if not keep:
            raise InvalidConfig(f"{view.wrapper_name}: keep at least one of {', '.join(view.names)}")
        box = view.box
        self._kept = indices_of(keep, view.names, view.wrapper_name)
        self._dropped = {name: i for i, name in enumerate(view.names) if name not in keep}
        self.observation_names = tuple(keep)
        low, high = box.low[self._kept].astype(np.float32), box.high[self._kept].astype(np.float32)
        self.observation_space = Box(low, high, dtype=np.float32)

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:  # noqa: ARG002  # resets are no different
        self.added = {"dropped": {name: batch.observations[:, i] for name, i in self._dropped.items()}}
        return batch.observations[:, self._kept].astype(np.float32)


class ReducedObservation(BuildingWrapper):
    """Keep the named observations, in the given order; `info["dropped"]` has the others by name.

    Args:
        keep: names of the observations to keep.

    Raises:
        InvalidConfig: the observation does not have one of the names, or `keep` is empty.
    """

    logic = _ReducedLogic


class _DifferenceLogic(ObservationLogic):
    def __init__(self, view: EnvView, pairs: Mapping[str, Sequence[str]]) -> None:
        super().__init__(view)
        require_units(view.env, view.wrapper_name)
        require_mapping(pairs, f"{view.wrapper_name}: pairs", "{name: [temperature, setpoint]}")
        for name, pair in pairs.items():
            if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 2:
                raise InvalidConfig(
                    f"{view.wrapper_name}: {name!r} should be a pair, [temperature, setpoint]; not {pair!r}"
                )
        box, names = view.box, view.names
        self._temperatures = [i for pair in pairs.values() for i in indices_of(pair[:1], names, view.wrapper_name)]
        self._setpoints = [i for pair in pairs.values() for i in indices_of(pair[1:], names, view.wrapper_name)]
        low = box.low[self._temperatures] - box.high[self._setpoints]
        self.extend(list(pairs), low, box.high[self._temperatures] - box.low[self._setpoints])

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:  # noqa: ARG002  # resets are no different
        values = batch.observations.astype(np.float32, copy=False)
        return append(values, values[..., self._temperatures] - values[..., self._setpoints])


class SetpointDifference(BuildingWrapper):
    """Append temperatures minus their setpoints, in K, for pairs of named observations.

    Args:
        pairs: (temperature, setpoint), both names of observations, by the name of the new value.

    Raises:
        InvalidConfig: the observation does not have one of the names, `pairs` has another form, or an inner wrapper
            changes the units of the values.
    """

    logic = _DifferenceLogic
