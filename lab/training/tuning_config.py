"""Tuning files: a training, the parameters to search, sampler, pruner and database."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from zenostat.lab.training.config import (
    FIELDS,
    FIELDS_OR_FALSE,
    Count,
    No,
    TrainingConfig,
    read_file,
    read_training,
    with_field,
)
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.file_kinds import FileKind

Scalar = bool | int | float | str | None
_Number = Annotated[float, Field(strict=True)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Range(_Part):
    """A parameter to search: numbers from `low` to `high`, or `choices`.

    Attributes:
        low, high: bounds, both included; whole numbers if both are.
        log: whether to search on a logarithmic scale.
        step: distance of the numbers, from `low` on.
        choices: values, each a scalar or a list.
    """

    low: int | _Number | None = None
    high: int | _Number | None = None
    log: bool = False
    step: int | _Number | None = None
    choices: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _is_complete(self) -> Range:
        if (self.choices is None) == (self.low is None or self.high is None):
            raise ValueError("either low and high, or choices expected")
        if self.low is not None and self.high is not None and not self.low <= self.high:
            raise ValueError("low is above high")
        if self.log and (self.step is not None or (self.low is not None and self.low <= 0)):
            raise ValueError("log needs a low above 0 and no step")
        return self

    @property
    def is_integer(self) -> bool:
        """Whether the numbers are whole."""
        return isinstance(self.low, int) and isinstance(self.high, int) and not isinstance(self.step, float)

    def values(self) -> list[Any]:
        """Return the values of a grid.

        Raises:
            InvalidConfig: a range without a step.
        """
        if self.choices is not None:
            return list(self.choices)
        step = self.step or (1 if self.is_integer and not self.log else None)
        if step is None or self.low is None or self.high is None:
            raise InvalidConfig("a grid needs choices, or low, high and step")
        return [self.low + i * step for i in range(int((self.high - self.low) / step + 1e-9) + 1)]


def _as_choices(value: Any) -> Any:
    if not isinstance(value, list | Mapping | Range):
        raise ValueError("a range as {low: 1, high: 9}, or a list of choices expected")
    return {"choices": value} if isinstance(value, list) else value


class Pruner(_Part):
    """Ends trials whose evaluations are worse than those of others at the same step.

    Attributes:
        kind: `median`, or `halving` (asynchronous successive halving).
        startup_trials: number of finished trials before the first is pruned; of `median`.
        warmup_steps: training steps before a trial is pruned.
    """

    kind: Literal["median", "halving"] = "median"
    startup_trials: Annotated[int, Field(strict=True, ge=0)] = 5
    warmup_steps: Annotated[int, Field(strict=True, ge=0)] = 0


class TuningConfig(_Part):
    """A study: the fields of a tuning file.

    Attributes:
        study: name of the study in its database.
        training: path of a training file, or its fields.
        parameters: what to search, by field of the training: `parameters.learning_rate`, `slots`, `wrappers`.
        sampler: `tpe`, `random` or `grid`.
        seed: seed of the sampler; with one worker, the same study gives the same trials, also if it was interrupted.
        trials: number of trials; of a grid by default all its points.
        workers: number of trials at the same time on this machine.
        metric: metric of the evaluations to optimize, as `reward` or `hvac_electricity_kwh`.
        direction: whether to maximize it.
        pruner: false: every trial is trained to its end.
        retries: how often the trial of a killed process is repeated as another trial.
        storage: URL of the database; by default a SQLite file in `output`.
        output: folder of the results, with a folder for each trial.
    """

    study: Annotated[str, Field(min_length=1)]
    training: dict[str, Any] | str
    parameters: Annotated[dict[str, Annotated[Range, BeforeValidator(_as_choices)]], Field(min_length=1)]
    sampler: Literal["tpe", "random", "grid"] = "tpe"
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    trials: Count | None = None
    workers: Annotated[int, Field(strict=True, ge=1, le=256)] = 1
    metric: str = "reward"
    direction: Literal["maximize", "minimize"] = "maximize"
    pruner: Annotated[Annotated[Pruner, FIELDS] | No, FIELDS_OR_FALSE] = Pruner()
    retries: Annotated[int, Field(strict=True, ge=0)] = 0
    storage: str | None = None
    output: str | None = None

    @property
    def folder(self) -> Path:
        """Folder of the results."""
        return Path("tuning") / self.study if self.output is None else Path(self.output)

    @property
    def url(self) -> str:
        """URL of the database."""
        return self.storage or f"sqlite:///{(self.folder / 'study.db').absolute()}"

    def identity(self) -> dict[str, Any]:
        """Return what must not change while a study exists: training, search space, sampler and metric."""
        fields = ("training", "parameters", "sampler", "seed", "metric", "direction", "pruner")
        plain = self.model_dump(mode="json")
        return {name: plain[name] for name in fields}

    def grid(self) -> list[dict[str, Any]]:
        """Return the points of the grid, in the order of the file."""
        columns = []
        for name, searched in self.parameters.items():
            try:
                columns.append(searched.values())
            except InvalidConfig as error:
                raise InvalidConfig(f"parameters.{name}: {error}") from None
        return [dict(zip(self.parameters, values, strict=True)) for values in itertools.product(*columns)]

    def training_of(self, values: Mapping[str, Any], output: Path) -> TrainingConfig:
        """Return the training with these values of the searched parameters."""
        assert isinstance(self.training, dict)
        fields: dict[str, Any] = {**self.training, "output": str(output)}
        for path, value in values.items():
            fields = with_field(fields, path, value)
        return read_training(fields)


def read_tuning(fields: Mapping[str, Any], what: str = "the study", folder: Path = Path()) -> TuningConfig:
    """Validate the fields of a tuning file, and the training with the first value of each searched parameter.

    Args:
        fields: the fields.
        what: the file, for errors.
        folder: the folder to which the path of the training file is relative.

    Raises:
        InvalidConfig: lists all errors.
    """
    try:
        config = TuningConfig.model_validate(dict(fields))
    except ValidationError as error:
        raise InvalidConfig(f"{what}: {describe_validation_errors(error, TuningConfig.model_fields)}") from None
    if isinstance(config.training, str):
        config = config.model_copy(update={"training": read_file(folder / config.training)})
    if config.sampler == "grid":
        points = config.grid()
        config = config.model_copy(update={"trials": config.trials or len(points)})
    elif config.trials is None:
        raise InvalidConfig(f"{what}: trials: it is missing; only a grid has a number of its own")
    first = {name: r.choices[0] if r.choices is not None else r.low for name, r in config.parameters.items()}
    training = config.training_of(first, config.folder)
    if not training.evaluation:
        raise InvalidConfig(f"{what}: training.evaluation: a study compares evaluations, so it cannot be false")
    return config


def load_tuning(path: Path) -> TuningConfig:
    """Read a tuning file; errors as of `read_file` and `read_tuning`."""
    return read_tuning(read_file(path, FileKind.TUNING), str(path), path.parent)
