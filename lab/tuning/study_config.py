"""Fields that all tuning files have: search space, sampler, pruner, budget and database."""

from __future__ import annotations

import itertools
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from zenostat.bridge.recording.file import file_digest
from zenostat.lab.config_file import FIELDS, FIELDS_OR_FALSE, ConfigPart, Count, No
from zenostat.topics.errors import InvalidConfig

_Number = Annotated[float, Field(strict=True)]
Sampler = Literal["tpe", "random", "grid", "cma-es"]
Direction = Literal["maximize", "minimize"]
MAX_POINTS = 100_000
"""Largest number of points of a grid, each of which is a trial."""
CONTENT = "content of "
"""Prefix of the path of a file in what must not change while a study exists."""
_TOLERANCE = 1e-9
"""Part of a step by which a multiple of it may be off, for its rounding."""


def default_direction(metric: str) -> Direction:
    """Return whether a metric is to be maximized, as rewards are, or minimized, as energies and discomfort are."""
    return "maximize" if metric.removeprefix("mean_").partition(".")[0] == "reward" else "minimize"


def check_metric(metric: str) -> None:
    """Check that the episodes of a study can have a metric, as far as its name tells.

    Raises:
        InvalidConfig: it needs prices or emission factors.
    """
    if metric in ("kpi.cost_tot", "kpi.emis_tot"):
        raise InvalidConfig(
            f"metric: {metric} needs prices or emission factors, which a study does not have; use a reward with them"
        )


class Range(ConfigPart):
    """A parameter to search: numbers from `low` to `high`, or `choices`.

    Attributes:
        low, high: bounds, both included; whole numbers if both are.
        log: whether to search on a logarithmic scale.
        step: distance of the numbers, from `low` on.
        choices: values, each a scalar or a list.
        start: value in the trial that begins the search, and the middle of the first generation of `cma-es`.
    """

    low: int | _Number | None = None
    high: int | _Number | None = None
    log: bool = False
    step: Annotated[int | _Number, Field(gt=0)] | None = None
    choices: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None
    start: int | _Number | None = None

    @model_validator(mode="after")
    def _is_complete(self) -> Range:
        if (self.choices is None) == (self.low is None or self.high is None):
            raise ValueError("either low and high, or choices expected")
        if self.low is not None and self.high is not None and not self.low <= self.high:
            raise ValueError("low is above high")
        span = 0.0 if self.low is None or self.high is None else self.high - self.low
        if span and self.step is not None and self.step > span + _TOLERANCE * self.step:
            raise ValueError(f"step = {self.step:g} is longer than the range from {self.low:g} to {self.high:g}")
        if self.log and (self.step is not None or (self.low is not None and self.low <= 0)):
            raise ValueError("log needs a low above 0 and no step")
        if self.start is not None and (
            self.low is None or self.high is None or not self.low <= self.start <= self.high
        ):
            raise ValueError("start has to lie between low and high")
        if self.start is not None and not self.contains(self.start):
            raise ValueError(f"start = {self.start:g} is no multiple of {self.step:g} from low = {self.low:g} on")
        if self.is_integer and isinstance(self.start, float):
            raise ValueError(f"start = {self.start:g} is no whole number, but low and high are: write {self.low}.0")
        return self

    @property
    def is_integer(self) -> bool:
        """Whether the numbers are whole."""
        return isinstance(self.low, int) and isinstance(self.high, int) and not isinstance(self.step, float)

    def contains(self, value: float) -> bool:
        """Return whether a number lies between both ends of the range, and at a multiple of its step."""
        if self.low is None or self.high is None or not self.low <= value <= self.high:
            return False
        steps = 0.0 if self.step is None else (value - self.low) / self.step
        return abs(steps - round(steps)) < _TOLERANCE

    def values(self) -> list[Any]:
        """Return the values of a grid.

        Raises:
            InvalidConfig: a range without a step, or with more values than a grid may have points.
        """
        if self.choices is not None:
            return list(self.choices)
        step = self.step or (1 if self.is_integer and not self.log else None)
        if step is None or self.low is None or self.high is None:
            raise InvalidConfig("a grid needs choices, or low, high and step")
        span = self.high - self.low
        if not span <= step * MAX_POINTS:
            raise InvalidConfig(f"more than {MAX_POINTS:,} values, the most points that a grid may have")
        return [min(self.low + i * step, self.high) for i in range(int(span / step + _TOLERANCE) + 1)]


def _as_choices(value: Any) -> Any:
    if not isinstance(value, list | Mapping | Range):
        raise ValueError("a range as {low: 1, high: 9}, or a list of choices expected")
    return {"choices": value} if isinstance(value, list) else value


SearchSpace = Annotated[dict[str, Annotated[Range, BeforeValidator(_as_choices)]], Field(min_length=1)]


def starting_point(searched: Mapping[str, Range]) -> dict[str, Any]:
    """Return the `start` values of those parameters that have one."""
    return {name: parameter.start for name, parameter in searched.items() if parameter.start is not None}


class Pruner(ConfigPart):
    """Ends trials whose evaluations are worse than those of others at the same step.

    Attributes:
        kind: `median`, or `halving` (asynchronous successive halving).
        startup_trials: number of finished trials before the first is pruned; of `median`.
        warmup_steps: steps before a trial is pruned: of training, or episodes of a controller.
    """

    kind: Literal["median", "halving"] = "median"
    startup_trials: Annotated[int, Field(strict=True, ge=0)] = 5
    warmup_steps: Annotated[int, Field(strict=True, ge=0)] = 0


