"""Wrappers for buildings, where Gymnasium has none; `agent_sdk.wrappers.vector` has the same for vectors."""

from agent_sdk.wrappers.checkpoint import restore_normalization, restore_wrappers, save_wrappers
from agent_sdk.wrappers.names import action_names_of, names_of, observation_dict
from agent_sdk.wrappers.serialization import GYMNASIUMS, apply_wrappers, wrappers_of
from agent_sdk.wrappers.single import (
    ChangingContext,
    CyclicTime,
    DiscreteIncrementalAction,
    EpisodeLog,
    IncrementalAction,
    PreviousObservation,
    ReducedObservation,
    RewardVector,
    SetpointDifference,
    TensorBoardLog,
    TimeSeriesObservation,
    WeatherForecast,
    WeightsAndBiasesLog,
)

__all__ = [
    "GYMNASIUMS",
    "ChangingContext",
    "CyclicTime",
    "DiscreteIncrementalAction",
    "EpisodeLog",
    "IncrementalAction",
    "PreviousObservation",
    "ReducedObservation",
    "RewardVector",
    "SetpointDifference",
    "TensorBoardLog",
    "TimeSeriesObservation",
    "WeatherForecast",
    "WeightsAndBiasesLog",
    "action_names_of",
    "apply_wrappers",
    "names_of",
    "observation_dict",
    "restore_normalization",
    "restore_wrappers",
    "save_wrappers",
    "wrappers_of",
]
