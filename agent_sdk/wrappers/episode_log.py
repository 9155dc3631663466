"""A file for each episode."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ResetBatch, StepBatch, Values, WrapperLogic
from agent_sdk.wrappers.extras import load
from agent_sdk.wrappers.names import refuse_inside
from agent_sdk.wrappers.table_writers import Cell, CsvWriter, ParquetWriter, Writer
from topics.errors import InvalidConfig

FORMATS = ("csv", "parquet")


class _Logic(WrapperLogic):
    def __init__(self, view: EnvView, folder: str | Path, format: Literal["csv", "parquet"] = "csv") -> None:  # noqa: A002
        super().__init__(view)
        if format not in FORMATS:
            raise InvalidConfig(f"{view.who}: no format {format!r}; csv or parquet")
        if format == "parquet":
            load("pyarrow", "parquet", view.who)
        refuse_inside(view.env, ["RewardVector"], f"{view.who} logs a number as reward; put it before {{}}")
        self._folder, self._format = Path(folder), format
        self._folder.mkdir(parents=True, exist_ok=True)
        self._open: dict[int, tuple[Writer, str]] = {}
        self._rewards: dict[int, tuple[list[str], list[str]]] = {}
        self._columns = [f"observation.{name}" for name in view.names] + [f"action.{n}" for n in _parts(view)]
        self._applied = [f"applied.{actuator.name}" for actuator in view.manifest.actuators]

    def start(self, start: ResetBatch) -> Values:
        """See `WrapperLogic`."""
        for slot in start.slots:
            self._finish(slot, "-left")
        return start.observations

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        """See `WrapperLogic`."""
        for row, slot in enumerate(step.slots):
            terms = step.infos.get(row, "reward_terms") or {}
            measures = step.infos.get(row, "reward_metrics") or {}
            if slot not in self._open:
                self._begin(slot, terms, measures)
            self._open[slot][0].row(self._cells(row, slot, step, terms, measures))
            if step.ends[row]:
                self._finish(slot, "")
        return step.observations, step.rewards

    def _cells(
        self, row: int, slot: int, step: StepBatch, terms: Mapping[str, float], measures: Mapping[str, float]
    ) -> list[Cell]:
        effective = np.asarray(step.infos.get(row, "effective"), np.float64).tolist()
        named_terms, named_measures = self._rewards[slot]
        return [
            step.infos.get(row, "time"),
            *np.ravel(step.observations[row]).tolist(),
            *np.ravel(step.actions[row]).tolist(),
            *effective,
            float(step.rewards[row]),
            *(_number(terms.get(name)) for name in named_terms),
            *(_number(measures.get(name)) for name in named_measures),
        ]

    def _begin(self, slot: int, terms: Mapping[str, float], measures: Mapping[str, float]) -> None:
        self._rewards[slot] = (list(terms), [name for name, value in measures.items() if np.ndim(value) == 0])
        rewards = [f"reward.{n}" for n in terms] + [f"measure.{n}" for n in self._rewards[slot][1]]
        columns = ["time", *self._columns, *self._applied, "reward", *rewards]
        name = self._next(slot)
        hidden = self._folder / f".{name}.{self._format}"
        if self._format == "csv":
            self._open[slot] = CsvWriter(columns, hidden), name
        else:
            self._open[slot] = ParquetWriter(columns, hidden, ["time"], self.view.who), name

    def _next(self, slot: int) -> str:
        prefix = f"slot-{slot:02d}-episode-" if self.view.vector else "episode-"
        found = (re.match(rf"\.?{prefix}(\d+)", file.name) for file in self._folder.iterdir())
        return f"{prefix}{max((int(m[1]) for m in found if m), default=0) + 1:06d}"

    def _finish(self, slot: int, how: str) -> None:
        if slot in self._open:
            writer, name = self._open.pop(slot)
            writer.finish(self._folder / f"{name}{how}.{self._format}")

    def close(self) -> None:
        """See `WrapperLogic`."""
        for slot in list(self._open):
            self._finish(slot, "-left")


def _number(told: Any) -> float | None:
    """Empty where a reward of one's own has no such term in this timestep."""
    return None if told is None else float(told)


def _parts(view: EnvView) -> list[str]:
    """A name for each number of an action."""
    space: Any = view.action_space
    names = list(view.action_names)
    if isinstance(space, Box) and space.shape == (len(names),):
        return names
    count = int(np.prod(space.shape or (1,)))
    return ["choice"] if count == 1 else [f"choice_{i}" for i in range(count)]


class EpisodeLog(BuildingWrapper):
    """Writes a table for each episode: `episode-000001.csv`; of a vector, `slot-00-episode-000001.csv`.

    A row is a timestep: `time` (of its end), each observation by name as this wrapper gives it (`observation.`),
    the action that it was given (`action.`), what each actuator really was (`applied.`), `reward`, and its terms
    and measures (`reward.`, `measure.`). An episode of N steps has N rows; sample 0 is none. An episode that is
    left early ends in `episode-000001-left.csv`; its rows are whole. A file has its name only when it is closed,
    and hides behind a dot until then. Numbers go on after the files that the folder has.

    Args:
        folder: where to; it is made.
        format: `csv`, or `parquet` (needs the extra `parquet`).

    Raises:
        InvalidConfig: no such format, the extra is missing, or a `RewardVector` within.
    """

    logic = _Logic
