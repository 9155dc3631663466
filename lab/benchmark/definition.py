"""Definition of the benchmark. Whatever changes a row of the results changes `VERSION`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

from zenostat.lab.benchmark.observation import sensors, wrappers
from zenostat.lab.benchmark.recipes import (
    EVALUATION,
    LEARNING,
    TRAINING_SEEDS,
    form,
    recipe,
    residual,
    rule_of,
    seed_of,
)
from zenostat.topics.errors import InvalidConfig

VERSION = 2
"""Version of the definition; results of different versions are not comparable."""

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

LOWEST_SCORED_SEED = 20_001
"""Lowest seed of a scored episode; trainings and tuning have lower ones."""

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
    "tuned": {},
    "pid": {},
    "random": {},
    "ppo": {},
    "sac": {},
    "oracle": {"horizon": 4.0, "samples": 8, "iterations": 1, "block": 1.0},
}
"""Controllers of the benchmark with their parameters. `tuned` is a rule with parameters that are tuned, and `ppo` and
`sac` are trained, for each building and season on the training weather."""

BASELINE, TUNED = "baseline", "tuned"


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


@dataclass(frozen=True, order=True)
class Episode:
    """An episode of a controller.

    Attributes:
        controller: its name.
        task: the task.
        seed: seed of the episode.
        training_seed: number of the training; None of a controller that the benchmark does not train.
    """

    controller: str
    task: Task
    seed: int
    training_seed: int | None = None

    @property
    def key(self) -> tuple[str, str, str, str, int, int]:
        """Identity among the results, which can be sorted: -1 stands for no training."""
        return (self.controller, *self.task.key, self.seed, -1 if self.training_seed is None else self.training_seed)

    def __str__(self) -> str:
        training = () if self.training_seed is None else (str(self.training_seed),)
        return "/".join((self.controller, *self.task.key, str(self.seed), *training))


@dataclass(frozen=True)
class BenchmarkSet:
    """A size of the benchmark.

    Attributes:
        name: its name.
        buildings, seasons, weathers: the tasks are all combinations.
        seeds: seeds of the episodes of each task.
        days: days of an episode, from the first day of the season's week.
        training_steps: steps by the name of the algorithm, for each building and season.
        training_seeds: numbers of the trainings of each algorithm, for each building and season.
        tuning: trials, and episode seeds of each trial, of the tuning of `tuned`, for each building and season.
        evaluations: number of evaluations of a training, besides the one before its first step.
    """

    name: str
    buildings: tuple[str, ...]
    seasons: tuple[str, ...]
    weathers: tuple[str, ...]
    seeds: tuple[int, ...]
    days: int
    training_steps: Mapping[str, int]
    training_seeds: tuple[int, ...]
    tuning: tuple[int, tuple[int, ...]]
    evaluations: int

    def tasks(self) -> list[Task]:
        """Return all tasks."""
        return [Task(*names) for names in product(self.buildings, self.seasons, self.weathers)]

    def episodes(self, controllers: Iterable[str]) -> list[Episode]:
        """Return the episodes of controllers: of those that learn, each with each of their trainings."""
        return [
            Episode(name, task, seed, training_seed)
            for name in controllers
            for task in self.tasks()
            for seed in self.seeds
            for training_seed in (self.training_seeds if is_learning(name) else (None,))
        ]

    def arguments(self, building: str, season: str, weather: str) -> dict[str, Any]:
        """Return the arguments of `gym.make` for a task: one pair of setpoints for all thermostats."""
        begin, last = SEASONS[season]
        month, day = begin.split("-")
        end = last if self.days == 7 else f"{month}-{int(day) + self.days - 1:02}"
        return {
            "scenario": f"{building}-{weather}-continuous-v1",
            "begin": begin,
            "end": end,
            **ARGUMENTS,
            "sensors": sensors(building),
        }

    def wrappers(self, building: str) -> list[dict[str, Any]]:
        """Return the wrappers of the tasks in a building, as for `zenostat.wrappers.apply_wrappers`."""
        return wrappers(building, REWARD["price"])

    def controller_arguments(self, controller: str, task: Task) -> dict[str, Any]:
        """Return the arguments of a controller's environment: those of the task, in the form of its actions."""
        return self.arguments(*task.key) | form(controller, task.building, task.season)

    def training(
        self, algorithm: str, building: str, season: str, training_seed: int, rule: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Return the fields of a training file; `zenostat.training.read_training` reads them.

        Args:
            algorithm: its name.
            building: what it is trained for.
            season: what it is trained for.
            training_seed: number of the training.
            rule: parameters of `tuned`, on which residual actions build; None: those of the rule's defaults.
        """
        arguments = self.arguments(building, season, TRAINING_WEATHERS[0])
        fields, steps = recipe(algorithm, building, season), self.training_steps[algorithm]
        return {
            "algorithm": algorithm,
            "scenario": arguments.pop("scenario"),
            "steps": steps,
            "seed": seed_of(training_seed),
            "evaluation": {"every_steps": steps // self.evaluations, **EVALUATION},
            "threads": 1,
            **fields,
            "wrappers": [*self.wrappers(building), *residual(algorithm, building, season, rule)],
            "arguments": arguments | {"weather": list(TRAINING_WEATHERS)} | form(algorithm, building, season),
        }

    def tuning_arguments(self, building: str, season: str) -> dict[str, Any]:
        """Return the arguments of `tune_controller` for `tuned` in a building and season."""
        trials, seeds = self.tuning
        return {
            **rule_of(building),
            "arguments": self.arguments(building, season, TRAINING_WEATHERS[0]) | form(TUNED, building, season),
            "weathers": list(TRAINING_WEATHERS),
            "seeds": list(seeds),
            "trials": trials,
        }

    def digest(self) -> str:
        """Return a hash of the tasks, seeds and rewards of the set, for results of different programs.

        Controllers are not part of it: their hashes are in the results.
        """
        tasks = [[*task.key, self.arguments(*task.key), self.wrappers(task.building)] for task in self.tasks()]
        return digest_of([VERSION, self.name, list(self.seeds), tasks, LINEAR])


def digest_of(content: Any) -> str:
    """Return the sha256 of a JSON value, independent of the order of keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def is_learning(controller: str) -> bool:
    """Return whether the benchmark trains a controller, several times with different seeds."""
    return controller in LEARNING


def is_prepared(controller: str) -> bool:
    """Return whether the benchmark trains or tunes a controller for each building and season."""
    return is_learning(controller) or controller == TUNED


def training_key(name: str, set_name: str) -> tuple[str, str, str, int | None]:
    """Return controller, building, season and number of a training of a set; the number is None of a tuning.

    Raises:
        InvalidConfig: the set has no such training or tuning.
    """
    controller, building, season, number = [*name.split("/"), "", "", ""][:4]
    of_set, is_tuning = SETS[set_name], controller == TUNED
    is_numbered = number in map(str, range(1000))
    is_known = is_prepared(controller) and building in of_set.buildings and season in of_set.seasons
    if not is_known or name.count("/") != 2 + is_numbered or is_tuning == is_numbered:
        raise InvalidConfig(f"{name!r} is no training or tuning of the set {set_name!r}")
    return controller, building, season, None if is_tuning else int(number)


_FULL_SEEDS = tuple(range(LOWEST_SCORED_SEED, LOWEST_SCORED_SEED + 5))
SETS = {
    "smoke": BenchmarkSet(
        "smoke", ("ref-small-office", "ref-warehouse"), ("summer",), HELD_OUT_WEATHERS[:1], _FULL_SEEDS[:1], 3,
        {"ppo": 672, "sac": 700}, (0,), (4, (0,)), 1,
    ),
    "quick": BenchmarkSet(
        "quick", tuple(BUILDINGS), tuple(SEASONS), HELD_OUT_WEATHERS[:2], _FULL_SEEDS[:1], 7,
        {"ppo": 21_504, "sac": 10_752}, (0,), (30, (0,)), 4,
    ),
    "full": BenchmarkSet(
        "full", tuple(BUILDINGS), tuple(SEASONS), HELD_OUT_WEATHERS, _FULL_SEEDS, 7,
        {"ppo": 21_504, "sac": 10_752}, tuple(range(TRAINING_SEEDS)), (30, (0,)), 4,
    ),
}  # fmt: skip
"""`smoke` is a test of the program, `quick` is for a look, `full` is the published one.

The tunings and the first training of `quick` are those of `full` as well.
"""
