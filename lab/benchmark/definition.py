"""Definition of the benchmark. Whatever changes a row of the results changes `VERSION`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

from zenostat.lab.benchmark.frozen_bounds import frozen_actuators

VERSION = 1

SEASONS = {"winter": ("01-09", "01-15"), "spring": ("04-10", "04-16"), "summer": ("07-10", "07-16")}
"""First and last day of an episode: Monday to Sunday in the models' year, 2017."""

BUILDINGS = {
    "ref-small-office": "small office",
    "ref-warehouse": "warehouse",
    "ref-stand-alone-retail": "retail store",
    "ref-quick-service-restaurant": "restaurant",
    "ref-midrise-apartment": "apartments",
}
"""Buildings with their types. None of them has EMS programs, which could override a controller."""

TRAINING_WEATHERS = ("USA_CO_Denver", "USA_VA_Sterling", "USA_NV_Las.Vegas")
HELD_OUT_WEATHERS = (
    "USA_IL_Chicago", "USA_OK_Oklahoma.City", "USA_CA_Fresno", "USA_NJ_Newark", "USA_FL_Tampa",
)  # fmt: skip
"""Weather of the episodes that are scored; no controller of the benchmark is trained or tuned on it."""

TRAINING_SEED = 0
"""Seed of the trainings; no scored episode has it."""

_METERS = {
    "electricity_facility": "Electricity:Facility",
    "electricity_hvac": "Electricity:HVAC",
    "naturalgas_facility": "NaturalGas:Facility",
    "naturalgas_hvac": "NaturalGas:HVAC",
}

_BAND = {"winter": (20.0, 24.0), "summer": (22.0, 26.0)}
"""Comfort band, degC; summer is June to September."""

REWARD: dict[str, Any] = {
    "kind": "occupied_cost",
    "weight": 0.5,
    "price": {
        "table": [{"value": 0.30, "hours": [12, 20], "weekdays": ["mon", "tue", "wed", "thu", "fri"]}],
        "otherwise": 0.12,
        "unit": "EUR/kWh",
    },
    "gas_price": {"value": 0.06, "unit": "EUR/kWh"},
    "lambda_cost": 2.0,
    "lambda_peak": 6.0,
    "lambda_temperature": 0.1,
    "by": "people",
    "energy": "electricity_hvac",
    "demand": "electricity_facility",
    "gas": "naturalgas_hvac",
    **_BAND,
}
"""Reward of the tasks, in EUR: electricity and gas of the HVAC, 3 EUR per kW of the week's peak of the whole building
(12 EUR per kW and month), and 0.05 EUR for each person and kelvin hour outside the band."""

LINEAR: dict[str, Any] = {"kind": "linear", **_BAND}
"""Reward that is reported beside it, on the same trajectories; controllers do not see it."""

ARGUMENTS: dict[str, Any] = {
    "steps_per_hour": 4,
    "noise_start": "third_day",
    "weather_noise": {
        "dry_bulb_temperature": {"sigma": 2.0, "mu": 0.0, "tau_h": 24.0},
        "relative_humidity": {"sigma": 5.0, "mu": 0.0, "tau_h": 24.0},
    },
    "time": ["day_of_week", "hour"],
    "meters": _METERS,
    "reward": REWARD,
}
"""Arguments of all scenarios."""

BASELINES: dict[str, dict[str, Any]] = {
    "baseline": {},
    "fixed": {},
    "rbc": {},
    "pid": {},
    "random": {},
    "ppo": {},
    "sac": {},
    "oracle": {"horizon": 4.0, "samples": 8, "iterations": 1, "block": 1.0},
}
"""Controllers of the benchmark with their parameters; `ppo` and `sac` are trained for each building and season."""

_TRAININGS: dict[str, dict[str, Any]] = {
    "ppo": {
        "parameters": {"n_steps": 672, "batch_size": 96, "n_epochs": 10, "gamma": 0.99, "learning_rate": 3e-4},
    },
    "sac": {
        "parameters": {"learning_starts": 672, "batch_size": 256, "gamma": 0.99, "learning_rate": 1e-3},
    },
}


@dataclass(frozen=True, order=True)
class Task:
    """A building in a week of a season, with one weather file."""

    building: str
    season: str
    weather: str

    @property
    def key(self) -> tuple[str, str, str]:
        """Building, season and weather."""
        return (self.building, self.season, self.weather)

    def __str__(self) -> str:
        return "/".join(self.key)


