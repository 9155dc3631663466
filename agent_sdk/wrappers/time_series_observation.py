"""A wrapper that adds signals such as prices and carbon intensities."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from numbers import Real
from typing import Any, Protocol, runtime_checkable

import numpy as np
from pydantic import TypeAdapter, ValidationError

from zenostat.agent_sdk.time_series import Signal as SignalData
from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from zenostat.agent_sdk.wrappers.names import require_mapping
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig

_MAX_HOURS = 8784
_signal_adapter: TypeAdapter[Any] = TypeAdapter(SignalData)


@runtime_checkable
class Signal(Protocol):
    """An object with a value at each simulated time, such as those of `zenostat.time_series`."""

    def at(self, begin: datetime, /) -> float:
        """Return the value that is valid from that time on."""


class _Constant:
    """One value at all times."""

    def __init__(self, value: float) -> None:
        self._value = value

    def at(self, begin: datetime, /) -> float:  # noqa: ARG002
        return self._value


def read_signal(value: Any, label: str) -> Signal:
    """Return a signal from an argument of the wrapper.

    Args:
        value: a number, a signal, or a signal's data.
        label: names the argument in errors.

    Raises:
        InvalidConfig: the value is not a signal.
    """
    if isinstance(value, Real) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise InvalidConfig(f"{label}: a finite number expected, got {value}")
        return _Constant(float(value))
    signal = value
    if not isinstance(value, Signal):
        try:
            signal = _signal_adapter.validate_python(value)
        except ValidationError as error:
            raise InvalidConfig(f"{label}: {describe_validation_errors(error)}") from None
    if hasattr(signal, "load"):
        signal.load()
    assert isinstance(signal, Signal)
    return signal


def _check_hours(hours: Any, wrapper_name: str) -> None:
    try:
        is_valid = not isinstance(hours, str) and len(hours) > 0 and all(0 <= hour <= _MAX_HOURS for hour in hours)
    except TypeError:
        is_valid = False
    if not is_valid:
        raise InvalidConfig(f"{wrapper_name}: hours should be numbers from 0 on, at most a year, got {hours!r}")


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, signals: Mapping[str, Any], hours: Sequence[float] = (0,)) -> None:
        super().__init__(view)
        require_mapping(signals, f"{view.wrapper_name}: signals", "{name: number or time series}")
        _check_hours(hours, view.wrapper_name)
        self._signals = [read_signal(value, f"{view.wrapper_name}: {name}") for name, value in signals.items()]
        self._offsets = [timedelta(hours=hour) for hour in hours]
        added = [f"{name}_in_{hour:g}h" if hour else name for name in signals for hour in hours]
        if len(set(added)) < len(added):
            raise InvalidConfig(f"{view.wrapper_name}: each of the hours once expected, got {list(hours)}")
        infinite = np.full(len(added), np.inf, np.float32)
        self.extend(added, -infinite, infinite)

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:  # noqa: ARG002  # resets are no different
        times = [batch.infos.time(row) for row in range(len(batch.slots))]
        rows = [[signal.at(time + offset) for signal in self._signals for offset in self._offsets] for time in times]
        return append(batch.observations, np.array(rows, np.float64).reshape(len(times), -1))


class TimeSeriesObservation(BuildingWrapper):
    """Append external signals, such as electricity prices or carbon intensities, now and some hours ahead.

    "Now" is the timestep that the next action applies to, which begins at the sample's time. The value of `price` one
    hour ahead is named `price_in_1h`.

    Args:
        signals: signals by name: numbers, signals of `zenostat.time_series` or their data (`{"hourly": […], "unit":
            "EUR/MWh"}`, `{"table": […], "otherwise": 0.12, "unit": "EUR/kWh"}`, `{"csv": …}`), or any objects with
            `at(time) -> float`.
        hours: horizons in hours; 0, the default, is now.

    Raises:
        InvalidConfig: a value is not a signal, or not finite; hours that are negative, above a year, or named twice.
    """

    logic = _Logic
