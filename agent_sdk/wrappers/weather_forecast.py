"""A wrapper that adds a weather forecast, with or without errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import EnvView, ObservationLogic, ResetBatch, StepBatch, Values, append
from zenostat.agent_sdk.wrappers.names import indices_of, require_mapping
from zenostat.agent_sdk.wrappers.random_streams import SlotRandomStreams
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import WeatherSeries
from zenostat.topics.weather import WeatherColumn

_WIND_DIRECTION = "wind_direction"
_BOUNDS = {"relative_humidity": (0.0, 110.0), _WIND_DIRECTION: (0.0, 360.0)} | {
    f"{kind}_sky_cover": (0.0, 10.0) for kind in ("total", "opaque")
}
_NOT_NEGATIVE = ("radiation", "illuminance", "luminance", "speed", "pressure", "depth", "visibility", "height")
_MAX_ERROR = 1e9
"""Largest sigma and mu; observations are float32."""


def _bounds(column: str) -> tuple[float, float]:
    floor = 0.0 if any(word in column for word in _NOT_NEGATIVE) else -np.inf
    return _BOUNDS.get(column, (floor, np.inf))


class ErrorModel(NamedTuple):
    """Error of the forecast of one column, in its unit; if `tau_h` is None, the error grows without bound."""

    sigma: float
    tau_h: float | None = None
    mu: float = 0.0


class ErrorSpec(NamedTuple):
    """Distribution of an episode's `ErrorModel`: numbers or ranges (low, high); and limits of the forecast values."""

    sigma: Any
    tau_h: Any = None
    mu: Any = 0.0
    low: float = -np.inf
    high: float = np.inf

    @classmethod
    def read(cls, value: Any, label: str) -> ErrorSpec:
        """Return the specification from a number or `{"sigma": …, "tau_h": …, "mu": …, "low": …, "high": …}`.

        Raises:
            InvalidConfig: the value has another form, or a number is out of range; the error begins with `label`.
        """
        try:
            spec = cls(**value) if isinstance(value, Mapping) else cls(float(value))
            (min_sigma, max_sigma), (min_mu, max_mu) = _range(spec.sigma), _range(spec.mu)
            min_tau_h, max_tau_h = (1.0, 1.0) if spec.tau_h is None else _range(spec.tau_h)
            is_valid = (
                0 <= min_sigma <= max_sigma <= _MAX_ERROR
                and -_MAX_ERROR <= min_mu <= max_mu <= _MAX_ERROR
                and 0 < min_tau_h <= max_tau_h < np.inf
                and float(spec.low) < float(spec.high)
            )
        except (TypeError, ValueError):
            is_valid = False
        if not is_valid:
            raise InvalidConfig(
                f'{label}: an error is sigma or {{"sigma": …, "tau_h": …, "mu": …, "low": …, "high": …}}, the first '
                f"three of them numbers or ranges [low, high], sigma and mu up to {_MAX_ERROR:g}; got {value!r}"
            )
        return spec

    def draw(self, rng: np.random.Generator) -> ErrorModel:
        """Draw an episode's error model; ranges are uniform distributions."""

        def draw(value: Any) -> float:
            low, high = _range(value)
            return float(rng.uniform(low, high)) if low < high else low

        return ErrorModel(draw(self.sigma), None if self.tau_h is None else draw(self.tau_h), draw(self.mu))


def _range(value: Any) -> tuple[float, float]:
    low, high = value if isinstance(value, Sequence) else (value, value)
    return float(low), float(high)


