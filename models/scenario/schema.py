"""A scenario: what is simulated, what an agent sees and decides of it, and what it is rewarded for; one file.

Each field is also an argument of `gym.make("zenostat/Scenario-v1", ...)` and of a node.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
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

from models.building.edits import Edits
from models.catalog import MODEL_SUFFIXES, WEATHER_SUFFIXES
from models.weather.noise import ColumnNoise
from topics import yaml12
from topics.codec import describe_validation_errors
from topics.errors import ErrorCollector, InvalidConfig, UnknownName
from topics.messages import Aggregation, SafeName, TimeField

Order = Literal["random", "sequence"]
Control = Literal["point", "zone", "building"]
Sizing = Literal["weather", "model"]


Number = Annotated[float, Field(strict=True)]
"""No text and no boolean."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SensorSpec(_Part):
    """An output variable of EnergyPlus. Without `aggregation`, the scenario's."""

    variable: str
    key: str
    aggregation: Aggregation | None = None


class ActuatorSpec(_Part):
    """An actuator of EnergyPlus. Bounds left out are the model's own, or those of its unit."""

    component_type: str
    control_type: str
    key: str
    low: Number | None = None
    high: Number | None = None


class ActionSpec(_Part):
    """One dimension of the action: it sets all of `actuators`. Bounds left out are the actuators' own.

    The list of actuators alone is short for an action with their own bounds.
    """

    actuators: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    low: Number | None = None
    high: Number | None = None

    @model_validator(mode="before")
    @classmethod
    def _actuators_alone(cls, given: Any) -> Any:
        return {"actuators": given} if isinstance(given, list | tuple) else given

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        whole = handler.resolve_ref_schema(handler(core))
        alone, form = whole["properties"]["actuators"], dict(whole)
        whole.clear()
        whole["anyOf"] = [form, {key: value for key, value in alone.items() if key != "title"}]
        return whole


class DiscreteActionSpec(_Part):
    """One discrete dimension: a row of values for `actions` for each choice."""

    actions: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    values: Annotated[tuple[tuple[Number, ...], ...], Field(min_length=1)]


class LimitSpec(_Part):
    """Ends an episode when one of the points has been outside the range for `duration_h` hours without a break."""

    points: Annotated[tuple[SafeName, ...], Field(min_length=1)]
    low: Number | None = None
    high: Number | None = None
    duration_h: Annotated[float, Field(ge=0, strict=True)] = 0.0

    @model_validator(mode="after")
    def _a_range(self) -> LimitSpec:
        if self.low is None and self.high is None:
            raise ValueError("a limit needs a low or a high")
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ValueError(f"low {self.low:g} is not below high {self.high:g}")
        return self


def _listed(form: type[_Part]) -> BeforeValidator:
    """Takes a list in the order of the fields as well: `[Zone Air Temperature, Core_ZN]`."""
    names = list(form.model_fields)

    def read(value: Any) -> Any:
        if isinstance(value, str | Mapping | BaseModel) or not hasattr(value, "__iter__"):
            return value
        values = list(value)
        least = sum(field.is_required() for field in form.model_fields.values())
        if not least <= len(values) <= len(names):
            raise ValueError(f"{least} to {len(names)} parts expected ({', '.join(names)}), got {values}")
        return dict(zip(names, values, strict=False))

    return BeforeValidator(read, json_schema_input_type=form | list[str | float | None])


