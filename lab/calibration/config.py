"""Parameters files of calibrations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import date
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from zenostat.lab.config_file import FIELDS, FIELDS_OR_FALSE, ConfigPart, Count, No
from zenostat.lab.tuning.study_config import Direction, Pruner, Range, Sampler, StudyConfig
from zenostat.lab.tuning.tuning_file import validated
from zenostat.topics.errors import InvalidConfig

_BATCH = 8
_FREE = ("study", "trials", "workers", "retries", "storage", "output", "refine", "margin", "determined", "held_out")
"""Fields that may change while a study exists."""


class Parameter(Range):
    """A searched parameter of the model: a range, and the numbers that it changes.

    Attributes:
        edit: a kind, as `infiltration`, or a list of edits: `{type, fields, objects, operation}`.
        objects: with a kind, a pattern of object names instead of the kind's own.
        unit: unit of a list of edits.
        truth: the true value, where it is known, for reports on synthetic data.
    """

    edit: str | tuple[dict[str, Any], ...]
    objects: str | None = None
    unit: str | None = None
    truth: float | None = None

    @field_validator("low", "high", "step", "start")
    @classmethod
    def _as_float(cls, value: float | None) -> float | None:
        return None if value is None else float(value)  # a whole number is one of all numbers here

    @model_validator(mode="after")
    def _is_a_range(self) -> Parameter:
        if self.choices is not None or self.low is None or self.high is None:
            raise ValueError("low and high expected; a calibration has no choices")
        if self.low == self.high:
            raise ValueError("low equals high: there is nothing to calibrate")
        return self

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends of the range."""
        assert self.low is not None
        assert self.high is not None
        return float(self.low), float(self.high)

    def to_unit(self, value: float) -> float:
        """Return the place of a value in the range, 0 to 1, on the scale of the search."""
        low, high = self.ends
        if self.log:
            return math.log(value / low) / math.log(high / low)
        return (value - low) / (high - low)

    def from_unit(self, place: float) -> float:
        """Return the value at a place in the range; see `to_unit`."""
        low, high = self.ends
        return low * (high / low) ** place if self.log else low + (high - low) * place

    def nearest(self, value: float) -> float:
        """Return the nearest value that may be searched: in the range, and at a multiple of its step."""
        low, high = self.ends
        value = min(max(value, low), high)
        if self.step is None:
            return value
        steps = min(round((value - low) / self.step), int((high - low) / self.step + 1e-9))
        return low + steps * self.step


class Column(ConfigPart):
    """A measured column: the point that it is compared with.

    Attributes:
        point: name of a point on the bus, as in `zenostat points MODEL --default`.
        meter: instead, a meter of EnergyPlus.
        variable, key: instead, an output variable of EnergyPlus.
        unit: unit of the column; by default the one in its header.
        weight: weight of its errors in the objective.
        tolerance: of a temperature, the RMSE and mean bias that count as much as the guideline's limits, K.
    """

    point: str | None = None
    meter: str | None = None
    variable: str | None = None
    key: str | None = None
    unit: str | None = None
    weight: Annotated[float, Field(gt=0)] = 1.0
    tolerance: Annotated[float, Field(gt=0)] = 1.0


