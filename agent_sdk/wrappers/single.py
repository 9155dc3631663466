"""The wrappers around one environment."""

from agent_sdk.wrappers import (
    changing_context,
    cyclic_time,
    discrete_incremental_action,
    episode_log,
    incremental_action,
    metric_loggers,
    previous_observation,
    reduced_observation,
    reward_vector,
    setpoint_difference,
    time_series_observation,
    weather_forecast,
)
from agent_sdk.wrappers.adapters import Single


class CyclicTime(Single):
    """A `cyclic_time.CyclicTime`, which documents it."""

    core = cyclic_time.CyclicTime


class PreviousObservation(Single):
    """A `previous_observation.PreviousObservation`, which documents it."""

    core = previous_observation.PreviousObservation


class WeatherForecast(Single):
    """A `weather_forecast.WeatherForecast`, which documents it."""

    core = weather_forecast.WeatherForecast


class TimeSeriesObservation(Single):
    """A `time_series_observation.TimeSeriesObservation`, which documents it."""

    core = time_series_observation.TimeSeriesObservation


class SetpointDifference(Single):
    """A `setpoint_difference.SetpointDifference`, which documents it."""

    core = setpoint_difference.SetpointDifference


class ReducedObservation(Single):
    """A `reduced_observation.ReducedObservation`, which documents it."""

    core = reduced_observation.ReducedObservation


class IncrementalAction(Single):
    """A `incremental_action.IncrementalAction`, which documents it."""

    core = incremental_action.IncrementalAction


class DiscreteIncrementalAction(Single):
    """A `discrete_incremental_action.DiscreteIncrementalAction`, which documents it."""

    core = discrete_incremental_action.DiscreteIncrementalAction


class RewardVector(Single):
    """A `reward_vector.RewardVector`, which documents it."""

    core = reward_vector.RewardVector


class ChangingContext(Single):
    """A `changing_context.ChangingContext`, which documents it."""

    core = changing_context.ChangingContext


class EpisodeLog(Single):
    """A `episode_log.EpisodeLog`, which documents it."""

    core = episode_log.EpisodeLog


class TensorBoardLog(Single):
    """A `metric_loggers.TensorBoardLog`, which documents it."""

    core = metric_loggers.TensorBoardLog


class WeightsAndBiasesLog(Single):
    """A `metric_loggers.WeightsAndBiasesLog`, which documents it."""

    core = metric_loggers.WeightsAndBiasesLog
