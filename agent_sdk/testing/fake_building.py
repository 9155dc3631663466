"""Building model for tests, with the manifest of a real node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from zenostat.agent_sdk.testing.climate import Climate, weather_series
from zenostat.agent_sdk.testing.fake_manifest import RunPeriod, build_manifest, with_unobserved
from zenostat.agent_sdk.testing.rc_zones import RCZones, Zone, ZoneStep
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, ModelError
from zenostat.topics.messages import WeatherSeries

OPEN_HOURS = range(8, 18)
"""Hours on weekdays at which the zones are occupied and the equipment is on."""

_OPEN_DEGC, _CLOSED_DEGC = (20.0, 25.0), (16.0, 28.0)
_STANDBY = 0.1
_PERSON_W = 100.0
_START_DEGC = 21.0
_WEEK_H = 168


class FakeBuilding:
    """A deterministic building of a few zones with thermostats, for tests without EnergyPlus or another process.

    Each zone is a heat capacity behind a thermal resistance (`RCZones`) in a sinusoidal climate. Its heat gains are
    people (100 W each), equipment and solar radiation. HVAC power is heat divided by `cop`. Under baseline control,
    thermostats keep 20 to 25 degC while the building is open (weekdays, 8 to 18 o'clock) and 16 to 28 degC otherwise;
    equipment is on while the building is open and at 10 % otherwise. All zones start at 21 degC.

    Args:
        zones: number of zones, or the zones.
        climate: outdoor climate.
        cop: coefficient of performance of heating and cooling.
        begin, end: first and last day, MM-DD (of 2017, in which July starts on a Saturday) or YYYY-MM-DD; the default
            of `end` is `begin`.
        steps_per_hour: timesteps per hour.
        control: `point` or `zone`: one action for each setpoint; `building`: one heating and one cooling setpoint for
            all zones.
        actions: actuators by the name of the action that sets them, instead of `control`.
        discrete: number of equal steps from the widest to the tightest setpoints; None: continuous.
        time: time features.
        reward: kind and parameters of the task's reward; None: no reward.
        terminate: termination limits as in a scenario file: points, low, high, duration_h.
        unobserved: names of sensors and meters that are not part of the observation.
        equipment_control: whether there is an actuator `equipment` (0 to 1) for the equipment of all zones, with the
            type of an EnergyPlus schedule.

    Attributes:
        manifest: manifest as of a real node.
        zone_step: temperatures and heat of the latest timestep.
        gains_w: heat gains in the latest timestep, shape (zones,).

    Raises:
        InvalidConfig: an argument is invalid.
    """

    def __init__(
        self,
        zones: int | Sequence[Zone] = 3,
        *,
        climate: Climate = Climate(),  # noqa: B008  # frozen
        cop: float = 3.0,
        begin: str = "07-03",
        end: str | None = None,
        steps_per_hour: int = 4,
        control: str = "point",
        actions: Mapping[str, Sequence[str]] | None = None,
        discrete: int | None = None,
        time: Sequence[str] = (),
        reward: Mapping[str, Any] | None = {"kind": "linear"},
        terminate: Sequence[Mapping[str, Any]] = (),
        unobserved: Sequence[str] = (),
        equipment_control: bool = False,
    ) -> None:
        if not cop > 0.0:
            raise InvalidConfig(f"cop = {cop}; more than 0 expected")
        self.zones = _zones(zones)
        self.run_period = RunPeriod.read(begin, end, steps_per_hour)
        self.manifest = build_manifest(
            self.zones, self.run_period, equipment_control, control, actions, discrete, tuple(time), reward, terminate
        )
        self.manifest = with_unobserved(self.manifest, unobserved)
        self.climate, self._cop, self._equipment_control = climate, cop, equipment_control
        self._rc_zones = RCZones(self.zones)
        self._people = np.array([z.people for z in self.zones])
        self._equipment_w = np.array([z.equipment_w for z in self.zones])
        self._aperture_m2 = np.array([z.aperture_m2 for z in self.zones])
        self._seeds = np.random.SeedSequence()
        self._episode, self._step = -1, 0

    @property
    def now(self) -> datetime:
        """Present simulated time."""
        return self.run_period.begin + timedelta(seconds=self._step * self.run_period.step_s)

    @property
    def step(self) -> int:
        """Timesteps since the start of the episode."""
        return self._step

    def reset(self, seed: int | None = None) -> Floats:
        """Start an episode, and return the values of sample 0, shape (points,).

        Equal seeds result in equal weather; without a seed, the sequence of the last seed continues, and
        that of a random one before the first.
        """
        if seed is not None:
            self._seeds = np.random.SeedSequence(seed)
        random = np.random.default_rng(self._seeds.spawn(1)[0])
        rows = self.run_period.steps + _WEEK_H * self.run_period.steps_per_hour + 1
        self._outdoor, self._sun = self.climate.series(self.run_period.begin, rows, self.run_period.step_s, random)
        self._episode, self._step = self._episode + 1, 0
        start = np.full(len(self.zones), _START_DEGC)
        self.zone_step, self.gains_w = ZoneStep(start, start, np.zeros_like(start)), np.zeros_like(start)
        return self._values(0.0, self.run_period.begin)

    def advance(self, commanded: Floats) -> tuple[Floats, Floats]:
        """Simulate one timestep.

        Args:
            commanded: commands, shape (actuators,), in manifest order and units; NaN: baseline control.

        Returns:
            Values, shape (points,), and effective values, shape (actuators,).

        Raises:
            ModelError: a heating setpoint is above the cooling setpoint, which EnergyPlus rejects as well.
        """
        start = self.now
        effective = np.where(np.isnan(commanded), self.baseline_control, commanded)
        setpoints = effective[: 2 * len(self.zones)].reshape(-1, 2)
        self._check(setpoints)
        self._step += 1
        equipment_w = float(effective[-1] if self._equipment_control else _equipment_share(start)) * self._equipment_w
        people_w = _PERSON_W * self._people * _is_open(start)
        self.gains_w = people_w + equipment_w + self._aperture_m2 * self._sun[self._step]
        outdoor = float(self._outdoor[self._step])
        heating, cooling = setpoints.T
        self.zone_step = self._rc_zones.step(
            self.zone_step.end_degc, outdoor, self.gains_w, heating, cooling, self.run_period.step_s
        )
        return self._values(float(equipment_w.sum()), start), effective

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Return columns of the weather of the episode and of one week after it.

        Raises:
            UnknownName: columns other than `dry_bulb_temperature` and `global_horizontal_radiation`.
        """
        return weather_series(columns, self._outdoor, self._sun, self._episode, self.run_period.step_s)

    @property
    def baseline_control(self) -> Floats:
        """Values of baseline control for the timestep that starts now, shape (actuators,)."""
        start = self.now
        heating, cooling = _OPEN_DEGC if _is_open(start) else _CLOSED_DEGC
        values = [heating, cooling] * len(self.zones) + [_equipment_share(start)] * self._equipment_control
        return np.array(values)

    def _check(self, setpoints: Floats) -> None:
        for zone, (heating, cooling) in zip(self.zones, setpoints.tolist(), strict=True):
            if heating > cooling:
                raise ModelError(
                    f"zone {zone.name!r}: heating setpoint {heating:g} is above cooling setpoint {cooling:g}"
                )

    def _values(self, equipment_w: float, start: datetime) -> Floats:
        """Return sensors and meters in manifest order."""
        power_w = float(np.abs(self.zone_step.heat_w).sum()) / self._cop
        values = [float(self._outdoor[self._step]), power_w]
        people = self._people * _is_open(start)
        for temperature, count in zip(self.zone_step.end_degc.tolist(), people.tolist(), strict=True):
            values += [temperature, count]
        return np.array([*values, (power_w + equipment_w) * self.run_period.step_s, power_w * self.run_period.step_s])


def _zones(count_or_zones: int | Sequence[Zone]) -> tuple[Zone, ...]:
    if isinstance(count_or_zones, int):
        count_or_zones = [Zone(f"zone_{i}", aperture_m2=0.5 * i) for i in range(1, count_or_zones + 1)]
    if isinstance(count_or_zones, str) or not isinstance(count_or_zones, Sequence):
        raise InvalidConfig(f"zones = {count_or_zones!r}; a number of zones, or a list of them, expected")
    zones = tuple(count_or_zones)
    names = [zone.name.upper() for zone in zones]
    if not zones or len(set(names)) < len(names):
        raise InvalidConfig("zones: expected at least one, with names that differ (ignoring case)")
    return zones


def _is_open(time: datetime) -> bool:
    return time.weekday() < 5 and time.hour in OPEN_HOURS


def _equipment_share(time: datetime) -> float:
    return 1.0 if _is_open(time) else _STANDBY
