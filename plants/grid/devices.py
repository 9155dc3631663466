"""Batteries and chargers of electric vehicles: energy over a timestep of constant power."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from zenostat.plants.grid.profiles import Table
from zenostat.plants.grid.schema import Battery, Charger, Draw, DrawnSessions, Session, SessionFile
from zenostat.topics.errors import InvalidConfig, did_you_mean

J_PER_KWH = 3.6e6
_DAY_S = 86400.0
_CUT = 2.0
"""Standard deviations at which a drawn value is cut."""


@dataclass(slots=True)
class BatteryState:
    """A battery as a store of energy with constant efficiencies and no self-discharge.

    With the power P at the bus, dE/dt = charge_efficiency P while it is charged (P > 0), and P / discharge_efficiency
    while it is discharged; E stays between 0 and its capacity.
    """

    battery: Battery
    energy_j: float = 0.0

    def reset(self) -> None:
        """Begin with the initial state of charge."""
        self.energy_j = self.battery.initial * self.capacity_j

    @property
    def capacity_j(self) -> float:
        """Usable energy, J."""
        return self.battery.capacity_kwh * J_PER_KWH

    @property
    def state_of_charge(self) -> float:
        """Stored energy over capacity."""
        return self.energy_j / self.capacity_j

    def power(self, setpoint_w: float, step_s: float) -> float:
        """Return the mean power that the battery takes from the bus in a timestep, W; it limits the setpoint."""
        limit_w, battery = self.battery.power_kw * 1e3, self.battery
        most_w = (self.capacity_j - self.energy_j) / (battery.charge_efficiency * step_s)
        least_w = -self.energy_j * battery.discharge_efficiency / step_s
        return max(-limit_w, least_w, min(limit_w, most_w, setpoint_w))

    def store(self, power_w: float, step_s: float) -> None:
        """Take over the energy of a timestep."""
        battery = self.battery
        factor = battery.charge_efficiency if power_w > 0.0 else 1.0 / battery.discharge_efficiency
        self.energy_j = min(max(self.energy_j + factor * power_w * step_s, 0.0), self.capacity_j)


class Stay(NamedTuple):
    """A stay of a vehicle: arrival and departure in seconds from the begin of an episode, and energy needed, J."""

    arrival_s: float
    departure_s: float
    energy_j: float


class ChargerState:
    """A charger: the vehicle that is connected, and what it still needs.

    Args:
        name: of the charger.
        charger: its data.
        folder: of the grid's file.
        begin: simulated time of sample 0.
        duration_s: length of an episode.
    """

    def __init__(self, name: str, charger: Charger, folder: Path, begin: datetime, duration_s: float) -> None:
        self.name, self.charger = name, charger
        self._midnight_s = -(begin - begin.replace(hour=0, minute=0, second=0, microsecond=0)).total_seconds()
        self._duration_s = duration_s
        sessions = charger.sessions
        self._drawn = sessions if isinstance(sessions, DrawnSessions) else None
        self._fixed = [] if isinstance(sessions, DrawnSessions) else _fixed_stays(name, sessions, folder)
        self.stays: list[Stay] = []
        self.needs_j: list[float] = []
        self.unmet_j = 0.0

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode; draw its stays."""
        self.stays = self._fixed if self._drawn is None else _draw(self._drawn, self._midnight_s, self._duration_s, rng)
        self.needs_j = [stay.energy_j for stay in self.stays]
        self.unmet_j = 0.0

    def _present(self, begin_s: float, end_s: float) -> list[tuple[int, float]]:
        """Return the stays within a timestep, with their length in it, s."""
        overlaps = [(n, min(end_s, s.departure_s) - max(begin_s, s.arrival_s)) for n, s in enumerate(self.stays)]
        return [(number, length_s) for number, length_s in overlaps if length_s > 0.0]

    def energies(self, limit_w: float, begin_s: float, end_s: float) -> dict[int, float]:
        """Return the energy that each stay takes from the bus in a timestep, J."""
        power_w = min(max(limit_w, 0.0), self.charger.power_kw * 1e3)
        present = self._present(begin_s, end_s)
        return {number: min(power_w * length_s, self.needs_j[number]) for number, length_s in present}

    def charge(self, energies: dict[int, float], end_s: float) -> None:
        """Take over the energies of a timestep, and count what departing vehicles did not get."""
        for number, energy_j in energies.items():
            self.needs_j[number] -= energy_j
        for number, stay in enumerate(self.stays):
            if stay.departure_s <= end_s and self.needs_j[number]:
                self.unmet_j += self.needs_j[number]
                self.needs_j[number] = 0.0

    def connected(self, time_s: float) -> int | None:
        """Return the number of the stay at a time; None without one."""
        return next((n for n, stay in enumerate(self.stays) if stay.arrival_s <= time_s < stay.departure_s), None)


def _fixed_stays(name: str, sessions: Sequence[Session] | SessionFile, folder: Path) -> list[Stay]:
    listed = _read_sessions(name, folder / sessions.file) if isinstance(sessions, SessionFile) else sessions
    stays = sorted(Stay(s.arrival_h * 3600.0, s.departure_h * 3600.0, s.energy_kwh * J_PER_KWH) for s in listed)
    for earlier, later in pairwise(stays):
        if later.arrival_s < earlier.departure_s:
            raise InvalidConfig(
                f"chargers.{name}: a vehicle arrives at {later.arrival_s / 3600.0:g} h, before the previous one "
                f"departs at {earlier.departure_s / 3600.0:g} h"
            )
    return stays


def _read_sessions(name: str, path: Path) -> list[Session]:
    table = Table(path)
    columns = [table.numbers(column) for column in ("arrival_h", "departure_h", "energy_kwh")]
    chargers = table.texts("charger") if "charger" in table.header else [name] * len(columns[0])
    if name not in chargers:
        raise InvalidConfig(f"{path}: no row has the charger {name!r}; {did_you_mean(name, sorted(set(chargers)))}")
    sessions = []
    for number, charger, arrival, departure, energy in zip(table.lines(), chargers, *columns, strict=True):
        if not 0.0 <= arrival < departure or energy < 0.0:
            raise InvalidConfig(f"{path}:{number}: a departure after the arrival, and an energy of at least 0 expected")
        if charger == name:
            sessions.append(Session(arrival_h=arrival, departure_h=departure, energy_kwh=energy))
    return sessions


def _draw(drawn: DrawnSessions, midnight_s: float, duration_s: float, rng: np.random.Generator) -> list[Stay]:
    """Return a stay for each day from the midnight before the episode on; one that is over by then is left out."""
    stays: list[Stay] = []
    for day in range(int((duration_s - midnight_s) // _DAY_S) + 1):
        arrival_h, departure_h, energy_kwh = (
            _normal(draw, rng) for draw in (drawn.arrival_h, drawn.departure_h, drawn.energy_kwh)
        )
        is_used = rng.random() < drawn.share
        arrival_s = midnight_s + day * _DAY_S + arrival_h * 3600.0
        departure_s = midnight_s + day * _DAY_S + departure_h * 3600.0 + (_DAY_S if departure_h <= arrival_h else 0.0)
        if stays:
            arrival_s = max(arrival_s, stays[-1].departure_s)
        if is_used and departure_s > 0.0 and arrival_s < min(departure_s, duration_s):
            stays.append(Stay(arrival_s, departure_s, max(energy_kwh, 0.0) * J_PER_KWH))
    return stays


def _normal(draw: Draw, rng: np.random.Generator) -> float:
    return draw.mean + draw.deviation * float(np.clip(rng.standard_normal(), -_CUT, _CUT))
