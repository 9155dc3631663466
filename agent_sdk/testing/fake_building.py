"""A building in a few lines of arithmetic, with the manifest of a real node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent_sdk.testing.climate import Climate, weather_series
from agent_sdk.testing.fake_manifest import Run, manifest_of
from agent_sdk.testing.rc_zones import RCZones, Zone, ZoneStep
from topics.errors import InvalidConfig, ModelError
from topics.messages import WeatherSeries

Floats = NDArray[np.float64]

OPEN_HOURS = range(8, 18)
"""On weekdays; people are there and the equipment is on."""

_OPEN_DEGC, _CLOSED_DEGC = (20.0, 25.0), (16.0, 28.0)
_STANDBY = 0.1
_PERSON_W = 100.0
_START_DEGC = 21.0
_WEEK_H = 168


class FakeBuilding:
    """A few rooms with thermostats, for tests: no EnergyPlus, no other process, deterministic.

    Each zone is a heat capacity behind a thermal resistance (`RCZones`) in a sinusoidal climate. Its gains are people
    (100 W each), equipment and sunlight. HVAC power is heat divided by `cop`. While nobody sets them, thermostats
    keep 20 to 25 degC while the building is open (weekdays, 8 to 18 o'clock) and 16 to 28 degC else; equipment is on
    while it is open and at a tenth else. All zones begin at 21 degC.

    Args:
        zones: how many, or each of them.
        climate: outdoors.
        cop: heat that comes with each unit of electricity, heating and cooling alike.
        begin, end: first and last day, MM-DD (of 2017, when July begins on a Saturday) or YYYY-MM-DD; `end` is
            `begin` if left out.
        steps_per_hour: timesteps an hour.
        control: `point` or `zone`: an action for each setpoint; `building`: one heating and one cooling setpoint for
            all zones.
        actions: the action's dimensions by name, each with the actuators that it sets, in place of `control`.
        discrete: number of equal steps from the widest to the tightest setpoints; None: continuous.
        time: fields of the clock that are observed.
        reward: of the task: a kind and its parameters; None: no reward.
        terminate: limits as in a scenario file: points, low, high, for_h.
        dimming: whether there is an actuator `equipment` (0 to 1) for all zones, of a schedule as EnergyPlus has it.

    Attributes:
        manifest: as a real node's.
        flow: what happened in the latest timestep.
        gains_w: people, equipment and sunlight in it, shape (zones,).

    Raises:
        InvalidConfig: what cannot be.
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
        dimming: bool = False,
    ) -> None:
        if not cop > 0.0:
            raise InvalidConfig(f"cop = {cop}; more than 0 expected")
        self.zones = _zones(zones)
        self.run = Run.read(begin, end, steps_per_hour)
        self.manifest = manifest_of(
            self.zones, self.run, dimming, control, actions, discrete, tuple(time), reward, terminate
        )
        self.climate, self._cop, self._dimming = climate, cop, dimming
        self._rooms = RCZones(self.zones)
        self._people = np.array([z.people for z in self.zones])
        self._equipment_w = np.array([z.equipment_w for z in self.zones])
        self._aperture_m2 = np.array([z.aperture_m2 for z in self.zones])
        self._seeds = np.random.SeedSequence(0)
        self._episode, self._step = -1, 0

    @property
    def now(self) -> datetime:
        """Simulated time."""
        return self.run.begin + timedelta(seconds=self._step * self.run.step_s)

    @property
    def step(self) -> int:
        """Timesteps since the episode began."""
        return self._step

    def reset(self, seed: int | None = None) -> Floats:
        """An episode begins: the values of sample 0, shape (points,).

        The same seed gives the same weather; without one it is the next of the sequence that the last seed began
        (0 at first).
        """
        if seed is not None:
            self._seeds = np.random.SeedSequence(seed)
        random = np.random.default_rng(self._seeds.spawn(1)[0])
        rows = self.run.steps + _WEEK_H * self.run.steps_per_hour + 1
        self._outdoor, self._sun = self.climate.series(self.run.begin, rows, self.run.step_s, random)
        self._episode, self._step = self._episode + 1, 0
        start = np.full(len(self.zones), _START_DEGC)
        self.flow, self.gains_w = ZoneStep(start, start, np.zeros_like(start)), np.zeros_like(start)
        return self._values(0.0, self.run.begin)

    def advance(self, commanded: Floats) -> tuple[Floats, Floats]:
        """One timestep.

        Args:
            commanded: shape (actuators,), in manifest order and units; NaN is the building's own control.

        Returns:
            Values, shape (points,), and what each actuator really was, shape (actuators,).

        Raises:
            ModelError: a heating setpoint above the cooling setpoint; EnergyPlus ends a run on that, too.
        """
        began = self.now
        effective = np.where(np.isnan(commanded), self.own_control, commanded)
        setpoints = effective[: 2 * len(self.zones)].reshape(-1, 2)
        self._check(setpoints)
        self._step += 1
        equipment_w = float(effective[-1] if self._dimming else _used(began)) * self._equipment_w
        people_w = _PERSON_W * self._people * _is_open(began)
        self.gains_w = people_w + equipment_w + self._aperture_m2 * self._sun[self._step]
        outdoor = float(self._outdoor[self._step])
        heating, cooling = setpoints.T
        self.flow = self._rooms.step(self.flow.end_degc, outdoor, self.gains_w, heating, cooling, self.run.step_s)
        return self._values(float(equipment_w.sum()), began), effective

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Columns of the episode's weather and of a week after it.

        Raises:
            UnknownName: others than `dry_bulb_temperature` and `global_horizontal_radiation`.
        """
        return weather_series(columns, self._outdoor, self._sun, self._episode, self.run.step_s)

    @property
    def own_control(self) -> Floats:
        """What the building sets each actuator to in the timestep that begins now, shape (actuators,)."""
        began = self.now
        heating, cooling = _OPEN_DEGC if _is_open(began) else _CLOSED_DEGC
        own = [heating, cooling] * len(self.zones) + [_used(began)] * self._dimming
        return np.array(own)

    def _check(self, setpoints: Floats) -> None:
        for zone, (heating, cooling) in zip(self.zones, setpoints.tolist(), strict=True):
            if heating > cooling:
                raise ModelError(
                    f"zone {zone.name!r}: heating setpoint {heating:g} lies above cooling setpoint {cooling:g}"
                )

    def _values(self, equipment_w: float, began: datetime) -> Floats:
        """Sensors and meters, in manifest order."""
        power_w = float(np.abs(self.flow.heat_w).sum()) / self._cop
        values = [float(self._outdoor[self._step]), power_w]
        people = self._people * _is_open(began)
        for temperature, count in zip(self.flow.end_degc.tolist(), people.tolist(), strict=True):
            values += [temperature, count]
        return np.array([*values, (power_w + equipment_w) * self.run.step_s, power_w * self.run.step_s])


def _zones(given: int | Sequence[Zone]) -> tuple[Zone, ...]:
    if isinstance(given, int):
        given = [Zone(f"zone_{number}", aperture_m2=0.5 * number) for number in range(1, given + 1)]
    zones = tuple(given)
    names = [zone.name.upper() for zone in zones]
    if not zones or len(set(names)) < len(names):
        raise InvalidConfig("zones: at least one expected, each with a name of its own (in any case)")
    return zones


def _is_open(began: datetime) -> bool:
    return began.weekday() < 5 and began.hour in OPEN_HOURS


def _used(began: datetime) -> float:
    return 1.0 if _is_open(began) else _STANDBY