@dataclass(frozen=True)
class BenchmarkSet:
    """A size of the benchmark.

    Attributes:
        name: its name.
        buildings, seasons, weathers: the tasks are all combinations.
        seeds: seeds of the episodes of each task.
        days: days of an episode, from the first day of the season's week.
        training_steps: steps by the name of the algorithm, for each building and season.
    """

    name: str
    buildings: tuple[str, ...]
    seasons: tuple[str, ...]
    weathers: tuple[str, ...]
    seeds: tuple[int, ...]
    days: int
    training_steps: Mapping[str, int]

    def tasks(self) -> list[Task]:
        """Return all tasks."""
        return [Task(*names) for names in product(self.buildings, self.seasons, self.weathers)]

    def arguments(self, building: str, season: str, weather: str) -> dict[str, Any]:
        """Return the arguments of `BuildingEnv` for a task: one pair of setpoints for all thermostats."""
        return self._published_arguments(building, season, weather) | {"actuators": frozen_actuators(building)}

    def _published_arguments(self, building: str, season: str, weather: str) -> dict[str, Any]:
        """Return the arguments of version 1 as published, when `frozen_actuators` were the default; for hashes."""
        begin, last = SEASONS[season]
        month, day = begin.split("-")
        end = last if self.days == 7 else f"{month}-{int(day) + self.days - 1:02}"
        return {"scenario": f"{building}-{weather}-continuous-v1", "begin": begin, "end": end, **ARGUMENTS}

    def training(self, algorithm: str, building: str, season: str) -> dict[str, Any]:
        """Return the fields of a training file; `zenostat.training.read_training` reads them."""
        published = self.published_training(algorithm, building, season)
        later: dict[str, Any] = {"arguments": published["arguments"] | {"actuators": frozen_actuators(building)}}
        if algorithm == "ppo":  # the default of version 1
            later["parameters"] = published["parameters"] | {"policy_kwargs": {"log_std_init": 0.0}}
        return published | later

    def published_training(self, algorithm: str, building: str, season: str) -> dict[str, Any]:
        """Return the fields of a training file of version 1 as published; for hashes."""
        arguments = self._published_arguments(building, season, TRAINING_WEATHERS[0])
        return {
            "algorithm": algorithm,
            "scenario": arguments.pop("scenario"),
            "arguments": {**arguments, "weather": list(TRAINING_WEATHERS)},
            "steps": self.training_steps[algorithm],
            "seed": TRAINING_SEED,
            "wrappers": [{"wrapper": "CyclicTime", "fields": ["day_of_week", "hour"]}],
            "evaluation": False,
            "threads": 1,
            **_TRAININGS[algorithm],
        }

    def digest(self) -> str:
        """Return a hash of all that defines the rows of the set, for results of different programs."""
        trained = {
            f"{algorithm}/{building}/{season}": self.published_training(algorithm, building, season)
            for algorithm, building, season in product(_TRAININGS, self.buildings, self.seasons)
        }
        tasks = [[*task.key, self._published_arguments(*task.key)] for task in self.tasks()]
        content = [VERSION, self.name, list(self.seeds), tasks, trained, LINEAR, BASELINES]
        return digest_of(content)


def digest_of(content: Any) -> str:
    """Return the sha256 of a JSON value, independent of the order of keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def is_trained(controller: str) -> bool:
    """Return whether the benchmark trains a controller."""
    return controller in _TRAININGS


_QUICK_STEPS = {"ppo": 13_440, "sac": 2_688}
SETS = {
    "smoke": BenchmarkSet(
        "smoke", ("ref-small-office", "ref-warehouse"), ("summer",), HELD_OUT_WEATHERS[:1], (20_001,), 3,
        {"ppo": 672, "sac": 700},
    ),
    "quick": BenchmarkSet(
        "quick", tuple(BUILDINGS), tuple(SEASONS), HELD_OUT_WEATHERS[:2], (20_001,), 7, _QUICK_STEPS
    ),
    "full": BenchmarkSet(
        "full", tuple(BUILDINGS), tuple(SEASONS), HELD_OUT_WEATHERS, tuple(range(20_001, 20_006)), 7,
        {"ppo": 201_600, "sac": 40_320},
    ),
}  # fmt: skip
"""`smoke` is a test of the program in seconds, `quick` is the published one, `full` has more weather, seeds, steps."""
