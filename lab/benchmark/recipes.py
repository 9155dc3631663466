"""Settings of the benchmark's trainings and tunings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

TRAINING_SEEDS = 5
"""Number of trainings of each algorithm for each building and season in the set `full`."""

EVALUATION: dict[str, Any] = {"episodes": 3, "seed": 10_001, "at_start": True, "references": []}
"""Evaluations of a training, whose best policy is the result: an episode in each weather file for training.

The first one is before the first step, so a policy that learns nothing is the one that it begins with.
"""

_SEED_SPACING = 100
"""The slots of a training have its seed, one more, and so on: two trainings share no episode."""

_TRAININGS: dict[str, dict[str, Any]] = {
    "ppo": {
        "paired_reward": True,
        "slots": 4,
        "parameters": {
            "n_steps": 168,
            "batch_size": 168,
            "n_epochs": 10,
            "gamma": 0.995,
            "gae_lambda": 0.97,
            "learning_rate": {"linear": 1e-3},
            "target_kl": 0.03,
            "policy_kwargs": {"log_std_init": -2.7, "net_arch": [64, 64]},
        },
        "normalization": {"observations": True, "rewards": True, "actions": True},
        "residual": 1.5,
    },
    "sac": {
        "parameters": {
            "learning_starts": 672,
            "batch_size": 256,
            "gamma": 0.98,
            "learning_rate": 1e-3,
            "policy_kwargs": {"net_arch": [64, 64]},
        },
        "normalization": {"observations": True, "rewards": True, "actions": True},
        "residual": 1.5,
    },
}
"""Fields of the training files, and one more that chooses the form of actions.

With `"arguments": {"relative": 8.0}` they are offsets to the building's own setpoints, in training and in scored
episodes. With `residual` as well, they are offsets of so many K to those that `tuned` sets, which the observation then
contains. With neither they are setpoints.
"""

_BY_SEASON: dict[str, dict[str, dict[str, Any]]] = {}
"""Fields that differ in a season, by algorithm and season; None as a value removes a field."""

_OFFSETS = {"relative": 8.0}
_OWN_SCHEDULES = ("ref-warehouse", "ref-quick-service-restaurant")
"""Buildings whose zones have schedules of their own, such as a heated office in a cold hall, or a kitchen: one pair of
setpoints cannot express their baseline control, offsets to it can."""

_BY_BUILDING: dict[str, dict[str, dict[str, Any]]] = {
    algorithm: {building: {"arguments": _OFFSETS} for building in _OWN_SCHEDULES} for algorithm in _TRAININGS
}
"""Fields that differ in a building, by algorithm and building; a value None removes a field."""

_PAIR: dict[str, Any] = {
    "controller": "rbc",
    "sampler": "cma-es",
    "parameters": {
        "heating_margin": {"low": -1.0, "high": 1.5, "start": 0.3},
        "cooling_margin": {"low": -1.0, "high": 1.5, "start": 0.3},
        "heating_setback": {"low": 0.0, "high": 13.0, "start": 6.0},
        "cooling_setback": {"low": 0.0, "high": 9.0, "start": 6.0},
        "occupancy_threshold": {"low": 0.0, "high": 1.0, "start": 0.2},
        "start_rate": {"low": 0.5, "high": 16.0, "log": True, "start": 3.0},
        "limit_cooling": {"low": 0.0, "high": 1.5, "start": 0.1},
        "precooling": {"low": 0.0, "high": 3.0, "start": 0.2},
        "shed_cooling": {"low": 0.0, "high": 1.5, "start": 0.1},
    },
}
_SHIFTS: dict[str, Any] = {
    "controller": "offsets",
    "sampler": "cma-es",
    "parameters": {
        "heating_occupied": {"low": -3.0, "high": 2.0, "start": -0.5},
        "cooling_occupied": {"low": -2.0, "high": 4.0, "start": 1.0},
        "heating_empty": {"low": -8.0, "high": 2.0, "start": -0.5},
        "cooling_empty": {"low": -2.0, "high": 8.0, "start": 0.5},
        "lead": {"low": 0.0, "high": 3.0, "start": 1.0},
        "occupancy_threshold": {"low": 0.0, "high": 1.0, "start": 0.1},
        "precooling": {"low": 0.0, "high": 3.0, "start": 0.1},
        "shed_cooling": {"low": 0.0, "high": 2.0, "start": 0.2},
    },
}


def rule_of(building: str) -> dict[str, Any]:
    """Return controller, search space and sampler of `tuned` in a building, for `zenostat.lab.tuning.tune_controller`.

    The defaults of `offsets`, which are the first trial, are the baseline control.
    """
    return _SHIFTS if building in _OWN_SCHEDULES else _PAIR


FORMS: dict[str, dict[str, Any]] = {"oracle": _OFFSETS}
"""Arguments in which the environment of a controller that is neither trained nor tuned differs from the task's.

The oracle plans offsets in each building, so that the baseline control is one of its plans.
"""

LEARNING = tuple(_TRAININGS)
"""Algorithms that the benchmark trains."""


_RESIDUAL = "residual"


def is_residual(algorithm: str, building: str, season: str) -> bool:
    """Return whether the actions of a training are offsets to what `tuned` does, so that the tuning comes first."""
    return _RESIDUAL in _fields(algorithm, building, season)


def residual(algorithm: str, building: str, season: str, tuned: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """Return the wrapper of residual actions, or none.

    Args:
        algorithm: name of the training's algorithm.
        building: what it is trained for.
        season: what it is trained for.
        tuned: parameters of the rule; None: its defaults.
    """
    if not is_residual(algorithm, building, season):
        return []
    offset = _fields(algorithm, building, season)[_RESIDUAL]
    controller = rule_of(building)["controller"]
    return [{"wrapper": "ResidualAction", "controller": controller, "parameters": dict(tuned or {}), "offset": offset}]


def recipe(algorithm: str, building: str, season: str) -> dict[str, Any]:
    """Return the fields of a training file that the benchmark sets for an algorithm in a building and season."""
    fields = _fields(algorithm, building, season)
    return {name: value for name, value in fields.items() if name != _RESIDUAL}


def _fields(algorithm: str, building: str, season: str) -> dict[str, Any]:
    fields = _TRAININGS[algorithm]
    for other in (_BY_SEASON.get(algorithm, {}).get(season, {}), _BY_BUILDING.get(algorithm, {}).get(building, {})):
        fields = _merged(fields, other)
    return fields


def form(controller: str, building: str, season: str) -> dict[str, Any]:
    """Return the arguments in which a controller's environment differs from the task's."""
    if controller in LEARNING:
        return dict(recipe(controller, building, season).get("arguments", {}))
    if controller == "tuned":
        return dict(_OFFSETS) if building in _OWN_SCHEDULES else {}
    return FORMS.get(controller, {})


def seed_of(training_seed: int) -> int:
    """Return the seed in the training file of the training with this number."""
    return _SEED_SPACING * training_seed


def _merged(fields: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(fields)
    for name, value in other.items():
        if value is None:
            merged.pop(name, None)
        elif isinstance(value, Mapping) and isinstance(merged.get(name), Mapping):
            merged[name] = _merged(merged[name], value)
        else:
            merged[name] = value
    return merged
