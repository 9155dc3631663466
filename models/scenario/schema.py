"""Scenario files: building, weather, run period, points, actions and reward.

Each field is also an argument of `gym.make("zenostat/Scenario-v1", ...)` and of a node.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from zenostat.models.building.edits import Edits
from zenostat.models.catalog import MODEL_SUFFIXES, WEATHER_SUFFIXES
from zenostat.models.weather.noise import ColumnNoise
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import ErrorCollector, InvalidConfig, UnknownName
from zenostat.topics.file_fields import as_tuple
from zenostat.topics.file_kinds import FileKind, check_file_kind
from zenostat.topics.messages import Aggregation, SafeName, TimeField
from zenostat.topics.points import check_order

Order = Literal["random", "sequence"]
Control = Literal["point", "zone", "building"]
Sizing = Literal["weather", "model"]
NoiseStart = Literal["episode", "third_day"]


Number = Annotated[float, Field(strict=True)]
"""A number; strings and booleans are rejected."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SensorSpec(_Part):
    """An output variable of EnergyPlus; `aggregation` defaults to the scenario's.

    `lead_h`: of a schedule, its value so many hours later.
    """

    variable: str
    key: str
    aggregation: Aggregation | None = None
    lead_h: Annotated[float, Field(gt=0, le=24, strict=True)] | None = None


class ActuatorSpec(_Part):
    """An actuator of EnergyPlus; its bounds default to the model's own, or those of its unit."""

    component_type: str
    control_type: str
    key: str
    low: Number | None = None
    high: Number | None = None


class ActionSpec(_Part):
    """One dimension of the action, which sets all of `actuators`; its bounds default to the actuators' own.

    A list of actuators is short for an action with their own bounds.
    """

    actuators: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    low: Number | None = None
    high: Number | None = None

    @model_validator(mode="before")
    @classmethod
    def _actuators_alone(cls, value: Any) -> Any:
        return {"actuators": value} if isinstance(value, list | tuple) else value

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = handler.resolve_ref_schema(handler(core))
        actuators, full = schema["properties"]["actuators"], dict(schema)
        schema.clear()
        schema["anyOf"] = [full, {key: value for key, value in actuators.items() if key != "title"}]
        return schema


class DiscreteActionSpec(_Part):
    """One discrete dimension: each choice is a row of values for `actions`."""

    actions: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    values: Annotated[tuple[tuple[Number, ...], ...], Field(min_length=1)]


class LimitSpec(_Part):
    """Ends an episode when one of the points has been outside the range for `duration_h` consecutive hours."""

    points: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    low: Number | None = None
    high: Number | None = None
    duration_h: Annotated[float, Field(ge=0, strict=True)] = 0.0

    @model_validator(mode="after")
    def _a_range(self) -> LimitSpec:
        if self.low is None and self.high is None:
            raise ValueError("a limit needs a low or a high")
        check_order(self)
        return self


def _from_list(spec_type: type[_Part]) -> BeforeValidator:
    """Also accept a list in the order of the fields: `[Zone Air Temperature, Core_ZN]`."""
    names = list(spec_type.model_fields)

    def read(value: Any) -> Any:
        if isinstance(value, str | Mapping | BaseModel) or not hasattr(value, "__iter__"):
            return value
        values = list(value)
        minimum = sum(field.is_required() for field in spec_type.model_fields.values())
        if not minimum <= len(values) <= len(names):
            raise ValueError(f"expected {minimum} to {len(names)} items ({', '.join(names)})")
        return dict(zip(names, values, strict=False))

    return BeforeValidator(read, json_schema_input_type=spec_type | list[str | float | None])


def _is_list(value: Any) -> str:
    return "@list" if isinstance(value, list | tuple) else "@number"


def _check_choices(value: Any) -> Any:
    """Refuse discrete choices that do not name their actions, such as rows alone or numbered ones."""
    parts = value if isinstance(value, list | tuple) else ()
    if isinstance(value, Mapping) or not all(isinstance(part, Mapping | DiscreteActionSpec) for part in parts):
        raise ValueError(
            "a number of steps, or for each discrete action its actions and its choices, a row each, expected: "
            "[{actions: [heating, cooling], values: [[18, 27], [20, 25]]}]"
        )
    return value


def _is_pair(value: Any) -> str:
    if isinstance(value, Mapping):
        return "@mapping"
    return "@pair" if isinstance(value, list | tuple) else "@number"


MAX_OFFSET = 1e9
"""Largest bound of an offset; actions are float32."""


def _check_offsets(value: Any) -> Any:
    pairs = value.values() if isinstance(value, dict) else (value,)
    for pair in pairs:
        low, high = pair if isinstance(pair, tuple) else (-pair, pair)
        if not (low <= 0.0 <= high and low < high):
            raise ValueError(f"bounds of an offset are {low:g} to {high:g}; they must include 0, which is the baseline")
        if max(-low, high) > MAX_OFFSET:
            raise ValueError(f"bounds of an offset are {low:g} to {high:g}; at most {MAX_OFFSET:g} to both sides")
    return value


