"""Price, carbon, and whatever else has a value at each time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from numbers import Real
from typing import Any, Protocol, runtime_checkable

import numpy as np
from pydantic import TypeAdapter, ValidationError

from agent_sdk.time_series import Signal as SignalData
from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from topics.codec import describe_validation_errors
from topics.errors import InvalidConfig

_data: TypeAdapter[Any] = TypeAdapter(SignalData)


@runtime_checkable
class Signal(Protocol):
    """Anything that has a value at each simulated time, as those of `agent_sdk.time_series`."""

    def at(self, begin: datetime, /) -> float:
        """The value that holds from then on."""


class _Same:
    """One value at all times."""

    def __init__(self, value: float) -> None:
        self._value = value

    def at(self, begin: datetime, /) -> float:  # noqa: ARG002
        return self._value


def read_signal(given: Any, who: str) -> Signal:
    """A signal from what the wrapper was given.

    Raises:
        InvalidConfig: it is none; the text says why.
    """
    if isinstance(given, Real) and not isinstance(given, bool):
        return _Same(float(given))
    found = given
    if not isinstance(given, Signal):
        try:
            found = _data.validate_python(given)
        except ValidationError as error:
            raise InvalidConfig(f"{who}: {describe_validation_errors(error)}") from None
    if hasattr(found, "load"):
        found.load()
    assert isinstance(found, Signal)
    return found


class _Logic(ObservationLogic):
    def __init__(self, view: EnvView, signals: Mapping[str, Any], hours: Sequence[float] = (0,)) -> None:
        super().__init__(view)
        if not hours or min(hours) < 0 or not np.isfinite(hours).all():
            raise InvalidConfig(f"{view.who}: hours should be numbers from 0 on, not {list(hours)}")
        self._signals = [read_signal(given, f"{view.who}: {name}") for name, given in signals.items()]
        self._ahead = [timedelta(hours=hour) for hour in hours]
        added = [f"{name}_in_{hour:g}h" if hour else name for name in signals for hour in hours]
        infinite = np.full(len(added), np.inf, np.float32)
        self.extend(added, -infinite, infinite)

    def observe(self, seen: ResetBatch | StepBatch, *, begins: bool) -> Values:  # noqa: ARG002  # the same at sample 0
        """See `ObservationLogic`."""
        times = [seen.infos.time(row) for row in range(len(seen.slots))]
        rows = [[signal.at(time + by) for signal in self._signals for by in self._ahead] for time in times]
        return append(seen.observations, np.array(rows, np.float64).reshape(len(times), -1))


class TimeSeriesObservation(BuildingWrapper):
    """Appends signals of the outside, as a price of electricity or its carbon, now and some hours ahead.

    "Now" is the timestep that the next action rules: it begins at the sample's time. `price` ahead by an hour is
    named `price_in_1h`.

    Args:
        signals: name to a signal: a number, one of `agent_sdk.time_series` or its data (`{"hourly": […], "unit":
            "EUR/MWh"}`, `{"table": […], "otherwise": 0.12, "unit": "EUR/kWh"}`, `{"csv": …}`), or any object with
            `at(time) -> float`.
        hours: how far ahead, in hours; 0 is now.

    Raises:
        InvalidConfig: not a signal, or hours that are negative.
    """

    logic = _Logic
