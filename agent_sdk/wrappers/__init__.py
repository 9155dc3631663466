"""Wrappers for building environments, single and vector, beyond those of Gymnasium."""

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.changing_context import ChangingContext
from agent_sdk.wrappers.checkpoint import restore_normalization, restore_wrappers, save_wrappers
from agent_sdk.wrappers.episode_log import EpisodeLog
from agent_sdk.wrappers.incremental import DiscreteIncrementalAction, IncrementalAction
from agent_sdk.wrappers.metric_loggers import TensorBoardLog, WeightsAndBiasesLog
from agent_sdk.wrappers.names import action_names_of, names_of, observation_dict
from agent_sdk.wrappers.observation import CyclicTime, PreviousObservation, ReducedObservation, SetpointDifference
from agent_sdk.wrappers.reward_vector import RewardVector
from agent_sdk.wrappers.serialization import GYMNASIUMS, apply_wrappers, wrappers_of
from agent_sdk.wrappers.time_series_observation import TimeSeriesObservation
from agent_sdk.wrappers.weather_forecast import WeatherForecast

__all__ = [
    "GYMNASIUMS",
    "BuildingWrapper",
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
