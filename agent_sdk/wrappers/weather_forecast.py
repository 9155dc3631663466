"""The weather that comes, as a forecast would tell it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent_sdk.wrappers.adapters import BuildingWrapper
from agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from agent_sdk.wrappers.names import places
from agent_sdk.wrappers.rng import SlotRandomStreams
from topics.errors import InvalidConfig
from topics.messages import WeatherSeries

_WIND_DIRECTION = "wind_direction"
_BOUNDS = {"relative_humidity": (0.0, 110.0), _WIND_DIRECTION: (0.0, 360.0)} | {
    f"{kind}_sky_cover": (0.0, 10.0) for kind in ("total", "opaque")
}
_NOT_NEGATIVE = ("radiation", "illuminance", "luminance", "speed", "pressure", "depth", "visibility", "height")

Floats = NDArray[np.float64]


def _bounds(column: str) -> tuple[float, float]:
    floor = 0.0 if any(word in column for word in _NOT_NEGATIVE) else -np.inf
    return _BOUNDS.get(column, (floor, np.inf))


class ErrorModel(NamedTuple):
    """How wrong a forecast of one column is, in its unit; `tau_h` None for an error that grows without end."""

    sigma: float
    tau_h: float | None = None
    mu: float = 0.0


class ErrorSpec(NamedTuple):
    """What an `ErrorModel` is drawn from for each episode: numbers, or ranges (low, high); and limits of the values."""

    sigma: Any
    tau_h: Any = None
    mu: Any = 0.0
    low: float = -np.inf
    high: float = np.inf

    @classmethod
    def read(cls, given: Any, who: str) -> ErrorSpec:
        """From a number or `{"sigma": …, "tau_h": …, "mu": …, "low": …, "high": …}`."""
        try:
            spec = cls(**given) if isinstance(given, Mapping) else cls(float(given))
            (sigma, sigmas), (mu, mus) = _range(spec.sigma), _range(spec.mu)
            tau_h, taus_h = (1.0, 1.0) if spec.tau_h is None else _range(spec.tau_h)
            fine = 0 <= sigma <= sigmas < np.inf and -np.inf < mu <= mus < np.inf and 0 < tau_h <= taus_h < np.inf
            fine = fine and float(spec.low) < float(spec.high)
        except (TypeError, ValueError):
            fine = False
        if not fine:
            raise InvalidConfig(
                f'{who}: an error is sigma or {{"sigma": …, "tau_h": …, "mu": …, "low": …, "high": …}}, the first '
                f"three of them numbers or ranges [low, high]; not {given!r}"
            )
        return spec

    def draw(self, rng: np.random.Generator) -> ErrorModel:
        """An episode's; ranges are drawn from uniformly."""

        def one(given: Any) -> float:
            low, high = _range(given)
            return float(rng.uniform(low, high)) if low < high else low

        return ErrorModel(one(self.sigma), None if self.tau_h is None else one(self.tau_h), one(self.mu))


def _range(given: Any) -> tuple[float, float]:
    low, high = given if isinstance(given, Sequence) else (given, given)
    return float(low), float(high)


def error_path(normal: Floats, horizons_h: Floats, model: ErrorModel) -> Floats:
    """Errors along one forecast, shape (…, horizons), from as many standard normal numbers.

    A path that starts at 0 at horizon 0. Without `tau_h` it is a random walk with the standard deviation
    sigma * sqrt(horizon / 24 h); with it, AR(1) with phi = exp(-spacing / tau) and
    sigma * sqrt(1 - exp(-2 horizon / tau)), which ends at sigma. Its mean is mu * horizon / 24 h, or with `tau_h`
    mu * (1 - exp(-horizon / tau)), which ends at mu.
    """
    spacing = np.diff(horizons_h, prepend=0.0)
    if model.tau_h is None:
        keep, spread = np.ones_like(spacing), np.sqrt(spacing / 24.0)
    else:
        keep, spread = np.exp(-spacing / model.tau_h), np.sqrt(-np.expm1(-2.0 * spacing / model.tau_h))
    path, error = np.empty_like(normal), np.zeros(normal.shape[:-1])
    for at in range(len(horizons_h)):
        error = keep[at] * error + model.sigma * spread[at] * normal[..., at]
        path[..., at] = error
    share = horizons_h / 24.0 if model.tau_h is None else -np.expm1(-horizons_h / model.tau_h)
    return path + model.mu * share


class _Column(NamedTuple):
    """One column of an episode: its values and when they hold, in seconds after the begin."""

    times_s: Floats
    values: Floats
    turns: bool

    def at(self, times_s: Floats) -> Floats:
        """Linear between rows; beyond the first and the last, their values."""
        found: Floats = np.interp(times_s, self.times_s, self.values)
        return found % 360.0 if self.turns else found