def error_path(normal: Floats, horizons_h: Floats, model: ErrorModel) -> Floats:
    """Return the errors along a forecast, shape (…, horizons).

    The path starts at 0 at horizon 0. Without `tau_h` it is a random walk with the standard deviation
    sigma * sqrt(horizon / 24 h) and the mean mu * horizon / 24 h. With `tau_h` it is an AR(1) process with
    phi = exp(-spacing / tau), the standard deviation sigma * sqrt(1 - exp(-2 horizon / tau)), which approaches sigma,
    and the mean mu * (1 - exp(-horizon / tau)), which approaches mu.

    Args:
        normal: standard normal numbers, shape (…, horizons).
        horizons_h: horizons in hours, ascending, shape (horizons,).
        model: the error model.
    """
    spacing = np.diff(horizons_h, prepend=0.0)
    if model.tau_h is None:
        phi, scale = np.ones_like(spacing), np.sqrt(spacing / 24.0)
    else:
        phi, scale = np.exp(-spacing / model.tau_h), np.sqrt(-np.expm1(-2.0 * spacing / model.tau_h))
    path, error = np.empty_like(normal), np.zeros(normal.shape[:-1])
    for i in range(len(horizons_h)):
        error = phi[i] * error + model.sigma * scale[i] * normal[..., i]
        path[..., i] = error
    mean_share = horizons_h / 24.0 if model.tau_h is None else -np.expm1(-horizons_h / model.tau_h)
    return path + model.mu * mean_share


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
        indices_of(columns, columns, view.wrapper_name, "column")
        if not isinstance(n, int | np.integer):
            raise InvalidConfig(f"{view.wrapper_name}: n = {n!r}; a whole number expected")
        if not isinstance(spacing_h, int | float | np.number):
            raise InvalidConfig(f"{view.wrapper_name}: spacing_h = {spacing_h!r}; a number of hours expected")
        if not (columns and n > 0 and 0 < spacing_h < np.inf):
            raise InvalidConfig(
                f"{view.wrapper_name}: columns has to name at least one column, with n and spacing_h above 0"
            )
        require_mapping({} if errors is None else errors, f"{view.wrapper_name}: errors", "{column: error}")
        indices_of(errors or {}, columns, view.wrapper_name, "column")
        self._columns = list(columns)
        self._horizons_h = spacing_h * np.arange(1, n + 1, dtype=np.float64)
        self._errors = {
            name: ErrorSpec.read(value, f"{view.wrapper_name}: {name}") for name, value in (errors or {}).items()
        }
        self._models: list[dict[str, ErrorModel]] = [{} for _ in range(view.slots)]
        self._bounds = np.array([self._limits(column) for column in columns])
        self._randoms = SlotRandomStreams(view.env, view.wrapper_name, view.slots)
        self._weather: list[list[WeatherColumn]] = [[] for _ in range(view.slots)]
        self._starts: dict[int, datetime] = {}
        self._timestep = view.manifest.timestep
        low, high = np.repeat(self._bounds, n, axis=0).T
        self.extend([f"{column}_in_{hour:g}h" for column in columns for hour in self._horizons_h], low, high)

    def observe(self, batch: ResetBatch | StepBatch, *, is_reset: bool) -> Values:
        if is_reset:
            assert isinstance(batch, ResetBatch)
            self._fetch(batch)
        forecasts = [self._forecast(slot, batch.infos.time(row)) for row, slot in enumerate(batch.slots)]
        return append(batch.observations, np.array(forecasts))

    def _limits(self, column: str) -> tuple[float, float]:
        low, high = _bounds(column)
        error = self._errors.get(column, ErrorSpec(0.0))
        return max(low, float(error.low)), min(high, float(error.high))

    def _fetch(self, start: ResetBatch) -> None:
        self._randoms.seed(start.slots, start.seeds)
        series = self.view.call(start.slots, "weather", self._columns)
        for row, slot in enumerate(start.slots):
            self._weather[slot] = self._read(series[row])
            self._models[slot] = {name: spec.draw(self._randoms[slot]) for name, spec in self._errors.items()}
            self._starts[slot] = start.infos.time(row) - start.infos.step(row) * self._timestep

    def _read(self, series: WeatherSeries) -> list[WeatherColumn]:
        rows = np.frombuffer(series.values, "<f8").reshape(-1, len(series.columns))
        columns = []
        for name, values in zip(series.columns, rows.T, strict=True):
            if not np.isfinite(values).any():
                raise InvalidConfig(f"{self.view.wrapper_name}: the episode's weather file has no values of {name!r}")
            columns.append(WeatherColumn(values, series.step_s, period=360.0 if name == _WIND_DIRECTION else None))
        return columns

    def _forecast(self, slot: int, now: datetime) -> Floats:
        times_s: Floats = (now - self._starts[slot]).total_seconds() + 3600.0 * self._horizons_h
        forecast = np.array([column.at(times_s) for column in self._weather[slot]])
        for i, name in enumerate(self._columns):
            if name in self._errors:
                normal = self._randoms[slot].standard_normal(len(times_s))
                forecast[i] += error_path(normal, self._horizons_h, self._models[slot][name])
                if name == _WIND_DIRECTION:
                    forecast[i] %= 360.0
        bounded: Floats = np.clip(forecast, self._bounds[:, :1], self._bounds[:, 1:])
        return bounded.reshape(-1)

    def get_state(self) -> list[dict[str, Any]]:
        """Return the random generators' state and the drawn error models; the next reset fetches the weather."""
        models = [{name: model._asdict() for name, model in slot_models.items()} for slot_models in self._models]
        return [{**state, "errors": errors} for state, errors in zip(self._randoms.get_state(), models, strict=True)]

    def set_state(self, slots: Sequence[Mapping[str, Any]]) -> None:
        self._randoms.set_state(slots)
        for slot, state in enumerate(slots):
            self._models[slot] = {name: ErrorModel(**model) for name, model in state.get("errors", {}).items()}


class WeatherForecast(BuildingWrapper):
    """Append a weather forecast: columns of the weather file that this episode reads, including its noise.

    The values are those at `spacing_h`, 2 `spacing_h`, … after the sample, interpolated linearly between the rows of
    the file (over the shorter arc for `wind_direction`), as EnergyPlus does for instantaneous quantities. A row of a
    radiation is the mean of the hour that ends at its time. The first hour begins with the values of hour 24 of that
    day, as in EnergyPlus. After the last row, whose time is a week after the episode's end, its value is held. A
    missing value is what EnergyPlus takes in its place, such as 0 for the sun; in a column that EnergyPlus does not
    use, it is skipped.

    With `errors`, a path of errors is added to the forecast. It starts at 0 now and is drawn again at each step, from
    the seed of `reset`. Its standard deviation is sigma * sqrt(horizon / 24 h), so sigma is that of a day ahead; with
    `tau_h` it is that of an AR(1) process, sigma * sqrt(1 - exp(-2 horizon / tau_h)). `mu` is the mean error a day
    ahead; with `tau_h`, the mean that the error approaches. Ranges [low, high] of sigma, tau_h and mu are drawn from
    uniformly at each reset. Values are clipped to physical limits, and to `low` and `high` where these are narrower.

    Args:
        columns: columns of an EPW file, such as `dry_bulb_temperature`; its value 3 h ahead is named
            `dry_bulb_temperature_in_3h`.
        n: number of values of each column; 5 by default.
        spacing_h: hours between them; 1 by default.
        errors: sigma in the column's unit, or `{"sigma": …, "tau_h": …, "mu": …, "low": …, "high": …}`, by column;
            none by default.

    Raises:
        InvalidConfig: `errors` names a column that `columns` does not, or n or spacing_h is not above 0; at reset, the
            file has no values of a column.
        UnknownName: at reset, an EPW file has no such column.
    """

    logic = _Logic
