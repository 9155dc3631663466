"""A building without EnergyPlus: the attributes of `BuildingEnv` that wrappers use, and a day of made-up physics."""

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from support import builders
from zenostat.agent_sdk.envs import spaces
from zenostat.agent_sdk.envs.action_values import Actions
from zenostat.agent_sdk.envs.time_features import time_features
from zenostat.topics.errors import UnknownName
from zenostat.topics.messages import Action, Task, TimeField, WeatherSeries

COLUMNS = {"dry_bulb_temperature": "C", "relative_humidity": "%", "wind_direction": "deg", "snow_depth": "cm"}
TIME = (TimeField.MONTH, TimeField.DAY_OF_WEEK, TimeField.HOUR, TimeField.MINUTES)
NAMES = ("month", "day_of_week", "hour", "minutes", "outdoor", "core", "core_setpoint", "humidity", "electricity")
HEAT, COOL = (15.0, 22.5), (22.5, 30.0)
START = 23.0


class FakeBuilding(gym.Env[NDArray[np.float32], Any]):
    """Outdoor air by the hour with a seed's noise; the zone goes half of the way to its cooling setpoint each step."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, begin: str = "2017-07-03T00:00:00", days: int = 1, steps_per_hour: int = 4) -> None:
        heat, cool = builders.actuator("heat", *HEAT), builders.actuator("cool", *COOL)
        context = builders.actuator("occupants", 0.0, 1.0)
        humidity = builders.sensor("humidity", unit="percent").model_copy(update={"low": 0.0, "high": 100.0})
        temperatures = [builders.sensor(name) for name in ("outdoor", "core", "core_setpoint")]
        actions = tuple(
            Action(name=a.name, unit=a.unit, low=a.low, high=a.high, actuators=(a.name,)) for a in (heat, cool)
        )
        manifest = builders.manifest(
            sensors=[*temperatures, humidity],
            meters=[builders.meter("electricity")],
            actuators=[heat, cool, context],
            task=Task(time=TIME, actions=actions),
        )
        steps = days * 24 * steps_per_hour
        self.manifest = manifest.model_copy(update={"begin": begin, "step_s": 3600.0 / steps_per_hour, "steps": steps})
        self.observation_space = spaces.observation_space(self.manifest)
        self._actions = Actions(self.manifest)
        self.action_space = self._actions.space
        self.observation_names, self.action_names = NAMES, ("heat", "cool")
        self._begin, self._timestep, self._days = (
            datetime.fromisoformat(begin),
            timedelta(seconds=3600.0 / steps_per_hour),
            days,
        )
        self._step, self._core, self._context = 0, START, 0.0
        self.commands: list[list[float]] = []
        self.contexts: list[tuple[int, dict[str, float | None]]] = []
        self.asked: list[list[str]] = []
        self.closed = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        assert not options
        hours = np.arange(1, 24 * (self._days + 7) + 1)
        noise = self.np_random.normal(0.0, 1.0, len(hours))
        self.series = {
            "dry_bulb_temperature": 20.0 + 8.0 * np.sin(2 * np.pi * (hours - 9) / 24) + noise,
            "relative_humidity": np.clip(60.0 + 10.0 * noise, 0.0, 100.0),
            "wind_direction": (30.0 * hours) % 360.0,
            "snow_depth": np.full(len(hours), np.nan),
        }
        self._step, self._core, self._context = 0, START, 0.0
        self.commands, self.contexts = [], []
        return self._observed(self._begin, 26.0, 0.0), {**self._info([builders.NAN] * 3), "weather": "made up"}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        heat, cool, _ = self._actions.values(action).tolist()
        self.commands.append([heat, cool])
        begin = self.time
        self._step += 1
        self._core += 0.5 * (cool - self._core)
        joules = 1000.0 * (30.0 - cool)
        info = self._info([heat, cool, self._context])
        energy, comfort = -1e-3 * joules, -abs(self._core - 24.0)
        info["reward_terms"] = {"energy": energy, "comfort": comfort}
        info["reward_metrics"] = {"joules": joules}
        return self._observed(begin, cool, joules), energy + comfort, False, self._step == self.manifest.steps, info

    @property
    def time(self) -> datetime:
        return self._begin + self._step * self._timestep

    def outdoor(self, column: str, ahead_h: float = 0.0) -> float:
        """Linear between the hours."""
        hours = self._step * self._timestep.total_seconds() / 3600 + ahead_h
        values = self.series[column]
        return float(np.interp(hours, np.arange(1, len(values) + 1), values))

    def _observed(self, begin: datetime, setpoint: float, joules: float) -> NDArray[np.float32]:
        sensors = [
            self.outdoor("dry_bulb_temperature"),
            self._core,
            setpoint,
            self.outdoor("relative_humidity"),
            joules,
        ]
        return np.concatenate([time_features(TIME, begin, self.time), sensors]).astype(np.float32)

    def _info(self, effective: list[float]) -> dict[str, Any]:
        info = {"time": self.time.isoformat(), "step": self._step, "late": 0, "rejected": 0}
        return {**info, "effective": np.array(effective)}

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        self.asked.append(list(columns))
        if unknown := [name for name in columns if name not in COLUMNS]:
            raise UnknownName(f"no weather column {unknown[0]!r}")
        values = np.column_stack([self.series[name] for name in columns]).astype("<f8").tobytes()
        units = [COLUMNS[name] for name in columns]
        return WeatherSeries(episode=0, columns=list(columns), units=units, step_s=3600.0, values=values)

    def set_context(self, values: Mapping[str, float | None]) -> None:
        self._actions.context(values)
        self.contexts.append((self._step, dict(values)))
        self._context = values.get("occupants", self._context) or 0.0

    def close(self) -> None:
        self.closed += 1