class _Logic(ObservationLogic):
    def __init__(
        self,
        view: EnvView,
        columns: Sequence[str],
        n: int = 5,
        spacing_h: float = 1.0,
        errors: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(view)
        if not (columns and n > 0 and 0 < spacing_h < np.inf) or isinstance(columns, str):
            raise InvalidConfig(f"{view.who}: name at least one column, with n and spacing_h above 0")
        places(columns, columns, view.who, "column")
        places(errors or {}, columns, view.who, "column")
        self._columns = list(columns)
        self._horizons_h = spacing_h * np.arange(1, n + 1, dtype=np.float64)
        self._errors = {name: ErrorSpec.read(given, f"{view.who}: {name}") for name, given in (errors or {}).items()}
        self._drawn: list[dict[str, ErrorModel]] = [{} for _ in range(view.slots)]
        self._bounds = np.array([self._limits(column) for column in columns])
        self._randoms = SlotRandomStreams(view.env, view.who, view.slots)
        self._weather: list[list[_Column]] = [[] for _ in range(view.slots)]
        self._begins: dict[int, datetime] = {}
        self._timestep = timedelta(hours=1 / view.manifest.steps_per_hour)
        low, high = np.repeat(self._bounds, n, axis=0).T
        self.extend([f"{column}_in_{hour:g}h" for column in columns for hour in self._horizons_h], low, high)

    def observe(self, seen: ResetBatch | StepBatch, *, begins: bool) -> Values:
        """See `ObservationLogic`."""
        if begins:
            assert isinstance(seen, ResetBatch)
            self._fetch(seen)
        told = [self._forecast(slot, seen.infos.time(row)) for row, slot in enumerate(seen.slots)]
        return append(seen.observations, np.array(told))

    def _limits(self, column: str) -> tuple[float, float]:
        low, high = _bounds(column)
        error = self._errors.get(column, ErrorSpec(0.0))
        return max(low, float(error.low)), min(high, float(error.high))

    def _fetch(self, start: ResetBatch) -> None:
        self._randoms.seed(start.slots, start.seeds)
        series = self.view.each(start.slots, "weather", self._columns)
        for row, slot in enumerate(start.slots):
            self._weather[slot] = self._read(series[row])
            self._drawn[slot] = {name: spec.draw(self._randoms[slot]) for name, spec in self._errors.items()}
            self._begins[slot] = start.infos.time(row) - start.infos.step(row) * self._timestep

    def _read(self, series: WeatherSeries) -> list[_Column]:
        rows = np.frombuffer(series.values, "<f8").reshape(-1, len(series.columns))
        times_s = series.step_s * np.arange(1, len(rows) + 1)
        found = []
        for name, values in zip(series.columns, rows.T, strict=True):
            there = np.isfinite(values)
            if not there.any():
                raise InvalidConfig(f"{self.view.who}: the episode's weather file has no values of {name!r}")
            turns = name == _WIND_DIRECTION
            told = np.unwrap(values[there], period=360.0) if turns else values[there]
            found.append(_Column(times_s[there], told, turns))
        return found

    def _forecast(self, slot: int, now: datetime) -> Floats:
        times_s: Floats = (now - self._begins[slot]).total_seconds() + 3600.0 * self._horizons_h
        told = np.array([column.at(times_s) for column in self._weather[slot]])
        for at, name in enumerate(self._columns):
            if name in self._errors:
                normal = self._randoms[slot].standard_normal(len(times_s))
                told[at] += error_path(normal, self._horizons_h, self._drawn[slot][name])
                if self._weather[slot][at].turns:
                    told[at] %= 360.0
        bounded: Floats = np.clip(told, self._bounds[:, :1], self._bounds[:, 1:])
        return bounded.reshape(-1)

    def get_state(self) -> list[dict[str, Any]]:
        """The random generators and what they drew; the weather is asked for again at the next reset."""
        drawn = [{name: model._asdict() for name, model in models.items()} for models in self._drawn]
        return [{**state, "errors": errors} for state, errors in zip(self._randoms.get_state(), drawn, strict=True)]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        """See `WrapperLogic`."""
        self._randoms.set_state(slots)
        for slot, state in enumerate(slots):
            self._drawn[slot] = {name: ErrorModel(**drawn) for name, drawn in state.get("errors", {}).items()}


class WeatherForecast(BuildingWrapper):
    """Appends the next hours' weather: named columns of the weather file that this episode reads, noise included.

    The values are those at the instants `spacing_h`, 2 `spacing_h`, … after the sample, linear between the rows of
    the file (over the shorter arc for `wind_direction`), as EnergyPlus takes instantaneous quantities. A row of a
    radiation is the mean of the hour that ends there. Before the first row and beyond the last, whose time is a
    week after the episode's end, that row's value is held. Rows that the file leaves out are passed over.

    With an error the forecast is wrong by a path that starts at 0 now and is drawn anew at each step, ruled by
    `reset(seed=)`: its standard deviation is sigma * sqrt(horizon / 24 h), so sigma is that of a day ahead; or,
    with `tau_h`, that of an AR(1) path, sigma * sqrt(1 - exp(-2 horizon / tau_h)). `mu` is the mean of the error a day
    ahead, or with `tau_h` the one that it ends at. Ranges [low, high] of sigma, tau_h and mu are drawn from at each
    reset. Physical limits hold, and `low` and `high` where they are narrower.

    Args:
        columns: of an EPW, as `dry_bulb_temperature`; the third value of it is `dry_bulb_temperature_in_3h`.
        n: how many values of each column.
        spacing_h: hours between them.
        errors: column to sigma in the column's unit, or to `{"sigma": …, "tau_h": …, "mu": …, "low": …, "high": …}`.

    Raises:
        InvalidConfig: errors of a column that is not asked for, or n or spacing_h not above 0; at reset, a column
            that the file has no values of.
        UnknownName: at reset, no such column of an EPW.
    """

    logic = _Logic