def _as_days(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError("first and last day expected, as [2017-01-09, 2017-01-22]")
    try:
        # A datetime is a date as well, and its text is none.
        first, last = (each if type(each) is date else date.fromisoformat(str(each)) for each in value)
    except ValueError:
        raise ValueError(f"days as 2017-01-09 expected, got {value[0]} and {value[1]}") from None
    if last < first:
        raise ValueError(f"{last} is before {first}")
    return first, last


DayRange = Annotated[tuple[date, date], BeforeValidator(_as_days)]


def _as_column(value: Any) -> Any:
    return {"point": value} if isinstance(value, str) else value


class Calibration(StudyConfig):
    """A calibration: the fields of a parameters file.

    Attributes:
        parameters: the searched parameters, applied in this order.
        columns: headers of measured columns, with their points; false leaves one out. By default each header is that of
            a point, with its unit in brackets.
        time_column: header of the timestamps; by default the first column.
        timestamps: whether a timestamp is the `begin` or the `end` of its interval.
        time_format: of timestamps that are not ISO 8601, as of `strptime`.
        time_zone: IANA name of the zone whose clock the timestamps have; by default they are local standard time.
        interval: `5min` to `30min`, `1h`, `1d`, or `between`: a row covers the time to the next stamp (or since the
            last one), as bills do. By default the most common distance of the stamps.
        missing: whether missing rows and cells are an error or left out.
        delimiter: character between columns.
        periods: days that are simulated and compared, each from its first to its last.
        held_out: further days, with which the result is tested.
        sampler: by default `cma-es`, or `tpe` for a single parameter.
        sizing: whether the model's own design days are used, or those of the weather file.
        adjustable: p of the guideline's formulas.
        batch: trials that are drawn together, before any of their results is known.
        refine: largest number of steps from the best trial towards the optimum of the model linearized there.
        margin: trials whose error is at most the best one's times 1 + margin count as equally good.
        determined: largest share of a parameter's range within which it counts as determined.
        sources: digests of model, weather and measured data, and the version of the engine; not in the file.
    """

    trial_module: ClassVar[str] = ""
    keeps_processes: ClassVar[bool] = False
    begins_with_default: ClassVar[bool] = False
    default_folder: ClassVar[str] = "calibration"

    study: Annotated[str, Field(min_length=1)] = "calibration"
    parameters: Annotated[dict[str, Parameter], Field(min_length=1)]  # type: ignore[assignment]
    columns: dict[str, Annotated[Column, FIELDS, BeforeValidator(_as_column)] | No] = Field(default_factory=dict)
    time_column: str | None = None
    timestamps: Literal["begin", "end"]
    time_format: str | None = None
    time_zone: str | None = None
    interval: Literal["5min", "10min", "15min", "20min", "30min", "1h", "1d", "between"] | None = None
    missing: Literal["error", "leave_out"] = "error"
    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = ","
    periods: Annotated[tuple[DayRange, ...], Field(min_length=1)]
    held_out: tuple[DayRange, ...] = ()
    sizing: Literal["model", "weather"] = "model"
    adjustable: Annotated[int, Field(strict=True, ge=0)] = 1
    sampler: Sampler = "cma-es"
    metric: Literal["error"] = "error"
    direction: Direction = "minimize"
    pruner: Annotated[Annotated[Pruner, FIELDS] | No, FIELDS_OR_FALSE] = Pruner(warmup_steps=0)
    batch: Count | None = None
    refine: Annotated[int, Field(strict=True, ge=0)] = 20
    margin: Annotated[float, Field(gt=0)] = 0.1
    determined: Annotated[float, Field(gt=0, le=1)] = 0.5
    sources: dict[str, str] = Field(default_factory=dict)

    @field_validator("direction")
    @classmethod
    def _minimizes(cls, direction: str) -> str:
        if direction != "minimize":
            raise ValueError("an error is minimized")
        return direction

    @field_validator("storage", "retries")
    @classmethod
    def _is_unused(cls, value: str | int | None) -> str | int | None:
        if value:
            raise ValueError("a calibration keeps its trials in its folder, and continues from there: remove it")
        return value

    @model_validator(mode="after")
    def _do_not_overlap(self) -> Calibration:
        days = sorted((*self.periods, *self.held_out))
        for (_, last), (first, end) in pairwise(days):
            if first <= last:
                raise ValueError(f"periods and held_out: {first} to {end} overlaps the period that ends on {last}")
        return self

    @property
    def batch_size(self) -> int:
        """Trials that are drawn together: by default 8, or a generation of `cma-es`."""
        if self.batch is not None:
            return self.batch
        return 4 + int(3 * math.log(len(self.parameters))) if self.sampler == "cma-es" else _BATCH

    @property
    def total(self) -> int:
        """Number of trials: that of whole batches, or the points of a grid."""
        assert self.trials is not None
        return self.trials if self.sampler == "grid" else -(-self.trials // self.batch_size) * self.batch_size

    def identity(self) -> dict[str, Any]:
        """Return what must not change while a study exists."""
        plain = self.model_dump(mode="json")
        plain["batch"] = self.batch_size
        for fields in plain["parameters"].values():
            fields.pop("truth")
        return {name: value for name, value in plain.items() if name not in _FREE}

    def checked(self, what: str) -> Any:
        """Return the study with its number of trials and its pruner; see `StudyConfig.checked`."""
        alone = len(self.parameters) == 1 and "sampler" not in self.model_fields_set  # cma-es needs two
        own = self.model_copy(update={"sampler": "tpe"}) if alone else self
        config = super(Calibration, own).checked(what)
        if isinstance(config.pruner, Pruner) and config.pruner.kind == "halving":
            raise InvalidConfig(
                f"{what}: pruner.kind: halving compares trials that run at the same time, so its result would "
                "depend on the number of workers; use median or false"
            )
        if "pruner" not in self.model_fields_set and (config.sampler == "cma-es" or len(config.periods) == 1):
            config = config.model_copy(update={"pruner": False})
        return config

    def with_starts(self, neutral: Mapping[str, float | None]) -> Calibration:
        """Return the study with the model as it is as its first trial, where the ranges, with their steps, have it."""
        parameters = dict(self.parameters)
        for name, value in neutral.items():
            if parameters[name].start is None and value is not None and parameters[name].contains(value):
                parameters[name] = parameters[name].model_copy(update={"start": value})
        return self.model_copy(update={"parameters": parameters})

    def check(self) -> None:
        """Check nothing: the model checks its parameters."""

    def trial_fields(self, values: Mapping[str, Any], folder: Path) -> dict[str, Any]:  # noqa: ARG002
        """Return the values of a trial."""
        return dict(values)

    def best_fields(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of the best trial."""
        return dict(values)


def read_calibration(fields: Mapping[str, Any], what: str = "the calibration") -> Calibration:
    """Validate the fields of a parameters file.

    Raises:
        InvalidConfig: lists all errors.
    """
    return validated(Calibration, fields, what)