Positive = Annotated[float, Field(strict=True, gt=0)]
Offset = Annotated[Positive, Tag("@number")] | Annotated[tuple[Number, Number], Tag("@pair")]
OneOffset = Annotated[Offset, Discriminator(_is_pair)]
Offsets = Annotated[
    Offset | Annotated[dict[SafeName, OneOffset], Tag("@mapping")],
    Discriminator(_is_pair),
    AfterValidator(_check_offsets),
]
Count = Annotated[int, Field(strict=True)]
Weathers = Annotated[
    tuple[str, ...],
    Field(min_length=1),
    BeforeValidator(as_tuple, json_schema_input_type=str | Annotated[list[str], Field(min_length=1)]),
]
Discrete = Annotated[
    Annotated[int, Field(ge=2, le=1000, strict=True), Tag("@number")]
    | Annotated[tuple[DiscreteActionSpec, ...], Tag("@list")],
    Discriminator(_is_list),
    BeforeValidator(_check_choices),
]


class Scenario(_Part):
    """Definition of an experiment: simulation, observations, actions and reward.

    `zenostat.topics.scenario_fields` describes each field.
    """

    id: str = ""
    about: str = ""
    building: str
    weather: Weathers
    weather_order: Order = "random"
    weather_noise: dict[str, ColumnNoise] = Field(default_factory=dict)
    noise_start: NoiseStart = "episode"
    sizing: Sizing = "weather"
    begin: str | None = None
    end: str | None = None
    steps_per_hour: Count | None = None
    edits: Edits = Field(default_factory=dict)
    time: tuple[TimeField, ...] = ()
    sensors: dict[str, Annotated[SensorSpec, _from_list(SensorSpec)]] | None = None
    meters: dict[str, str] | None = None
    unobserved: tuple[SafeName, ...] = ()
    actuators: dict[str, Annotated[ActuatorSpec, _from_list(ActuatorSpec)]] | None = None
    aggregation: Literal[Aggregation.INSTANT, Aggregation.MEAN] | None = None
    actions: dict[str, ActionSpec] | None = None
    control: Control = "point"
    relative: Offsets | None = None
    discrete: Discrete | None = None
    reward: dict[str, Any] | None = Field(default_factory=lambda: {"kind": "linear"})
    terminate: tuple[LimitSpec, ...] = ()
    wrappers: tuple[dict[str, Any], ...] = ()

    @model_validator(mode="after")
    def _time_fields_once(self) -> Scenario:
        if len(set(self.time)) < len(self.time):
            raise ValueError("a time field is named twice")
        return self


def read_scenario(
    fields: Mapping[str, Any], what: str = "the scenario", errors: ErrorCollector | None = None
) -> Scenario:
    """Validate `fields` as a scenario; `InvalidConfig` lists all errors.

    With `errors` they are collected there instead, and the returned scenario has only the valid fields, so that the
    rest can be checked as well. A missing or invalid building or weather is then an empty name.
    """
    try:
        return Scenario.model_validate(dict(fields))
    except ValidationError as error:
        config_error = InvalidConfig(f"{what}: {describe_validation_errors(error, Scenario.model_fields)}")
        invalid = {detail["loc"][0] if detail["loc"] else None for detail in error.errors(include_url=False)}
    if errors is None or None in invalid:  # None: an error of several fields together
        raise config_error
    errors.errors.append(config_error)
    valid = {name: value for name, value in fields.items() if name not in invalid}
    return Scenario.model_validate({"building": "", "weather": ("",), **valid})


def load_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that contains a mapping.

    Raises:
        UnknownName: there is no such file, or it cannot be read.
        InvalidConfig: the file is not YAML, or not a mapping.
    """
    from zenostat.topics import yaml12  # slow to import, and only files need it

    return yaml12.read_mapping(path, UnknownName)


def load_scenario(path: Path, errors: ErrorCollector | None = None) -> Scenario:
    """Read a scenario file, whose paths are relative to its folder; `errors` is as in `read_scenario`."""
    fields = load_yaml(path)
    check_file_kind(fields, FileKind.SCENARIO, str(path))
    return read_scenario(resolve_paths(fields, path.parent), str(path), errors)


def resolve_paths(fields: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Make the paths of files in `fields` absolute; they are relative to `folder`."""

    def absolute(text: Any) -> Any:
        if not isinstance(text, str) or Path(text).suffix.lower() not in (*MODEL_SUFFIXES, *WEATHER_SUFFIXES, ".csv"):
            return text
        try:
            return str((folder / Path(text).expanduser()).resolve())
        except RuntimeError:  # ~name of an unknown user, which the catalog reports
            return text

    result = dict(fields)
    if "building" in result:
        result["building"] = absolute(result["building"])
    if "weather" in result:
        weather = result["weather"]
        result["weather"] = [absolute(w) for w in weather] if isinstance(weather, list | tuple) else absolute(weather)
    if isinstance(reward := result.get("reward"), Mapping):
        result["reward"] = {name: _time_series(value, absolute) for name, value in reward.items()}
    return result


def _time_series(value: Any, absolute: Callable[[Any], Any]) -> Any:
    """Make the path of a reward's time series (a price, an emission intensity) absolute."""
    return {**value, "csv": absolute(value["csv"])} if isinstance(value, Mapping) and "csv" in value else value


def dump(scenario: Scenario, *, defaults: bool = False) -> str:
    """Write the scenario as YAML, which `load_scenario` reads back; `defaults`: include fields with default values."""
    from zenostat.topics import yaml12  # slow to import, and only files need it

    plain = scenario.model_dump(mode="json", exclude_defaults=not defaults, exclude_none=defaults)
    if scenario.reward is None:
        plain["reward"] = None
    return yaml12.dump(plain)