class StudyConfig(ConfigPart, ABC):
    """A study: the fields that all tuning files have.

    Attributes:
        study: name of the study in its database.
        parameters: what to search.
        sampler: `tpe`, `random`, `grid` or `cma-es`.
        seed: seed of the sampler; with one worker, the same study gives the same trials, also if it was interrupted.
        trials: number of trials; a grid has all its points.
        workers: number of trials at the same time on this machine.
        metric: metric to optimize, as `reward` or `hvac_electricity_kwh`.
        direction: whether to maximize or minimize it; by default rewards are maximized, and all others minimized.
        pruner: false: every trial is run to its end.
        retries: how often the trial of a killed process is repeated as another trial.
        storage: URL of the database; by default a SQLite file in `output`.
        output: folder of the results, with a folder for each trial.
        trial_module: module of the process that runs a trial.
        keeps_processes: whether the process of a trial runs further ones.
        begins_with_default: whether the first trial searches nothing, and so has the subject's own defaults.
        default_folder: where the folders of studies without an `output` are.
    """

    trial_module: ClassVar[str]
    keeps_processes: ClassVar[bool]
    begins_with_default: ClassVar[bool]
    default_folder: ClassVar[str] = "tuning"

    study: Annotated[str, Field(min_length=1)]
    parameters: SearchSpace
    sampler: Sampler = "tpe"
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    trials: Count | None = None
    workers: Annotated[int, Field(strict=True, ge=1, le=256)] = 1
    metric: str = "reward"
    direction: Direction = "maximize"
    pruner: Annotated[Annotated[Pruner, FIELDS] | No, FIELDS_OR_FALSE] = Pruner()
    retries: Annotated[int, Field(strict=True, ge=0)] = 0
    storage: str | None = None
    output: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _choose_direction(cls, fields: Any) -> Any:
        if isinstance(fields, Mapping) and fields.get("direction") is None:
            metric = fields.get("metric", cls.model_fields["metric"].default)
            fields = {**fields, "direction": default_direction(str(metric))}
        return fields

    @property
    def folder(self) -> Path:
        """Folder of the results."""
        return Path(self.default_folder) / self.study if self.output is None else Path(self.output)

    @property
    def url(self) -> str:
        """URL of the database."""
        return self.storage or f"sqlite:///{(self.folder / 'study.db').absolute()}"

    @property
    def first_values(self) -> dict[str, Any]:
        """The first value of each searched parameter."""
        return {name: r.choices[0] if r.choices is not None else r.low for name, r in self.parameters.items()}

    def identity(self) -> dict[str, Any]:
        """Return what must not change while a study exists."""
        plain = self.model_dump(mode="json")
        paths = sorted({name for name in self.file_names() if isinstance(name, str) and os.path.isfile(name)})
        contents = {f"{CONTENT}{path}": file_digest(Path(path)) for path in paths}
        return {name: value for name, value in plain.items() if name not in _FREE} | contents

    def file_names(self) -> Iterable[Any]:
        """Return the settings that may name files whose content must not change either."""
        return ()

    def grid(self) -> list[dict[str, Any]]:
        """Return the points of the grid, in the order of the file."""
        columns = []
        for name, searched in self.parameters.items():
            try:
                columns.append(searched.values())
            except InvalidConfig as error:
                raise InvalidConfig(f"parameters.{name}: {error}") from None
        if (points := math.prod(map(len, columns))) > MAX_POINTS:
            raise InvalidConfig(f"the grid has {points:,} points; at most {MAX_POINTS:,} expected")
        return [dict(zip(self.parameters, values, strict=True)) for values in itertools.product(*columns)]

    def checked(self, what: str) -> Any:
        """Return the study with its number of trials.

        Raises:
            InvalidConfig: the grid has ranges without a step or another number of trials, there is no number of trials,
                `cma-es` has a choice, or the metric needs prices.
        """
        try:
            check_metric(self.metric)
        except InvalidConfig as error:
            raise InvalidConfig(f"{what}: {error}") from None
        if self.sampler == "grid":
            points = len(self.grid())
            if self.trials not in (None, points):
                raise InvalidConfig(
                    f"{what}: trials: {self.trials}, but a grid has all of its {points} points; leave it out"
                )
            return self.model_copy(update={"trials": points})
        if self.trials is None:
            raise InvalidConfig(f"{what}: trials: it is missing; only a grid has a number of its own")
        choices = [name for name, searched in self.parameters.items() if searched.choices is not None]
        if self.sampler == "cma-es" and (choices or len(self.parameters) < 2):
            problem = f"{choices[0]} is a list of choices" if choices else "there is only one"
            raise InvalidConfig(f"{what}: sampler: cma-es needs two or more ranges, but {problem}; use tpe")
        return self

    @abstractmethod
    def check(self) -> None:
        """Check, before anything starts, what takes a library or a file.

        Raises:
            InvalidConfig: something is invalid.
        """

    @abstractmethod
    def trial_fields(self, values: Mapping[str, Any], folder: Path) -> dict[str, Any]:
        """Return what the process of a trial needs, as JSON; `values` are those of the searched parameters."""

    @abstractmethod
    def best_fields(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields of `best.yaml`."""


_FREE = ("study", "trials", "workers", "retries", "storage", "output")
"""Fields that may change while a study exists."""
