"""Wrappers for building environments, single and vector, beyond those of Gymnasium."""

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.changing_context import ChangingContext
from zenostat.agent_sdk.wrappers.checkpoint import restore_normalization, restore_wrappers, save_wrappers
from zenostat.agent_sdk.wrappers.episode_log import EpisodeLog
from zenostat.agent_sdk.wrappers.gymnasium_wrappers import GYMNASIUMS
from zenostat.agent_sdk.wrappers.incremental import DiscreteIncrementalAction, IncrementalAction
from zenostat.agent_sdk.wrappers.metric_loggers import MeansLog, TensorBoardLog, WeightsAndBiasesLog
from zenostat.agent_sdk.wrappers.names import action_names_of, names_of, observation_dict
from zenostat.agent_sdk.wrappers.numeric_infos import NumericInfos
from zenostat.agent_sdk.wrappers.observation import (
    CyclicTime,
    MetricObservation,
    PreviousObservation,
    ReducedObservation,
    SetpointDifference,
)
from zenostat.agent_sdk.wrappers.residual_action import ResidualAction
from zenostat.agent_sdk.wrappers.reward_vector import RewardVector
from zenostat.agent_sdk.wrappers.serialization import apply_wrappers, wrappers_of
from zenostat.agent_sdk.wrappers.time_series_observation import TimeSeriesObservation
from zenostat.agent_sdk.wrappers.weather_forecast import WeatherForecast

__all__ = [
    "GYMNASIUMS",
    "BuildingWrapper",
    "ChangingContext",
    "CyclicTime",
    "DiscreteIncrementalAction",
    "EpisodeLog",
    "IncrementalAction",
    "MeansLog",
    "MetricObservation",
    "NumericInfos",
    "PreviousObservation",
    "ReducedObservation",
    "ResidualAction",
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
