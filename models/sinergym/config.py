"""Read a configuration of Sinergym field by field; all of its errors are reported at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from zenostat.models import catalog, data_packs
from zenostat.models.catalog import Entry
from zenostat.models.scenario.schema import DiscreteActionSpec, Scenario, SensorSpec, read_scenario
from zenostat.models.sinergym.actions import ActionReader
from zenostat.models.sinergym.literals import Table
from zenostat.models.sinergym.rewards import RewardReader
from zenostat.models.sinergym.section_reader import SectionReader
from zenostat.models.weather.epw import find_column
from zenostat.models.weather.noise import ColumnNoise
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig, did_you_mean, repeated
from zenostat.topics.keys import check_name
from zenostat.topics.messages import Aggregation, TimeField
from zenostat.topics.scenario_ids import CONTINUOUS, DISCRETE

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
"""Settings that an argument of an environment replaces: they may be missing, and errors in them are ignored. `period`
is `begin` and `end` together."""

_RUN_PERIOD = "[day, month, year, day, month, year]"


@dataclass(frozen=True, slots=True)
class SinergymConfig:
    """The content of a configuration.

    Attributes:
        base: the prefix of its ids.
        forms: `continuous`, `discrete`, or both.
        scenario: the fields that its scenarios have in common.
        weathers: weather files by key.
        noise: of the stochastic scenarios; empty if there are none.
        choices: of the discrete scenarios; None if the meaning of their choices is unknown.
        reason: why `choices` is None.
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
        settings: the file's content.
        path: the file; paths in it are relative to its folder.
        tables: the meaning of discrete choices, by id base.
        overridden: arguments (of `OVERRIDDEN_BY`) that replace settings of the file.
    """

    def __init__(
        self, settings: Mapping[str, Any], path: Path, tables: Mapping[str, Table], overridden: Collection[str] = ()
    ) -> None:
        super().__init__(settings)
        self.path, self.tables, self.overridden = path, tables, overridden
        self.renamed: dict[str, str] = {}

    def read(self) -> SinergymConfig:
        """Read the whole configuration; `InvalidConfig` has all errors, one per line."""
        self._check_keys()
        base = self._id_base()
        weathers = self._weathers()
        actions = ActionReader(self, self.tables, self.overridden, PACK)
        action_actuators = self._unless_overridden("actuators", actions.actuators)
        fields = {
            "building": self._unless_overridden("building", self._building),
            "weather": next(iter(weathers.values()), ("none",)),
            "sizing": "weather",
            **self._unless_overridden("steps_per_hour", self._timesteps),
            **self._unless_overridden("period", self._run_period),
            "time": self._unless_overridden("time", self._time),
            "sensors": self._unless_overridden("sensors", self._sensors),
            "meters": self._unless_overridden("meters", self._meters),
            "aggregation": Aggregation.INSTANT,
            "control": "point",
            **self._unless_overridden("actuators", lambda: actions.with_context(action_actuators)),
            "reward": self._unless_overridden("reward", self._reward),
        }
        noise = self._unless_overridden("weather_noise", self._variability)
        choices, reason = self._unless_overridden("discrete", lambda: actions.choices(base, action_actuators))
        self.kept_episodes()
        if self.errors:
            raise InvalidConfig("\n".join(f"{self.path}: {error}" for error in self.errors))
        forms = [] if self.settings.get("only_discrete") else [CONTINUOUS]
        forms += [DISCRETE] if self.settings.get("action_space_discrete") else []
        scenario = read_scenario(fields, str(self.path))
        return SinergymConfig(base, tuple(forms), scenario, weathers, noise, choices, reason)

    def _unless_overridden(self, argument: str, read: Callable[[], T]) -> T:
        """Return the result of `read`, ignoring its errors if an argument replaces it."""
        before = len(self.errors)
        result = read()
        if argument in self.overridden:
            del self.errors[before:]
        return result

    # Missing and unknown settings

    def _check_keys(self) -> None:
        self.check_names(self.settings, (*REQUIRED, *OPTIONAL), "")
        replaced = [name for argument in self.overridden for name in OVERRIDDEN_BY.get(argument, ())]
        for name in REQUIRED:
            if self.settings.get(name) is None and name not in replaced:
                self.add_error(f"{name} is missing")
        config = self.settings.get("building_config")
        if isinstance(config, Mapping):
            self.check_names(config, ("timesteps_per_hour", "runperiod"), "building_config: ")
        only = self.settings.get("only_discrete")
        if only is not None and not isinstance(only, bool):
            self.add_error(f"only_discrete: expected true or false, got {only!r}")
        if only is True and not self.settings.get("action_space_discrete"):
            self.add_error("only_discrete: true needs action_space_discrete")

    def kept_episodes(self) -> int | None:
        """Return `max_ep_store`, the number of episodes whose files are kept; None if it is not set."""
        value = self.settings.get("max_ep_store")
        if value is None or (type(value) is int and value >= 1):
            return value
        self.add_error(f"max_ep_store: expected an integer of at least 1, got {value!r}")
        return None

    # The building, its weather and its run period

    def _id_base(self) -> str:
        base = self.settings.get("id_base")
        if base is None:
            return ""
        if not isinstance(base, str):
            self.add_error(f"id_base: expected a string, got {base!r}")
            return ""
        return self.collect(lambda: check_name(base, "the base of the ids"), "id_base") or ""

    def _building(self) -> str:
        return self._file("building_file", self.settings.get("building_file"), catalog.buildings, MODEL)

    def _file(self, setting: str, text: Any, entries: Callable[[], tuple[Entry, ...]], stems: tuple[str, ...]) -> str:
        """Return a file next to the configuration, an absolute path, or the catalog's name of the data pack's file."""
        if text is None:
            return ""
        if not isinstance(text, str) or not text:
            self.add_error(f"{setting}: expected the name of a file, got {text!r}")
            return ""
        nearby = self.path.parent / Path(text)
        if os.path.isfile(nearby):  # false for a name that the system does not accept
            return str(nearby.resolve())
        packed = [entry for entry in entries() if entry.pack == PACK]
        for entry in packed:
            if entry.path.name == text:
                return entry.name
        if not packed and Path(text).stem in stems:
            self.add_error(f"{setting}: {text!r} is in the data pack {PACK!r}: {data_packs.command(PACK)}")
        else:
            names = [entry.path.name for entry in packed]
            self.add_error(
                f"{setting}: no file {text!r} next to {self.path.name} or in the data pack; {did_you_mean(text, names)}"
            )
        return ""

    def _weathers(self) -> dict[str, tuple[str, ...]]:
        """Return the weather files by key."""
        section = self.mapping("weather_specification")
        if not section:
            return {}
        setting = "weather_specification"
        self.check_names(section, ("weather_files", "keys"), f"{setting}: ")
        files, keys = section.get("weather_files"), self.texts(section.get("keys"), f"{setting}.keys")
        if not isinstance(files, list):
            self.add_error(f"{setting}.weather_files: expected a list of files, got {files!r}")
            return {}
        if len(files) != len(keys) or not files:
            self.add_error(f"{setting}: {len(files)} weather_files but {len(keys)} keys; each file needs a key")
        for key in repeated(keys):
            self.add_error(f"{setting}.keys: {key!r} appears twice")
        for key in keys:
            self.collect(lambda key=key: check_name(key, "the key"), f"{setting}.keys")  # type: ignore[misc]
        weathers = {}
        for number, (key, file) in enumerate(zip(keys, files, strict=False)):
            names = file if isinstance(file, list) else [file]
            where_file = f"{setting}.weather_files.{number}"
            before = len(self.errors)
            weathers[key] = tuple(self._file(where_file, name, catalog.weathers, WEATHER) for name in names)
            if "weather" in self.overridden:
                del self.errors[before:]
        return weathers

    def _timesteps(self) -> dict[str, Any]:
        steps = self.mapping("building_config").get("timesteps_per_hour")
        if steps is None:
            return {}
        if type(steps) is not int:
            self.add_error(f"building_config.timesteps_per_hour: expected an integer, got {steps!r}")
            return {}
        return {"steps_per_hour": steps}

    def _run_period(self) -> dict[str, Any]:
        period = self.mapping("building_config").get("runperiod")
        if period is None:
            return {}
        try:
            d1, m1, y1, d2, m2, y2 = period
            begin, end = date(y1, m1, d1), date(y2, m2, d2)
        except (OverflowError, TypeError, ValueError) as error:
            self.add_error(f"building_config.runperiod: expected {_RUN_PERIOD}, got {period!r} ({error})")
            return {}
        if end < begin:
            self.add_error(f"building_config.runperiod ends ({end}) before it begins ({begin})")
        return {"begin": begin.isoformat(), "end": end.isoformat()}

    # Observations

    def _time(self) -> tuple[TimeField, ...]:
        value = self.settings.get("time_variables")
        fields = []
        for name in self.texts(value, "time_variables") if value is not None else []:
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
        sensors: dict[str, SensorSpec] = {}
        for variable, spec in self.mapping("variables").items():
            setting = f"variables.{variable}"
            if not isinstance(spec, Mapping):
                self.add_error(f"{setting}: expected variable_names and keys, got {spec!r}")
                continue
            self.check_names(spec, ("variable_names", "keys"), f"{setting}: ")
            for alias, key in self._named_keys(spec.get("variable_names"), spec.get("keys"), setting):
                name = self.name(alias, setting)
                if name is not None:
                    self._add_name(alias, name, setting)
                    sensors[name] = SensorSpec(variable=str(variable), key=key)
        return sensors

    def _named_keys(self, names: Any, keys: Any, setting: str) -> list[tuple[str, str]]:
        if isinstance(names, str) and isinstance(keys, str):
            return [(names, keys)]
        if isinstance(names, str):
            keys = self.texts(keys, f"{setting}.keys")
            return [(f"{key.lower().replace(' ', '_')}_{names}", key) for key in keys]
        if isinstance(keys, str):
            self.add_error(f"{setting}: a single key needs a single name, got {names!r}")
            return []
        names, keys = self.texts(names, f"{setting}.variable_names"), self.texts(keys, f"{setting}.keys")
        if len(names) != len(keys):
            self.add_error(f"{setting}: {len(names)} variable_names but {len(keys)} keys; each key needs a name")
        return list(zip(names, keys, strict=False))

    def _meters(self) -> dict[str, str]:
        meters = {}
        for meter, alias in self.mapping("meters").items():
            setting = f"meters.{meter}"
            name = self.name(alias, setting)
            if name is not None:
                self._add_name(alias, name, setting)
                meters[name] = str(meter)
        return meters

    def _add_name(self, alias: str, name: str, setting: str) -> None:
        """Add the name of an observation; it is an error if another one becomes the same name in a topic."""
        if name in self.renamed.values():
            self.add_error(f"{setting}: two observations are called {name!r}")
        self.renamed[alias] = name

    # Weather noise and reward

    def _variability(self) -> dict[str, ColumnNoise]:
        noise_by_column = {}
        for column_name, numbers in self.mapping("weather_variability").items():
            setting = f"weather_variability.{column_name}"
            column = self.collect(lambda column_name=column_name: find_column(str(column_name)).name, setting)  # type: ignore[misc]
            if not isinstance(numbers, list) or len(numbers) not in (3, 4):
                expected = "[sigma, mu, tau] or [sigma, mu, tau, [low, high]]"
                self.add_error(f"{setting}: expected {expected}, got {numbers!r}")
                continue
            low, high = self.pair(numbers[3], f"{setting}.3") if len(numbers) == 4 else (None, None)
            try:
                noise = ColumnNoise(sigma=numbers[0], mu=numbers[1], tau_h=numbers[2], low=low, high=high)
            except ValidationError as error:
                self.add_error(f"{setting}: {describe_validation_errors(error)}")
                continue
            if column is not None:
                noise_by_column[column] = noise
        return noise_by_column

    def _reward(self) -> dict[str, Any]:
        return RewardReader(self, self.path, self.renamed, PACK).read()
