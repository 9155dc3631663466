"""Wrappers for building environments, single and vector, beyond those of Gymnasium."""

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.changing_context import ChangingContext
from agent_sdk.wrappers.checkpoint import restore_normalization, restore_wrappers, save_wrappers
from agent_sdk.wrappers.cyclic_time import CyclicTime
from agent_sdk.wrappers.discrete_incremental_action import DiscreteIncrementalAction
from agent_sdk.wrappers.episode_log import EpisodeLog
from agent_sdk.wrappers.incremental_action import IncrementalAction
from agent_sdk.wrappers.metric_loggers import TensorBoardLog, WeightsAndBiasesLog
from agent_sdk.wrappers.names import action_names_of, names_of, observation_dict
from agent_sdk.wrappers.previous_observation import PreviousObservation
from agent_sdk.wrappers.reduced_observation import ReducedObservation
from agent_sdk.wrappers.reward_vector import RewardVector
from agent_sdk.wrappers.serialization import GYMNASIUMS, apply_wrappers, wrappers_of
from agent_sdk.wrappers.setpoint_difference import SetpointDifference
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
