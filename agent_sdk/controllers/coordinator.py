"""A rule-based coordinator of a district: battery, chargers and setpoints keep a limit together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf

from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, number
from zenostat.agent_sdk.rewards.district import DistrictReward, NetPower
from zenostat.agent_sdk.rewards.manifest_data import known_rewards
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.messages import Actuator, Manifest
from zenostat.topics.points import bounds, value_index

_BATTERY, _CHARGER, _COOLING = "_setpoint", "_limit", "cooling_setpoint"
_LEAST_RATIO = 0.1
"""Ratio to the limit above which a measured value shows how many kW the limit is."""
_RECOVERY_PER_H = 1.0
"""Share of the adjustment by which setpoints return in an hour."""


@dataclass(frozen=True, slots=True)
class _Battery:
    setpoint: str
    high_kw: float
    low_kw: float
    power: int
    state_of_charge: int


@dataclass(frozen=True, slots=True)
class _Charger:
    limit: str
    high_kw: float
    power: int
    needed: int
    departure: int


class DistrictCoordinator(Controller):
    """Rules that keep a district below a limit, in the order in which they cost least.

    The demand of the coming timestep is taken to be that of the last one, without batteries and chargers. What the
    limit leaves is for the chargers, first the power at which each vehicle is just full at its departure, then what
    they can take. Batteries discharge for what is missing; they charge from what would be fed in, and, below
    `charge_below`, up to that share of the limit. Where a limit is still exceeded, or the batteries are nearly empty,
    the cooling setpoints rise by up to `raise_k`; they return within an hour.

    It has the points and limits of the district's reward (kind `district`), and uses each plant's points by their
    endings: batteries by `_setpoint`, `_state_of_charge` and `_power`, chargers by `_limit`, `_needed`, `_departure`
    and `_power`, as those of grids. Setpoints are those of relative actions (`relative`).

    Args:
        manifest: manifest of the district's node.
        limit_kw: limit of the net power; None: the limits of the reward.
        margin: share of the limit that is used, above 0 to 1.
        charge_below: share of the limit up to which batteries charge from the grid, 0 to 1.
        raise_k: greatest rise of cooling setpoints, K.

    Raises:
        ControllerMismatch: the district has no reward of that kind, or there is no limit.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        limit_kw: float | None = None,
        margin: float = 0.9,
        charge_below: float = 0.5,
        raise_k: float = 2.0,
    ) -> None:
        super().__init__(manifest)
        self._limit_kw = None if limit_kw is None else number("limit_kw", limit_kw, minimum=0.0)
        self._margin = number("margin", margin, minimum=0.01, maximum=1.0)
        self._charge_below = number("charge_below", charge_below, minimum=0.0, maximum=1.0)
        self._raise_k = number("raise_k", raise_k, minimum=0.0, maximum=10.0)
        reward = next((r for r in known_rewards(manifest) if isinstance(r, DistrictReward)), None)
        if reward is None or (self._limit_kw is None and not reward.limits):
            raise ControllerMismatch(
                "the coordinator needs a district whose reward is of the kind district, with limits (or limit_kw=)"
            )
        index = value_index(manifest)
        self._net = NetPower(reward.kind, reward.consumption, reward.generation, manifest)
        self._limits = [(index[limit.point], limit.high) for limit in reward.limits]
        self._batteries, self._chargers = _batteries(manifest, index), _chargers(manifest, index)
        self._setpoints = [
            (actuator.name, index[own], bounds(actuator))
            for actuator in manifest.actuators
            if _COOLING in actuator.name and (own := actuator.baseline_sensor) is not None and own in index
        ]
        self._flexible = [b.power for b in self._batteries] + [c.power for c in self._chargers]
        self._step_h = manifest.step_h
        self._recovery = _RECOVERY_PER_H * self._step_h
        self._share, self._kw = 0.0, inf

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Forget the adjustment of the setpoints, and the limit in kW."""
        self._share, self._kw = 0.0, inf

    def act(self, sample: SampleView) -> Values:
        """Return setpoints of batteries and limits of chargers, W; and cooling setpoints, degC, None if unchanged."""
        values = sample.values.tolist()
        net_kw = float(self._net.kw(sample.values, {}))
        limit_kw = self._margin * self._limit(values, net_kw)
        flexible_kw = sum(values[power] for power in self._flexible) / 1e3
        base_kw = net_kw - flexible_kw
        stored_kw = [self._available_kw(battery, values) for battery in self._batteries]
        charging = self._share_out(limit_kw - base_kw, sum(stored_kw), values)
        load_kw = base_kw + sum(charging.values())
        commands: Values = {name: kw * 1e3 for name, kw in charging.items()}
        missing_kw = load_kw - limit_kw
        commands |= self._batteries_at(missing_kw, load_kw, limit_kw, stored_kw)
        return commands | self._setpoints_at(missing_kw - sum(stored_kw), stored_kw, values)

    def _limit(self, values: Sequence[float], net_kw: float) -> float:
        """Return the limit in kW: the given one, or that at which the first of the points would be at its limit."""
        if self._limit_kw is not None:
            return self._limit_kw
        ratio = max(values[point] / high for point, high in self._limits)
        if ratio > _LEAST_RATIO and net_kw > 0.0:
            self._kw = net_kw / ratio
        return self._kw

    def _available_kw(self, battery: _Battery, values: Sequence[float]) -> float:
        """Return the power that a battery can give in the coming timestep, as far as its state of charge shows."""
        return -battery.low_kw if values[battery.state_of_charge] > 0.05 else 0.0

    def _share_out(self, room_kw: float, stored_kw: float, values: Sequence[float]) -> dict[str, float]:
        """Return the power of each charger, kW."""
        wanted, least = {}, {}
        for charger in self._chargers:
            needed_kwh, left_h = values[charger.needed] / 3.6e6, values[charger.departure] / 3600.0
            wanted[charger.limit] = min(charger.high_kw, needed_kwh / self._step_h)
            least[charger.limit] = min(wanted[charger.limit], needed_kwh / max(left_h, self._step_h))
        first_kw, all_kw = sum(least.values()), sum(wanted.values())
        if first_kw >= room_kw:  # a departure is worth the battery, but not the limit
            share = min(max(room_kw + stored_kw, 0.0) / first_kw, 1.0) if first_kw else 0.0
            return {name: share * kw for name, kw in least.items()}
        share = min((room_kw - first_kw) / (all_kw - first_kw), 1.0) if all_kw > first_kw else 0.0
        return {name: kw + share * (wanted[name] - kw) for name, kw in least.items()}

    def _batteries_at(
        self, missing_kw: float, load_kw: float, limit_kw: float, stored_kw: Sequence[float]
    ) -> dict[str, float | None]:
        """Return the setpoint of each battery, W; they share in proportion to their power."""
        if missing_kw > 0.0:
            share = min(missing_kw / total, 1.0) if (total := sum(stored_kw)) else 0.0
            return {b.setpoint: -share * kw * 1e3 for b, kw in zip(self._batteries, stored_kw, strict=True)}
        most_kw = sum(battery.high_kw for battery in self._batteries)
        surplus_kw = max(-load_kw, self._charge_below * limit_kw - load_kw if limit_kw < inf else 0.0, 0.0)
        share = min(surplus_kw / most_kw, 1.0) if most_kw else 0.0
        return {battery.setpoint: share * battery.high_kw * 1e3 for battery in self._batteries}

    def _setpoints_at(self, missing_kw: float, stored_kw: Sequence[float], values: Sequence[float]) -> Values:
        """Return the cooling setpoints: raised while the batteries cannot give what is missing."""
        is_needed = missing_kw > 0.0 or (bool(stored_kw) and missing_kw + 0.5 * sum(stored_kw) > 0.0)
        self._share = min(self._share + 0.5, 1.0) if is_needed else max(self._share - self._recovery, 0.0)
        if not self._share:
            return {name: None for name, _, _ in self._setpoints}
        rise = self._share * self._raise_k
        return {name: min(max(values[own] + rise, low), high) for name, own, (low, high) in self._setpoints}


def _batteries(manifest: Manifest, index: Mapping[str, int]) -> list[_Battery]:
    return [
        _Battery(a.name, high / 1e3, low / 1e3, index[f"{stem}_power"], index[f"{stem}_state_of_charge"])
        for a, stem, (low, high) in _devices(manifest, _BATTERY, ("_state_of_charge", "_power"), index)
    ]


def _chargers(manifest: Manifest, index: Mapping[str, int]) -> list[_Charger]:
    return [
        _Charger(a.name, high / 1e3, index[f"{stem}_power"], index[f"{stem}_needed"], index[f"{stem}_departure"])
        for a, stem, (_, high) in _devices(manifest, _CHARGER, ("_needed", "_departure", "_power"), index)
    ]


def _devices(
    manifest: Manifest, ending: str, needs: Sequence[str], index: Mapping[str, int]
) -> list[tuple[Actuator, str, tuple[float, float]]]:
    """Return the actuators in W that have this ending, and a sensor of each needed ending; with their bounds."""
    stems = [(a, a.name.removesuffix(ending)) for a in manifest.actuators if a.name.endswith(ending) and a.unit == "W"]
    return [(a, stem, bounds(a)) for a, stem in stems if all(f"{stem}{need}" in index for need in needs)]
