"""A wrapper that adds the simulated time as points on circles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import date, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from agent_sdk.wrappers.names import indices_of
from topics.messages import TimeField

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


def cyclic(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sine and cosine of fractions of a turn.

    Args:
        parts: fractions, 0 to 1, shape (…, n).

    Returns:
        Shape (…, 2 n), sine and cosine of each fraction side by side.
    """
    turn = 2 * np.pi * parts
    pairs: NDArray[np.float64] = np.stack([np.sin(turn), np.cos(turn)], axis=-1)
    return pairs.reshape(*parts.shape[:-1], -1)


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, fields: Sequence[str] = FIELDS, *, replace: bool = True) -> None:
        super().__init__(view)
        indices_of(fields, FIELDS, view.wrapper_name, "field")
        manifest = view.manifest
        self._timestep = timedelta(hours=1 / manifest.steps_per_hour)
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

    logic = _Logic
