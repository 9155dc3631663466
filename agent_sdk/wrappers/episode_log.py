"""A wrapper that writes one table per episode."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, ResetBatch, StepBatch, Values, WrapperLogic
from zenostat.agent_sdk.wrappers.names import reject_wrappers, require_each_timestep
from zenostat.agent_sdk.wrappers.table_writers import Cell, CsvWriter, ParquetWriter, Writer
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import import_extra

FORMATS = ("csv", "parquet")


class _Logic(WrapperLogic):
    def __init__(self, view: EnvView, folder: str | Path, format: Literal["csv", "parquet"] = "csv") -> None:  # noqa: A002
        super().__init__(view)
        if format not in FORMATS:
            raise InvalidConfig(f"{view.wrapper_name}: there is no format {format!r}; use csv or parquet")
        if format == "parquet":
            import_extra("pyarrow", "parquet", view.wrapper_name)
        reject_wrappers(view.env, ["RewardVector"], f"{view.wrapper_name} logs a scalar reward; apply it before {{}}")
        require_each_timestep(view.env, view.wrapper_name)
        self._folder, self._format = _created(folder, view.wrapper_name), format
        self._open: dict[int, tuple[Writer, str]] = {}
        self._rewards: dict[int, list[str]] = {}
        self._columns = [f"observation.{name}" for name in view.names] + [f"action.{n}" for n in _action_columns(view)]
        self._effective = [f"effective.{actuator.name}" for actuator in view.manifest.actuators]

    def start(self, start: ResetBatch) -> Values:
        for slot in start.slots:
            self._finish(slot, "-left")
        return start.observations

    def step(self, step: StepBatch) -> tuple[Values, Values]:
        for row, slot in enumerate(step.slots):
            numbers = _reward_numbers(step, row)
            if slot not in self._open:
                self._begin(slot, numbers)
            elif added := [name for name in numbers if name not in self._rewards[slot]]:
                self._rewards[slot] += added
                self._open[slot][0].extend(added)
            self._open[slot][0].row(self._cells(row, slot, step, numbers))
            if step.ends[row]:
                self._finish(slot, "")
        return step.observations, step.rewards

    def _cells(self, row: int, slot: int, step: StepBatch, numbers: Mapping[str, float]) -> list[Cell]:
        effective = np.asarray(step.infos.get(row, "effective"), np.float64).tolist()
        return [
            step.infos.get(row, "time"),
            *np.ravel(step.observations[row]).tolist(),
            *np.ravel(step.actions[row]).tolist(),
            *effective,
            float(step.rewards[row]),
            *(numbers.get(name) for name in self._rewards[slot]),
        ]

    def _begin(self, slot: int, numbers: Mapping[str, float]) -> None:
        self._rewards[slot] = list(numbers)
        columns = ["time", *self._columns, *self._effective, "reward", *numbers]
        name = self._next_name(slot)
        hidden = self._folder / f".{name}.{self._format}"
        if self._format == "csv":
            self._open[slot] = CsvWriter(columns, hidden), name
        else:
            self._open[slot] = ParquetWriter(columns, hidden, ["time"], self.view.wrapper_name), name

    def _next_name(self, slot: int) -> str:
        prefix = f"slot-{slot:02d}-episode-" if self.view.vector else "episode-"
        matches = (re.match(rf"\.?{prefix}(\d+)", file.name) for file in self._folder.iterdir())
        return f"{prefix}{max((int(match[1]) for match in matches if match), default=0) + 1:06d}"

    def _finish(self, slot: int, suffix: str) -> None:
        if slot in self._open:
            writer, name = self._open.pop(slot)
            writer.finish(self._folder / f"{name}{suffix}.{self._format}")

    def close(self) -> None:
        for slot in list(self._open):
            self._finish(slot, "-left")


def _created(folder: Any, wrapper_name: str) -> Path:
    try:
        path = Path(folder)
        path.mkdir(parents=True, exist_ok=True)
    except (TypeError, OSError) as error:
        raise InvalidConfig(f"{wrapper_name}: folder={folder!r}; a folder for the tables expected ({error})") from None
    return path


def _reward_numbers(step: StepBatch, row: int) -> dict[str, float]:
    """Return terms and metrics of the reward by column; a custom reward need not have all in each timestep."""
    groups = (("reward", "reward_terms"), ("metric", "reward_metrics"))
    return {
        f"{group}.{name}": float(value)
        for group, key in groups
        for name, value in (step.infos.get(row, key) or {}).items()
        if np.ndim(value) == 0
    }


def _action_columns(view: EnvView) -> list[str]:
    """Return a name for each number of an action."""
    space: Any = view.action_space
    names = list(view.action_names)
    if isinstance(space, Box) and space.shape == (len(names),):
        return names
    count = int(np.prod(space.shape or (1,)))
    return ["choice"] if count == 1 else [f"choice_{i}" for i in range(count)]


class EpisodeLog(BuildingWrapper):
    """Write a table for each episode: `episode-000001.csv`, or `slot-00-episode-000001.csv` in a vector environment.

    Each row is one timestep: `time` (its end), each observation by name as this wrapper returns it (`observation.`),
    the action that it received (`action.`), the effective value of each actuator (`effective.`), `reward`, and its
    terms and metrics (`reward.`, `metric.`). An episode of N steps has N rows; sample 0 has none. An episode that is
    abandoned before its end is written to `episode-000001-left.csv`, with complete rows. A file has a hidden name,
    which begins with a dot, until it is closed. Numbering continues after the files that are already in the folder.

    Args:
        folder: the output folder, which is created if necessary.
        format: `csv`, the default, or `parquet` (needs the extra `parquet`).

    Raises:
        InvalidConfig: there is no such format, the extra is missing, the folder cannot be created, or an inner
            wrapper is a `RewardVector` or repeats actions.
    """

    logic = _Logic
