"""The clock as points on circles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import date, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from agent_sdk.wrappers.names import places
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
_SAID_BY = {
    "hour": (TimeField.HOUR, TimeField.MINUTES, TimeField.CURRENT_TIME),
    "day_of_week": (TimeField.DAY_OF_WEEK,),
    "day_of_year": (TimeField.DAY_OF_YEAR, TimeField.MONTH, TimeField.DAY_OF_MONTH),
}


def cyclic(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sine and cosine of parts of a turn, 0 to 1, shape (…, n); shape (…, 2 n), each pair side by side."""
    turn = 2 * np.pi * parts
    pairs: NDArray[np.float64] = np.stack([np.sin(turn), np.cos(turn)], axis=-1)
    return pairs.reshape(*parts.shape[:-1], -1)


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, fields: Sequence[str] = FIELDS, *, replace: bool = True) -> None:
        super().__init__(view)
        places(fields, FIELDS, view.who, "field")
        manifest = view.manifest
        self._timestep = timedelta(hours=1 / manifest.steps_per_hour)
        self._parts = [_PARTS[field] for field in fields]
        said = {same for field in fields for same in _SAID_BY[field]} & set(manifest.task.time) if replace else set()
        self._kept = [i for i, name in enumerate(view.names) if name not in said]
        added = [f"{field}_{of}" for field in fields for of in ("sin", "cos")]
        ones = np.ones(len(added), np.float32)
        self.extend(added, -ones, ones, self._kept)

    def observe(self, seen: ResetBatch | StepBatch, *, begins: bool) -> Values:
        """See `ObservationLogic`."""
        infos = seen.infos
        times = [
            infos.time(row) - (timedelta(0) if begins and not infos.step(row) else self._timestep)
            for row in range(len(seen.slots))
        ]
        parts = np.array([[part(time) for part in self._parts] for time in times], np.float64)
        return append(seen.observations[:, self._kept], cyclic(parts))


class CyclicTime(BuildingWrapper):
    """Appends sine and cosine of the hour, the day of the week and the day of the year, each from -1 to 1.

    They are of the begin of the timestep that a sample closes, as the clock's fields are (of the episode's begin
    at sample 0). The hour turns with its minutes; a week begins on Sunday, a year on 1 January.

    Args:
        fields: which of `hour`, `day_of_week`, `day_of_year`; `hour` gives `hour_sin` and `hour_cos`.
        replace: takes the clock's fields that say the same out of the observation.

    Raises:
        InvalidConfig: no such field.
    """

    logic = _Logic
