"""Test cases of the BOPTEST gateway: bundled buildings, those of data packs, and scenarios of all kinds."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Any

from zenostat.gateways.boptest.cases import TestCase
from zenostat.models import catalog
from zenostat.models.building.summary import listed_summaries
from zenostat.models.scenario.registry import find_scenario
from zenostat.models.scenario.schema import Scenario, load_scenario
from zenostat.topics import yaml12
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.cache import cache_dir
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.scenario_ids import BUILDINGS, WEATHERS, pack_ids

_OWN_WEATHER = {"Chicago": "USA_IL_Chicago", "Denver": "USA_CO_Denver"}
_STEPS_PER_HOUR = 4
_DAYS_FILE = "test_periods.yaml"


@cache
def own_weather(building: str) -> str:
    """Return the weather of the place for which a bundled building was designed."""
    stem = catalog.find_building(building).path.stem
    return next(weather for place, weather in _OWN_WEATHER.items() if stem.endswith(place))


def steps_per_hour(building: str) -> int:
    """Return the model's timesteps per hour if 15 minutes are whole timesteps of it, else 4."""
    own = listed_summaries(catalog.find_building(building)).steps_per_hour
    return own if own % _STEPS_PER_HOUR == 0 else _STEPS_PER_HOUR


class BundledTestCases:
    """All scenarios as test cases.

    Args:
        files: scenario files (YAML), which are listed under their names without the suffix.

    Raises:
        UnknownName, InvalidConfig: a file does not exist, is no valid scenario, or has the name of another one.

    A name is that of a file, a bundled building (in the weather that it was designed for), `BUILDING-WEATHER`, or a
    scenario's id.
    """

    def __init__(self, files: Sequence[Path] = ()) -> None:
        self._files: dict[str, tuple[Path, Scenario]] = {}
        for file in files:
            if file.stem in self._files:
                raise InvalidConfig(f"--file: {self._files[file.stem][0]} and {file} have the same name; rename one")
            self._files[file.stem] = file, load_scenario(file)

    def names(self) -> list[str]:
        """Return the names of files, bundled buildings, and deterministic scenarios of installed data packs."""
        return [*dict.fromkeys((*self._files, *BUILDINGS, *_pack_names()))]

    def find(self, name: str) -> TestCase:
        """Return the test case of a name; errors as of `TestCases.find`."""
        case = TestCase(name, {**_arguments(name, self._files), "monitoring": True})
        bundled = None if name in self._files else _bundled_days().get(name)
        return replace(case, days=bundled or _read_days(case))

    def save_days(self, case: TestCase, days: Mapping[str, int]) -> None:
        """Keep the days of test periods in the cache."""
        path = _cached_path(case)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as partial:
            partial.write_text(json.dumps(dict(days)), encoding="utf-8")


def _arguments(name: str, files: Mapping[str, tuple[Path, Scenario]]) -> dict[str, Any]:
    if name in files:
        file, scenario = files[name]
        return _of_scenario(str(file.absolute()), scenario)
    building, _, weather = name.partition("-USA_")
    if building in BUILDINGS and (not weather or f"USA_{weather}" in WEATHERS):
        place = f"USA_{weather}" if weather else own_weather(building)
        return {"building": building, "weather": place, "steps_per_hour": steps_per_hour(building)}
    try:
        scenario = find_scenario(name)
    except UnknownName:
        known = [*files, *BUILDINGS, *_pack_names()]
        raise UnknownName(f"no test case {name!r}; {did_you_mean(name, known)}") from None
    return _of_scenario(name, scenario)


def _of_scenario(text: str, scenario: Scenario) -> dict[str, Any]:
    """Return the arguments of a scenario: with a single weather without noise, and a timestep that fits clients."""
    own = scenario.steps_per_hour or listed_summaries(catalog.find_building(scenario.building)).steps_per_hour
    fits = own % _STEPS_PER_HOUR == 0
    steps = {} if fits else {"steps_per_hour": _STEPS_PER_HOUR}
    return {"scenario": text, "weather_noise": {}, "weather": scenario.weather[0], **steps}


@cache
def _pack_names() -> tuple[str, ...]:
    """Return the scenarios of data packs without noise, once for each building and weather."""
    names: dict[str, str] = {}
    for name in pack_ids():
        if "-stochastic" not in name and name != "demo-v1":
            names.setdefault(name.replace("-discrete-", "-continuous-"), name)
    available = []
    for name in names.values():
        try:
            find_scenario(name)
        except InvalidConfig:  # the data pack has not been added
            continue
        available.append(name)
    return tuple(available)


@cache
def _bundled_days() -> dict[str, dict[str, int]]:
    text = resources.files("zenostat.gateways.boptest").joinpath(_DAYS_FILE).read_text(encoding="utf-8")
    return yaml12.parse(text, _DAYS_FILE)


def _cached_path(case: TestCase) -> Path:
    text = json.dumps({"name": case.name, "content": _content(case.arguments), **case.arguments}, sort_keys=True)
    return cache_dir() / "boptest" / f"{sha256(text.encode()).hexdigest()[:24]}.json"


def _content(arguments: Mapping[str, Any]) -> list[str]:
    """Return hashes of the files that a scenario's loads depend on: its own, the model, and the weather."""
    files: list[Path] = []
    if "building" in arguments:
        building = arguments["building"]
    elif (file := Path(arguments["scenario"])).is_file():
        files, building = [file], load_scenario(file).building
    else:
        building = find_scenario(arguments["scenario"]).building
    files += [catalog.find_building(building).path, catalog.find_weather(arguments["weather"]).path]
    return [sha256(file.read_bytes()).hexdigest() for file in files]


def _read_days(case: TestCase) -> dict[str, int] | None:
    try:
        days: dict[str, int] = json.loads(_cached_path(case).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return days
