"""One configuration of Sinergym, field by field; what is wrong is gathered and said at once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from models import catalog, data_packs
from models.catalog import Entry
from models.scenario.schema import ActionSpec, ActuatorSpec, DiscreteActionSpec, Scenario, SensorSpec, read_scenario
from models.sinergym.choices import choice_specs
from models.sinergym.literals import BoxSpec, Space, Table, space
from models.sinergym.rewards import RewardReader
from models.sinergym.section_reader import SectionReader
from models.weather.epw import find_column
from models.weather.noise import ColumnNoise
from topics.codec import describe_validation_errors
from topics.errors import InvalidConfig, did_you_mean
from topics.keys import check_name
from topics.messages import Aggregation, TimeField
from topics.scenario_ids import CONTINUOUS, DISCRETE, PACK_IDS

T = TypeVar("T")

PACK = "sinergym"
"""The data pack of the buildings and weather files that a configuration may name."""

MODEL, WEATHER = data_packs.PACKS[PACK].buildings, data_packs.PACKS[PACK].weathers

REQUIRED = ("id_base", "building_file", "weather_specification", "variables", "action_space", "reward", "reward_kwargs")
OPTIONAL = ("actuators", "meters", "context", "time_variables", "building_config", "weather_variability",
            "action_space_discrete", "only_discrete", "initial_context", "max_ep_store")  # fmt: skip

OVERRIDDEN_BY = {
    "building": ("building_file",),
    "steps_per_hour": (),
    "period": (),
    "weather": (),
    "time": ("time_variables",),
    "sensors": ("variables",),
    "meters": ("meters",),
    "actuators": ("actuators", "action_space", "context", "initial_context"),
    "discrete": ("action_space_discrete",),
    "weather_noise": ("weather_variability",),
    "reward": ("reward", "reward_kwargs"),
}
"""What arguments of an environment replace, and the required settings that may be missing then; mistakes there do not
matter. `period` is `begin` and `end` together."""

_RUN_PERIOD = "[day, month, year, day, month, year]"


@dataclass(frozen=True, slots=True)
class SinergymConfig:
    """What a configuration says.

    Attributes:
        base: the beginning of its ids.
        forms: `continuous`, `discrete`, or both.
        scenario: what its scenarios have in common.
        weathers: weather files by key.
        noise: of the stochastic scenarios; empty if there are none.
        choices: of the discrete scenarios; None if nobody knows what their choices mean, and `reason` says so.
    """

    base: str
    forms: tuple[str, ...]
    scenario: Scenario
    weathers: dict[str, tuple[str, ...]]
    noise: dict[str, ColumnNoise]
    choices: tuple[DiscreteActionSpec, ...] | None
    reason: str


class Reader(SectionReader):
    """Reads a configuration.

    Args:
        given: the file's content.
        path: the file; paths in it are relative to its folder.
        tables: what discrete choices mean, by id base.
        overridden: arguments (of `OVERRIDDEN_BY`) that replace what the file says.
    """

    def __init__(
        self, given: Mapping[str, Any], path: Path, tables: Mapping[str, Table], overridden: Collection[str] = ()
    ) -> None:
        super().__init__(given)
        self.path, self.tables, self.overridden = path, tables, overridden
        self.renamed: dict[str, str] = {}

    def read(self) -> SinergymConfig:
        """All that is said; `InvalidConfig` has all faults, one a line."""
        self._check_keys()
        base = self._id_base()
        weathers = self._weathers()
        decided = self._unless("actuators", self._decided)
        fields = {
            "building": self._unless("building", self._building),
            "weather": next(iter(weathers.values()), ("none",)),
            "sizing": "weather",
            **self._unless("steps_per_hour", self._timesteps),
            **self._unless("period", self._run_period),
            "time": self._unless("time", self._time),
            "sensors": self._unless("sensors", self._sensors),
            "meters": self._unless("meters", self._meters),
            "aggregation": Aggregation.INSTANT,
            "control": "point",
            **self._unless("actuators", lambda: self._with_context(decided)),
            "reward": self._unless("reward", self._reward),
        }
        noise = self._unless("weather_noise", self._variability)
        choices, reason = self._unless("discrete", lambda: self._choices(base, decided))
        self.kept_episodes()
        if self.faults:
            raise InvalidConfig("\n".join(f"{self.path}: {fault}" for fault in self.faults))
        forms = [] if self.given.get("only_discrete") else [CONTINUOUS]
        forms += [DISCRETE] if self.given.get("action_space_discrete") else []
        scenario = read_scenario(fields, str(self.path))
        return SinergymConfig(base, tuple(forms), scenario, weathers, noise, choices, reason)

    def _unless(self, argument: str, read: Callable[[], T]) -> T:
        """What is read; its mistakes do not matter where an argument replaces it."""
        before = len(self.faults)
        found = read()
        if argument in self.overridden:
            del self.faults[before:]
        return found

    # What is said and what is not

    def _check_keys(self) -> None:
        self.known(self.given, (*REQUIRED, *OPTIONAL), "")
        replaced = [name for argument in self.overridden for name in OVERRIDDEN_BY.get(argument, ())]
        for name in REQUIRED:
            if self.given.get(name) is None and name not in replaced:
                self.add_error(f"{name} is missing")
        config = self.given.get("building_config")
        if isinstance(config, Mapping):
            self.known(config, ("timesteps_per_hour", "runperiod"), "building_config: ")
        only = self.given.get("only_discrete")
        if only is not None and not isinstance(only, bool):
            self.add_error(f"only_discrete: true or false expected, got {only!r}")
        if only is True and not self.given.get("action_space_discrete"):
            self.add_error("only_discrete: true leaves nothing without action_space_discrete")

    def kept_episodes(self) -> int | None:
        """`max_ep_store`: of how many episodes the files are kept, where they are; None where it says nothing."""
        given = self.given.get("max_ep_store")
        if given is None or (type(given) is int and given >= 1):
            return given
        self.add_error(f"max_ep_store: a whole number of 1 or more expected, got {given!r}")
        return None

    # The building, its weather and its run period

    def _id_base(self) -> str:
        base = self.given.get("id_base")
        if base is None:
            return ""
        if not isinstance(base, str):
            self.add_error(f"id_base: a text expected, got {base!r}")
            return ""
        return self.collect(lambda: check_name(base, "the base of the ids"), "id_base") or ""

    def _building(self) -> str:
        return self._file("building_file", self.given.get("building_file"), catalog.buildings, MODEL)

    def _file(self, where: str, text: Any, known: Callable[[], tuple[Entry, ...]], promised: tuple[str, ...]) -> str:
        """A file beside the configuration, an absolute path, or the catalogue's name of a file of the data pack."""
        if text is None:
            return ""
        if not isinstance(text, str) or not text:
            self.add_error(f"{where}: the name of a file expected, got {text!r}")
            return ""
        beside = self.path.parent / Path(text)
        if beside.is_file():
            return str(beside.resolve())
        packed = [entry for entry in known() if entry.pack == PACK]
        for entry in packed:
            if entry.path.name == text:
                return entry.name
        if not packed and Path(text).stem in promised:
            self.add_error(f"{where}: {text!r} is in the data pack {PACK!r}: {data_packs.command(PACK)}")
        else:
            names = [entry.path.name for entry in packed]
            self.add_error(
                f"{where}: no file {text!r} beside {self.path.name} or in the data pack; {did_you_mean(text, names)}"
            )
        return ""

    def _weathers(self) -> dict[str, tuple[str, ...]]:
        """Weather files by key."""
        given = self.mapping("weather_specification")
        if not given:
            return {}
        where = "weather_specification"
        self.known(given, ("weather_files", "keys"), f"{where}: ")
        files, keys = given.get("weather_files"), self.texts(given.get("keys"), f"{where}.keys")
        if not isinstance(files, list):
            self.add_error(f"{where}.weather_files: a list of files expected, got {files!r}")
            return {}
        if len(files) != len(keys) or not files:
            self.add_error(f"{where}: {len(files)} weather_files and {len(keys)} keys; there should be a key for each")
        for key in dict.fromkeys(key for key in keys if keys.count(key) > 1):
            self.add_error(f"{where}.keys: {key!r} stands twice")
        for key in keys:
            self.collect(lambda key=key: check_name(key, "the key"), f"{where}.keys")  # type: ignore[misc]
        found = {}
        for number, (key, file) in enumerate(zip(keys, files, strict=False)):
            names = file if isinstance(file, list) else [file]
            where_file = f"{where}.weather_files.{number}"
            before = len(self.faults)
            found[key] = tuple(self._file(where_file, name, catalog.weathers, WEATHER) for name in names)
            if "weather" in self.overridden:
                del self.faults[before:]
        return found

    def _timesteps(self) -> dict[str, Any]:
        steps = self.mapping("building_config").get("timesteps_per_hour")
        if steps is None:
            return {}
        if type(steps) is not int:
            self.add_error(f"building_config.timesteps_per_hour: a whole number expected, got {steps!r}")
            return {}
        return {"steps_per_hour": steps}

    def _run_period(self) -> dict[str, Any]:
        period = self.mapping("building_config").get("runperiod")
        if period is None:
            return {}
        try:
            d1, m1, y1, d2, m2, y2 = period
            begin, end = date(y1, m1, d1), date(y2, m2, d2)
        except (TypeError, ValueError) as error:
            self.add_error(f"building_config.runperiod: {_RUN_PERIOD} expected, got {period!r} ({error})")
            return {}
        if end < begin:
            self.add_error(f"building_config.runperiod ends ({end}) before it begins ({begin})")
        return {"begin": begin.isoformat(), "end": end.isoformat()}

    # What is observed

    def _time(self) -> tuple[TimeField, ...]:
        given = self.given.get("time_variables")
        fields = []
        for name in self.texts(given, "time_variables") if given is not None else []:
            if name in list(TimeField):
                fields.append(TimeField(name))
            else:
                self.add_error(
                    f"time_variables: no field {name!r} of the clock; {did_you_mean(name, map(str, TimeField))}"
                )
        if len(set(fields)) < len(fields):
            self.add_error("time_variables: a field is named twice")
        return tuple(fields)

    def _sensors(self) -> dict[str, SensorSpec]:
        found: dict[str, SensorSpec] = {}
        for variable, spec in self.mapping("variables").items():
            where = f"variables.{variable}"
            if not isinstance(spec, Mapping):
                self.add_error(f"{where}: variable_names and keys expected, got {spec!r}")
                continue
            self.known(spec, ("variable_names", "keys"), f"{where}: ")
            for said, key in self._named_keys(spec.get("variable_names"), spec.get("keys"), where):
                name = self.name(said, where)
                if name is not None:
                    self._once(said, name, where)
                    found[name] = SensorSpec(variable=str(variable), key=key)
        return found

    def _named_keys(self, names: Any, keys: Any, where: str) -> list[tuple[str, str]]:
        if isinstance(names, str) and isinstance(keys, str):
            return [(names, keys)]
        if isinstance(names, str):
            keys = self.texts(keys, f"{where}.keys")
            return [(f"{key.lower().replace(' ', '_')}_{names}", key) for key in keys]
        if isinstance(keys, str):
            self.add_error(f"{where}: with one key there is one name, got {names!r}")
            return []
        names, keys = self.texts(names, f"{where}.variable_names"), self.texts(keys, f"{where}.keys")
        if len(names) != len(keys):
            self.add_error(
                f"{where}: {len(names)} variable_names and {len(keys)} keys; there should be a name for each"
            )
        return list(zip(names, keys, strict=False))

    def _meters(self) -> dict[str, str]:
        found = {}
        for meter, said in self.mapping("meters").items():
            where = f"meters.{meter}"
            name = self.name(said, where)
            if name is not None:
                self._once(said, name, where)
                found[name] = str(meter)
        return found

    def _once(self, said: str, name: str, where: str) -> None:
        """Remembers a name of an observation; two that are one in a topic are a fault."""
        if name in self.renamed.values():
            self.add_error(f"{where}: two observations are called {name!r}")
        self.renamed[said] = name

    # What is decided

    def _decided(self) -> dict[str, ActuatorSpec]:
        """The actuators of the action, with its bounds."""
        found = self._specs("actuators")
        given = self.given.get("action_space")
        bounds = self._space("action_space") if given is not None else None
        if bounds is not None and not isinstance(bounds, BoxSpec):
            self.add_error(f"action_space: a Box is expected, got {given!r}; a discrete one is action_space_discrete")
        elif bounds is not None and len(bounds.low) != len(found):
            self.add_error(f"action_space has {len(bounds.low)} dimensions, and there are {len(found)} actuators")
        elif bounds is not None:
            for (name, spec), low, high in zip(list(found.items()), bounds.low, bounds.high, strict=True):
                found[name] = spec.model_copy(update={"low": low, "high": high})
        return found

    def _with_context(self, decided: Mapping[str, ActuatorSpec]) -> dict[str, Any]:
        """The actuators and, where some are not of the action, its dimensions."""
        context = self._specs("context")
        for name in context:
            if name in decided:
                self.add_error(f"context: {name!r} is an actuator of the action already")
        found: dict[str, Any] = {"actuators": {**decided, **context}, **self._initial_context(list(context))}
        return found | ({"actions": {name: ActionSpec(actuators=(name,)) for name in decided}} if context else {})

    def _initial_context(self, names: list[str]) -> dict[str, Any]:
        """What the actuators of the context are set to when an episode begins: a wrapper that does it."""
        given = self.given.get("initial_context")
        if not given or "actuators" in self.overridden:  # Sinergym takes an empty list for none
            return {}
        if not isinstance(given, list) or len(given) != len(names):
            self.add_error(
                f"initial_context: a number for each of {len(names)} actuators of context expected, got {given!r}"
            )
            return {}
        values = {
            name: self.number(n, f"initial_context.{i}") for i, (name, n) in enumerate(zip(names, given, strict=True))
        }
        return {"wrappers": ({"wrapper": "ChangingContext", "schedule": {"00:00": values}},)}

    def _specs(self, section: str) -> dict[str, ActuatorSpec]:
        found: dict[str, ActuatorSpec] = {}
        names = ("variable_name", "element_type", "value_type")
        for key, spec in self.mapping(section).items():
            where = f"{section}.{key}"
            if not isinstance(spec, Mapping) or not all(isinstance(spec.get(n), str) for n in names):
                self.add_error(f"{where}: {', '.join(names)} expected, got {spec!r}")
                continue
            self.known(spec, names, f"{where}: ")
            name = self.name(spec["variable_name"], where)
            if name in found:
                self.add_error(f"{where}: two actuators are called {name!r}")
            elif name is not None:
                found[name] = ActuatorSpec(
                    component_type=spec["element_type"], control_type=spec["value_type"], key=str(key)
                )
        return found

    def _space(self, name: str) -> Space | None:
        given = self.given[name]
        if not isinstance(given, str):
            self.add_error(f"{name}: the text of a space expected, got {given!r}")
            return None
        return self.collect(lambda: space(given), name)

    def _choices(
        self, base: str, actuators: Mapping[str, ActuatorSpec]
    ) -> tuple[tuple[DiscreteActionSpec, ...] | None, str]:
        """The discrete dimensions of these actuators; None and the reason if nobody knows what the choices mean."""
        given = self.given.get("action_space_discrete")
        if not given or "discrete" in self.overridden or (discrete := self._space("action_space_discrete")) is None:
            return (), ""
        if isinstance(discrete, BoxSpec):
            self.add_error(f"action_space_discrete: Discrete or MultiDiscrete expected, got {given!r}")
            return (), ""
        meaning = self.tables.get(base.lower())
        if meaning is None:
            return None, self._unknown_choices(base)
        return self.collect(lambda: choice_specs(discrete, meaning, actuators), "action_space_discrete") or (), ""

    def _unknown_choices(self, base: str) -> str:
        if base in PACK_IDS and not data_packs.is_installed(PACK):
            return (
                f"what the discrete choices of {base!r} mean is in the data pack {PACK!r}: {data_packs.command(PACK)}"
            )
        return (
            f"what the choices of {self.given['action_space_discrete']} mean for {base!r} stands in code, which is "
            "not run; write them into a scenario file (its field `discrete`), or use the continuous scenarios"
        )

    # Weather noise and reward

    def _variability(self) -> dict[str, ColumnNoise]:
        found = {}
        for said, numbers in self.mapping("weather_variability").items():
            where = f"weather_variability.{said}"
            column = self.collect(lambda said=said: find_column(str(said)).name, where)  # type: ignore[misc]
            if not isinstance(numbers, list) or len(numbers) not in (3, 4):
                self.add_error(f"{where}: [sigma, mu, tau] or [sigma, mu, tau, [low, high]] expected, got {numbers!r}")
                continue
            low, high = self.pair(numbers[3], f"{where}.3") if len(numbers) == 4 else (None, None)
            try:
                noise = ColumnNoise(sigma=numbers[0], mu=numbers[1], tau_h=numbers[2], low=low, high=high)
            except ValidationError as error:
                self.add_error(f"{where}: {describe_validation_errors(error)}")
                continue
            if column is not None:
                found[column] = noise
        return found

    def _reward(self) -> dict[str, Any]:
        return RewardReader(self, self.path, self.renamed, PACK).read()
