"""Form of a file of results, from which its JSON schema is made."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field
from pydantic.dataclasses import dataclass

from zenostat.lab.benchmark.definition import VERSION, digest_of

TITLE: Literal["zenostat benchmark"] = "zenostat benchmark"
SHOWN_METRICS = ("occupied_outside_kh",)
"""Metrics that each row needs, because the tables show them."""
TERMS = ("cost", "gas", "peak", "comfort")
"""Terms of the reward of each row, EUR."""
ROUNDING = 1e-6
"""Largest relative, or absolute, difference of numbers that are equal but for rounding."""
_NOT_HASHED = "processor_s"
_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)

Hash = Annotated[str, Field(pattern="^[0-9a-f]{0,64}$")]
Seed = Annotated[int, Field(ge=0)]
Seconds = Annotated[float, Field(ge=0.0)]


def is_rounding(value: float, other: float) -> bool:
    """Return whether two numbers are equal but for rounding."""
    return math.isclose(value, other, rel_tol=ROUNDING, abs_tol=ROUNDING)


def is_same(value: float, other: float) -> bool:
    """Return whether two numbers are equal to the bit."""
    return repr(value) == repr(other)


@dataclass(frozen=True, config=_STRICT)
class Row:
    """One episode of one controller.

    Attributes:
        controller: name of a controller of the benchmark, or what `load_controller` accepts.
        building, season, weather: the task.
        seed: seed of the episode.
        reward: sum of the rewards, EUR.
        terms: sums of its terms, EUR.
        linear: sum of the linear rewards of the same episode.
        metrics: metrics and KPIs by name, see `EpisodeMetrics.metrics`.
        training_seed: number of the training; None of a controller that the benchmark does not train.
        processor_s: processor time, s; of building, controller and bus. Rows that differ in it alone are equal.
    """

    controller: str
    building: str
    season: str
    weather: str
    seed: Seed
    reward: float
    terms: dict[str, float]
    linear: float
    metrics: dict[str, float]
    training_seed: Seed | None = None
    processor_s: Seconds | None = None

    def same(self, other: Row | None) -> bool:
        """Return whether another row is equal to the bit."""
        return other is not None and _hashed(self.plain()) == _hashed(other.plain())

    def is_close(self, other: Row | None) -> bool:
        """Return whether another row is of the same episode and equal but for rounding, as on another processor."""
        if other is None:
            return False
        return not self.differences(other, is_rounding)

    def differences(self, other: Row, is_equal: Callable[[float, float], bool] = is_same) -> list[str]:
        """Return which numbers of another row of the same episode are not equal: `reward -9.5, now -9.6`."""
        numbers, others = (
            {"reward": row.reward, "linear": row.linear, **row.terms, **row.metrics} for row in (self, other)
        )
        return [
            f"{name} {numbers.get(name, 'missing')!r}, now {others.get(name, 'missing')!r}"
            for name in numbers | others
            if not (name in numbers and name in others and is_equal(numbers[name], others[name]))
        ]

    def plain(self) -> dict[str, Any]:
        """Return the content as JSON values."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


class Curve(BaseModel):
    """A learning curve in some points: mean rewards of the episodes at each, or that end in the steps before it."""

    model_config = _STRICT
    steps: list[int]
    rewards: list[float]


class Record(BaseModel):
    """Record of a training or a tuning.

    Attributes:
        configuration: hash of all fields of the training file, or of the arguments of the tuning.
        weights: of a training, hash of the policy.
        curve: of a training, the rewards of its training episodes.
        evaluations: of a training, those of its evaluations, without exploration and in the same weather.
        parameters: of a tuning, the best parameters; of a training, those of the tuned rule on which it builds, if any.
        value, default_value: of a tuning, mean reward of an episode with these and with the default parameters.
        processor_s: processor time, s.
    """

    model_config = _STRICT
    configuration: Hash
    weights: Hash | None = None
    curve: Curve | None = None
    evaluations: Curve | None = None
    parameters: dict[str, float | int | bool | str] | None = None
    value: float | None = None
    default_value: float | None = None
    processor_s: Seconds | None = None


class ResultsFile(BaseModel):
    """Results of `zenostat benchmark`."""

    model_config = ConfigDict(**_STRICT, title=f"Results of zenostat benchmark, version {VERSION}")
    format: Literal["zenostat benchmark"]
    version: Literal[VERSION]  # type: ignore[valid-type]
    set: str
    definition: Hash
    versions: dict[str, str]
    hashes: dict[str, Hash]
    trainings: dict[str, Record]
    controllers: dict[str, Hash]
    rows_hash: Hash
    rows: list[Row]


def schema() -> dict[str, Any]:
    """Return the JSON schema of a file of results."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **ResultsFile.model_json_schema()}


def rows_digest(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the hash of rows, without their processor times."""
    return digest_of([_hashed(row) for row in rows])


def _hashed(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in row.items() if name != _NOT_HASHED}
