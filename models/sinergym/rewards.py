"""The reward of a Sinergym configuration, as a kind of `agent_sdk.rewards` and its parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from datetime import date
from pathlib import Path
from typing import Any

from models import data_packs
from models.sinergym.section_reader import SectionReader
from topics.errors import did_you_mean

MODULE = "sinergym.utils.rewards:"

_NUMBERS = {"lambda_energy": 1.0, "lambda_temperature": 1.0}
_BANDS = {"range_comfort_winter": "winter", "range_comfort_summer": "summer"}
_DAYS = {"summer_start": ("summer_begin", [6, 1]), "summer_final": ("summer_end", [9, 30])}
_ZONES = ("temperature_variables", *_BANDS, *_DAYS)
_PRICES = "energy_cost_data_path"
"""The file that Sinergym's `EnergyCostWrapper` reads; here the reward may name it."""

_PACKED_PRICES = "PVPC_active_energy_billing_Iberian_Peninsula_2023.csv"
"""Sinergym's own file of prices: what its class has in mind, which has no argument for a file."""


class RewardReader:
    """Reads the reward of a configuration; what is wrong goes to `fields`.

    Args:
        fields: the configuration.
        path: its file; a file of prices may lie beside it.
        renamed: the observations, by the names that the configuration has for them.
        pack: the data pack, which has a file of prices.
    """

    def __init__(self, fields: SectionReader, path: Path, renamed: Mapping[str, str], pack: str) -> None:
        self._fields, self._path, self._renamed, self._pack = fields, path, renamed, pack
        self._given = fields.mapping("reward_kwargs")
        self._forms: dict[str, Callable[[], dict[str, Any]]] = {
            "LinearReward": self._linear,
            "ExpReward": self._exponential,
            "HourlyLinearReward": self._hourly,
            "NormalizedLinearReward": self._normalised,
            "MultiZoneReward": self._multi_zone,
            "EnergyCostLinearReward": self._energy_cost,
        }

    def read(self) -> dict[str, Any]:
        """The reward; empty where it is not known."""
        kind = self._fields.given.get("reward")
        form = self._forms.get(kind.removeprefix(MODULE)) if isinstance(kind, str) and kind.startswith(MODULE) else None
        if kind is not None and form is None:
            known = ", ".join(repr(MODULE + name) for name in self._forms)
            self._fields.add_error(f"reward: {kind!r} is not known here; what is known: {known}")
        if form is None or self._fields.given.get("reward_kwargs") is None:
            return {}
        return form()

    # The classes

    def _linear(self) -> dict[str, Any]:
        self._known("energy_weight", "energy_variables", *_NUMBERS, *_ZONES)
        return {"kind": "linear", **self._weights(), **self._seasons(), **self._temperatures(), **self._power()}

    def _exponential(self) -> dict[str, Any]:
        return self._linear() | {"kind": "exponential"}

    def _hourly(self) -> dict[str, Any]:
        self._known("default_energy_weight", "energy_variables", "range_comfort_hours", *_NUMBERS, *_ZONES)
        found = {"kind": "hourly", **self._weights("default_energy_weight"), "weight_outside": 1.0}
        return found | {"hours": self._hours(), **self._seasons(), **self._temperatures(), **self._power()}

    def _normalised(self) -> dict[str, Any]:
        self._known("energy_weight", "energy_variables", "max_energy_penalty", "max_comfort_penalty", *_ZONES)
        found = {"kind": "normalized", "weight": self._share("energy_weight", 0.5)}
        for name, ours, usual in (
            ("max_energy_penalty", "max_power_w", 8.0),
            ("max_comfort_penalty", "max_degrees", 12.0),
        ):
            most = self._number(name, usual)
            if most < 0:
                self._fields.add_error(f"reward_kwargs.{name}: 0 or more expected, got {most:g}")
            found[ours] = most or None
        return found | self._seasons() | self._temperatures() | self._power()

    def _multi_zone(self) -> dict[str, Any]:
        zones, threshold = "temperature_and_setpoints_conf", "comfort_threshold"
        self._known("energy_weight", "energy_variables", zones, threshold, *_NUMBERS)
        found = {"kind": "multi_zone", **self._weights(), "threshold": self._number(threshold, 0.5)}
        if found["threshold"] < 0:
            self._fields.add_error(f"reward_kwargs.{threshold}: 0 or more expected, got {found['threshold']:g}")
        given = self._given.get(zones)
        if not isinstance(given, Mapping) or not given or not all(isinstance(n, str) for n in given.values()):
            self._fields.add_error(f"reward_kwargs.{zones}: temperatures and their setpoints expected, got {given!r}")
            given = {}
        names = self._names([*map(str, given), *given.values()], f"reward_kwargs.{zones}")
        found["zones"] = dict(zip(names[: len(given)], names[len(given) :], strict=True))
        return found | self._power()

    def _energy_cost(self) -> dict[str, Any]:
        self._known(
            "energy_weight", "temperature_weight", "energy_variables", "energy_cost_variables", "lambda_energy_cost",
            _PRICES, *_NUMBERS, *_ZONES,
        )  # fmt: skip
        found = {"kind": "energy_cost", **self._weights(usual=0.4)}
        found["weight_temperature"] = self._share("temperature_weight", 0.4)
        if found["weight"] + found["weight_temperature"] > 1 + 1e-9:
            self._fields.add_error("reward_kwargs: energy_weight and temperature_weight are above 1 together")
        found["lambda_cost"] = self._number("lambda_energy_cost", 1.0)
        if self._given.get("energy_cost_variables") is not None:  # always the price that the wrapper observes
            self._fields.texts(self._given["energy_cost_variables"], "reward_kwargs.energy_cost_variables")
        found["price"] = {"csv": self._prices(), "column": "value", "unit": "EUR/MWh", "delimiter": ";"}
        return found | self._seasons() | self._temperatures() | {"energy": self._power()["power"]}

    # What they have in common

    def _known(self, *names: str) -> None:
        self._fields.known(self._given, names, "reward_kwargs: ")

    def _weights(self, weight: str = "energy_weight", usual: float = 0.5) -> dict[str, Any]:
        return {"weight": self._share(weight, usual)} | {n: self._number(n, usual) for n, usual in _NUMBERS.items()}

    def _number(self, name: str, usual: float) -> float:
        return self._fields.number(self._given.get(name, usual), f"reward_kwargs.{name}")

    def _share(self, name: str, usual: float) -> float:
        share = self._number(name, usual)
        if not 0 <= share <= 1:
            self._fields.add_error(f"reward_kwargs.{name}: 0 to 1 expected, got {share:g}")
        return share

    def _seasons(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, ours in _BANDS.items():
            low, high = self._fields.pair(self._given.get(name), f"reward_kwargs.{name}")
            found[ours] = [low, high]
            if not low < high:
                self._fields.add_error(f"reward_kwargs.{name}: [low, high] expected, got [{low:g}, {high:g}]")
        for name, (ours, usual) in _DAYS.items():
            found[ours] = self._month_day(self._given.get(name, usual), f"reward_kwargs.{name}")
        return found

    def _temperatures(self) -> dict[str, Any]:
        return {"temperatures": self._observed("temperature_variables")}

    def _power(self) -> dict[str, Any]:
        return {"power": self._observed("energy_variables")}

    def _hours(self) -> list[int]:
        """Sinergym's last hour is in it: [9, 19] is until 20:00."""
        given = self._given.get("range_comfort_hours", [9, 19])
        whole = isinstance(given, list) and len(given) == 2 and all(type(hour) is int for hour in given)
        if not whole or not 0 <= given[0] <= given[1] <= 23:
            self._fields.add_error(
                f"reward_kwargs.range_comfort_hours: [first, last] of 0 to 23 expected, got {given!r}"
            )
            return [9, 20]
        return [given[0], given[1] + 1]

    def _month_day(self, given: Any, where: str) -> list[int]:
        try:
            month, day = given
            date(2000, month, day)
        except (TypeError, ValueError) as error:
            self._fields.add_error(f"{where}: [month, day] expected, got {given!r} ({error})")
            return [1, 1]
        return [month, day]

    def _observed(self, name: str) -> list[str]:
        where = f"reward_kwargs.{name}"
        return self._names(self._fields.texts(self._given.get(name), where), where)

    def _names(self, names: Iterable[str], where: str) -> list[str]:
        """Names of observations, as they are called here."""
        names = list(names)
        for name in names:
            if name not in self._renamed:
                self._fields.add_error(
                    f"{where}: no variable or meter is called {name!r}; {did_you_mean(name, self._renamed)}"
                )
        return [self._renamed.get(name, name) for name in names]

    def _prices(self) -> str:
        """The file of prices: beside the configuration, an absolute path, or one of the data pack (left out: that)."""
        given = self._given.get(_PRICES, _PACKED_PRICES)
        if not isinstance(given, str) or not given:
            self._fields.add_error(
                f"reward_kwargs.{_PRICES}: the file of prices (as EnergyCostWrapper reads it: ';' between columns, "
                f"EUR/MWh in the column 'value') expected, got {given!r}"
            )
            return ""
        packed = (
            data_packs.root(self._pack) / "data" / "energy_cost" / given
            if data_packs.is_installed(self._pack)
            else None
        )
        for file in (self._path.parent / given, packed):
            if file is not None and file.is_file():
                return str(file.resolve())
        hint = (
            ""
            if packed is not None
            else f"; if it is of the data pack {self._pack!r}: {data_packs.command(self._pack)}"
        )
        self._fields.add_error(f"reward_kwargs.{_PRICES}: no file {given!r} beside {self._path.name}{hint}")
        return ""