def _one_or_more(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


def _is_list(value: Any) -> str:
    return "@list" if isinstance(value, list | tuple) else "@number"


Count = Annotated[int, Field(strict=True)]
Weathers = Annotated[
    tuple[str, ...],
    Field(min_length=1),
    BeforeValidator(_one_or_more, json_schema_input_type=str | Annotated[list[str], Field(min_length=1)]),
]
Discrete = Annotated[
    Annotated[int, Field(ge=2, strict=True), Tag("@number")] | Annotated[tuple[DiscreteActionSpec, ...], Tag("@list")],
    Discriminator(_is_list),
]


class Scenario(_Part):
    """What is simulated, observed, decided and rewarded.

    Attributes:
        id: its name, without `zenostat/`.
        about: what it is, for people.
        building: short name or path of a model.
        weather: short names or paths of weather files; one is drawn for each episode.
        weather_order: `random`, or `sequence`: one after the other, an episode each.
        weather_noise: noise on the weather, by column of the weather file.
        sizing: `weather`: location and design days follow the weather file; `model`: the model's own stay.
        begin, end: first and last day, MM-DD or YYYY-MM-DD; the model's own run period if left out.
        steps_per_hour: timesteps an hour; the model's own if left out.
        edits: objects of the model, field by field.
        time: fields of the clock that are observed, before the sensors.
        sensors, meters, actuators: by the name that they get; a sensible set found in the model if left out.
        aggregation: how sensors read that do not say: `instant`; `mean`: what EnergyPlus reports, the mean or sum over
            the timestep; left out: `mean` for rates and energies, `instant` for states.
        actions: the action's dimensions, by name; found by `control` if left out.
        control: `point`: a dimension for each actuator; `zone`: the same, with zones choosing on their own where
            discrete; `building`: one pair of setpoints for all thermostats.
        discrete: choices, or the number of equal steps from the widest to the tightest setpoints; None: continuous.
        reward: its kind and parameters; None: 0.
        terminate: limits that end an episode before its time.
        wrappers: of the environment, by name with their arguments, the innermost first.
    """

    id: str = ""
    about: str = ""
    building: str
    weather: Weathers
    weather_order: Order = "random"
    weather_noise: dict[str, ColumnNoise] = Field(default_factory=dict)
    sizing: Sizing = "weather"
    begin: str | None = None
    end: str | None = None
    steps_per_hour: Count | None = None
    edits: Edits = Field(default_factory=dict)
    time: tuple[TimeField, ...] = ()
    sensors: dict[str, Annotated[SensorSpec, _listed(SensorSpec)]] | None = None
    meters: dict[str, str] | None = None
    actuators: dict[str, Annotated[ActuatorSpec, _listed(ActuatorSpec)]] | None = None
    aggregation: Literal[Aggregation.INSTANT, Aggregation.MEAN] | None = None
    actions: dict[str, ActionSpec] | None = None
    control: Control = "point"
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
    given: Mapping[str, Any], what: str = "the scenario", errors: ErrorCollector | None = None
) -> Scenario:
    """`given` as a scenario; `InvalidConfig` names all faults at once.

    With `errors` they are gathered there instead, and the scenario has the fields that are right: the rest of it
    can be checked, too. A building or weather that is missing or wrong is an empty name then.
    """
    try:
        return Scenario.model_validate(dict(given))
    except ValidationError as error:
        refused = InvalidConfig(f"{what}: {describe_validation_errors(error, Scenario.model_fields)}")
        wrong = {fault["loc"][0] if fault["loc"] else None for fault in error.errors(include_url=False)}
    if errors is None or None in wrong:  # None: of several fields together
        raise refused
    errors.found.append(refused)
    right = {name: value for name, value in given.items() if name not in wrong}
    return Scenario.model_validate({"building": "", "weather": ("",), **right})


def load_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping.

    Raises:
        UnknownName: there is no such file.
        InvalidConfig: it is no YAML, or something else than a mapping.
    """
    try:
        text = yaml12.read_text(path)
    except FileNotFoundError:
        raise UnknownName(f"there is no file {path.absolute()}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UnknownName(f"cannot read {path.absolute()}: {error}") from None
    return yaml12.parse(text, str(path))


def load_scenario(path: Path, errors: ErrorCollector | None = None) -> Scenario:
    """The scenario of a file. Paths in it are relative to it. `errors`: as in `read_scenario`."""
    return read_scenario(beside(load_yaml(path), path.parent), str(path), errors)


def beside(given: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """`given` with the paths of its files made absolute; they are relative to `folder`."""

    def found(text: Any) -> Any:
        if not isinstance(text, str) or Path(text).suffix.lower() not in (*MODEL_SUFFIXES, *WEATHER_SUFFIXES, ".csv"):
            return text
        try:
            return str((folder / Path(text).expanduser()).resolve())
        except RuntimeError:  # ~name of nobody: the catalogue says so
            return text

    result = dict(given)
    if "building" in result:
        result["building"] = found(result["building"])
    if "weather" in result:
        weather = result["weather"]
        result["weather"] = [found(w) for w in weather] if isinstance(weather, list | tuple) else found(weather)
    if isinstance(reward := result.get("reward"), Mapping):
        result["reward"] = {name: _signal(value, found) for name, value in reward.items()}
    return result


def _signal(value: Any, found: Callable[[Any], Any]) -> Any:
    """A price or an intensity from a file, with its path."""
    return {**value, "csv": found(value["csv"])} if isinstance(value, Mapping) and "csv" in value else value


def dump(scenario: Scenario, *, defaults: bool = False) -> str:
    """The scenario as YAML; `load_scenario` gives an equal one. `defaults`: also what could be left out."""
    plain = scenario.model_dump(mode="json", exclude_defaults=not defaults, exclude_none=defaults)
    if scenario.reward is None:
        plain["reward"] = None
    return yaml12.dump(plain)
