"""Convert the reward of a Sinergym configuration to a reward of `zenostat.rewards`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from datetime import date
from pathlib import Path
from typing import Any

from zenostat.models import data_packs
from zenostat.models.sinergym.section_reader import SectionReader
from zenostat.topics.errors import did_you_mean

MODULE = "sinergym.utils.rewards:"

_NUMBERS = {"lambda_energy": 1.0, "lambda_temperature": 1.0}
_BANDS = {"range_comfort_winter": "winter", "range_comfort_summer": "summer"}
_DAYS = {"summer_start": ("summer_begin", [6, 1]), "summer_final": ("summer_end", [9, 30])}
_ZONES = ("temperature_variables", *_BANDS, *_DAYS)
_PRICES = "energy_cost_data_path"
"""The setting for the file that Sinergym's `EnergyCostWrapper` reads; here the reward may have it."""

_PACK_PRICES = "PVPC_active_energy_billing_Iberian_Peninsula_2023.csv"
"""Sinergym's own file of prices, the default, because its reward class has no argument for a file."""


class RewardReader:
    """Reads the reward of a configuration and adds its errors to those of the configuration.

    Args:
        config: the configuration.
        path: its file; a file of prices may be next to it.
        renamed: the names of the observations, by their names in the configuration.
        pack: the data pack, which has a file of prices.
    """

    def __init__(self, config: SectionReader, path: Path, renamed: Mapping[str, str], pack: str) -> None:
        self._config, self._path, self._renamed, self._pack = config, path, renamed, pack
        self._settings = config.mapping("reward_kwargs")
        self._readers: dict[str, Callable[[], dict[str, Any]]] = {
            "LinearReward": self._linear,
            "ExpReward": self._exponential,
            "HourlyLinearReward": self._hourly,
            "NormalizedLinearReward": self._normalized,
            "MultiZoneReward": self._multi_zone,
            "EnergyCostLinearReward": self._energy_cost,
        }

    def read(self) -> dict[str, Any]:
        """Return the reward; empty, with an error, if it is unknown."""
        kind = self._config.settings.get("reward")
        read_reward = (
            self._readers.get(kind.removeprefix(MODULE)) if isinstance(kind, str) and kind.startswith(MODULE) else None
        )
        if kind is not None and read_reward is None:
            known = ", ".join(repr(MODULE + name) for name in self._readers)
            self._config.add_error(f"reward: unknown reward {kind!r}; known are {known}")
        if read_reward is None or self._config.settings.get("reward_kwargs") is None:
            return {}
        return read_reward()

    # One method for each of Sinergym's reward classes

    def _linear(self) -> dict[str, Any]:
        self._check_names("energy_weight", "energy_variables", *_NUMBERS, *_ZONES)
        return {"kind": "linear", **self._weights(), **self._seasons(), **self._temperatures(), **self._power()}

    def _exponential(self) -> dict[str, Any]:
        return self._linear() | {"kind": "exponential"}

    def _hourly(self) -> dict[str, Any]:
        self._check_names("default_energy_weight", "energy_variables", "range_comfort_hours", *_NUMBERS, *_ZONES)
        reward = {"kind": "hourly", **self._weights("default_energy_weight"), "weight_outside": 1.0}
        return reward | {"hours": self._hours(), **self._seasons(), **self._temperatures(), **self._power()}

    def _normalized(self) -> dict[str, Any]:
        self._check_names("energy_weight", "energy_variables", "max_energy_penalty", "max_comfort_penalty", *_ZONES)
        reward = {"kind": "normalized", "weight": self._share("energy_weight", 0.5)}
        for name, parameter, default in (
            ("max_energy_penalty", "max_power_w", 8.0),
            ("max_comfort_penalty", "max_degrees", 12.0),
        ):
            limit = self._number(name, default)
            if limit < 0:
                self._config.add_error(f"reward_kwargs.{name}: expected at least 0, got {limit:g}")
            reward[parameter] = limit or None
        return reward | self._seasons() | self._temperatures() | self._power()

    def _multi_zone(self) -> dict[str, Any]:
        zones, threshold = "temperature_and_setpoints_conf", "comfort_threshold"
        self._check_names("energy_weight", "energy_variables", zones, threshold, *_NUMBERS)
        reward = {"kind": "multi_zone", **self._weights(), "threshold": self._number(threshold, 0.5)}
        if reward["threshold"] < 0:
            self._config.add_error(f"reward_kwargs.{threshold}: expected at least 0, got {reward['threshold']:g}")
        value = self._settings.get(zones)
        if not isinstance(value, Mapping) or not value or not all(isinstance(n, str) for n in value.values()):
            self._config.add_error(f"reward_kwargs.{zones}: expected temperatures and their setpoints, got {value!r}")
            value = {}
        names = self._names([*map(str, value), *value.values()], f"reward_kwargs.{zones}")
        reward["zones"] = dict(zip(names[: len(value)], names[len(value) :], strict=True))
        return reward | self._power()

    def _energy_cost(self) -> dict[str, Any]:
        self._check_names(
            "energy_weight", "temperature_weight", "energy_variables", "energy_cost_variables", "lambda_energy_cost",
            _PRICES, *_NUMBERS, *_ZONES,
        )  # fmt: skip
        reward = {"kind": "energy_cost", **self._weights(default=0.4)}
        reward["weight_temperature"] = self._share("temperature_weight", 0.4)
        if reward["weight"] + reward["weight_temperature"] > 1 + 1e-9:
            self._config.add_error("reward_kwargs: the sum of energy_weight and temperature_weight is above 1")
        reward["lambda_cost"] = self._number("lambda_energy_cost", 1.0)
        if self._settings.get("energy_cost_variables") is not None:  # always the price that the wrapper observes
            self._config.texts(self._settings["energy_cost_variables"], "reward_kwargs.energy_cost_variables")
        reward["price"] = {"csv": self._prices(), "column": "value", "unit": "EUR/MWh", "delimiter": ";"}
        return reward | self._seasons() | self._temperatures() | {"energy": self._power()["power"]}

    # Common settings

    def _check_names(self, *names: str) -> None:
        self._config.check_names(self._settings, names, "reward_kwargs: ")

    def _weights(self, weight: str = "energy_weight", default: float = 0.5) -> dict[str, Any]:
        return {"weight": self._share(weight, default)} | {
            n: self._number(n, default) for n, default in _NUMBERS.items()
        }

    def _number(self, name: str, default: float) -> float:
        return self._config.number(self._settings.get(name, default), f"reward_kwargs.{name}")

    def _share(self, name: str, default: float) -> float:
        share = self._number(name, default)
        if not 0 <= share <= 1:
            self._config.add_error(f"reward_kwargs.{name}: expected a number from 0 to 1, got {share:g}")
        return share

    def _seasons(self) -> dict[str, Any]:
        reward: dict[str, Any] = {}
        for name, parameter in _BANDS.items():
            low, high = self._config.pair(self._settings.get(name), f"reward_kwargs.{name}")
            reward[parameter] = [low, high]
            if not low < high:
                self._config.add_error(f"reward_kwargs.{name}: expected [low, high], got [{low:g}, {high:g}]")
        for name, (parameter, default) in _DAYS.items():
            reward[parameter] = self._month_day(self._settings.get(name, default), f"reward_kwargs.{name}")
        return reward

    def _temperatures(self) -> dict[str, Any]:
        return {"temperatures": self._observed("temperature_variables")}

    def _power(self) -> dict[str, Any]:
        return {"power": self._observed("energy_variables")}

    def _hours(self) -> list[int]:
        """Sinergym's last hour is in it: [9, 19] is until 20:00."""
        value = self._settings.get("range_comfort_hours", [9, 19])
        whole = isinstance(value, list) and len(value) == 2 and all(type(hour) is int for hour in value)
        if not whole or not 0 <= value[0] <= value[1] <= 23:
            self._config.add_error(
                f"reward_kwargs.range_comfort_hours: expected [first, last] of 0 to 23, got {value!r}"
            )
            return [9, 20]
        return [value[0], value[1] + 1]

    def _month_day(self, value: Any, setting: str) -> list[int]:
        try:
            month, day = value
            date(2000, month, day)
        except (TypeError, ValueError) as error:
            self._config.add_error(f"{setting}: expected [month, day], got {value!r} ({error})")
            return [1, 1]
        return [month, day]

    def _observed(self, name: str) -> list[str]:
        setting = f"reward_kwargs.{name}"
        return self._names(self._config.texts(self._settings.get(name), setting), setting)

    def _names(self, names: Iterable[str], setting: str) -> list[str]:
        """Convert names of observations to those used here."""
        names = list(names)
        for name in names:
            if name not in self._renamed:
                self._config.add_error(
                    f"{setting}: no variable or meter is called {name!r}; {did_you_mean(name, self._renamed)}"
                )
        return [self._renamed.get(name, name) for name in names]

    def _prices(self) -> str:
        """Return the file of prices: next to the configuration, an absolute path, or in the data pack (the default)."""
        value = self._settings.get(_PRICES, _PACK_PRICES)
        if not isinstance(value, str) or not value:
            self._config.add_error(
                f"reward_kwargs.{_PRICES}: expected the file of prices (as EnergyCostWrapper reads it: ';' between "
                f"columns, EUR/MWh in the column 'value'), got {value!r}"
            )
            return ""
        in_pack = (
            data_packs.root(self._pack) / "data" / "energy_cost" / value
            if data_packs.is_installed(self._pack)
            else None
        )
        for file in (self._path.parent / value, in_pack):
            if file is not None and file.is_file():
                return str(file.resolve())
        hint = (
            ""
            if in_pack is not None
            else f"; if it is of the data pack {self._pack!r}: {data_packs.command(self._pack)}"
        )
        self._config.add_error(f"reward_kwargs.{_PRICES}: no file {value!r} next to {self._path.name}{hint}")
        return ""
