"""Test periods of BOPTEST's scenarios, found from the heating and cooling loads of a year under the baseline control.

Definitions (BOPTEST user guide, "Scenarios"): a test period is the two weeks around a day. That day has, with the loads
as means of 15 minutes: the year's highest heating (or cooling) load, `peak_heat_day` (`peak_cool_day`); the highest
load that is not above the median of the daily highest loads of the days with a load, `typical_heat_day`
(`typical_cool_day`); the highest sum of both daily highest loads minus their difference, `mix_day`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zenostat.gateways.boptest.simulation import DAY_S, Building, Interruption
from zenostat.topics.arrays import Floats
from zenostat.topics.energyplus_names import END_USES
from zenostat.topics.messages import Manifest

TIME_PERIODS = ("peak_heat_day", "typical_heat_day", "peak_cool_day", "typical_cool_day", "mix_day")
WARMUP_S = 7 * DAY_S
PERIOD_S = 14 * DAY_S

_FIRST_DAY, _LAST_DAY = 14, 357  # a warm-up and half a period fit before, half a period after
_NO_LOAD_W = 1.0
_BIN_S = 900


def find_test_periods(heating: Floats, cooling: Floats, step_s: int) -> dict[str, int]:
    """Return the day of each test period, from 0; periods of a load that the building does not have are left out.

    Args:
        heating: heating load of a year in W, mean values of its timesteps, shape (timesteps,).
        cooling: cooling load, likewise.
        step_s: timestep in seconds, a divisor or a multiple of 15 minutes.
    """
    highest = {"heat": _daily_highest(heating, step_s), "cool": _daily_highest(cooling, step_s)}
    days: dict[str, int] = {}
    candidates = slice(_FIRST_DAY, _LAST_DAY + 1)
    for load, daily in highest.items():
        if not (daily[candidates] > _NO_LOAD_W).any():
            continue
        available = daily[candidates]
        days[f"peak_{load}_day"] = _FIRST_DAY + int(available.argmax())
        median = np.median(daily[daily > _NO_LOAD_W])
        typical = np.where(available <= median, available, -np.inf)
        if (typical > _NO_LOAD_W).any():
            days[f"typical_{load}_day"] = _FIRST_DAY + int(typical.argmax())
    both = (highest["heat"] + highest["cool"] - np.abs(highest["heat"] - highest["cool"]))[candidates]
    if (both > _NO_LOAD_W).any():
        days["mix_day"] = _FIRST_DAY + int(both.argmax())
    return {name: days[name] for name in TIME_PERIODS if name in days}


def _daily_highest(load: Floats, step_s: int) -> Floats:
    """Return each day's highest mean of 15 minutes, or of a timestep where that is longer; shape (days,)."""
    per_bin = max(_BIN_S // step_s, 1)
    days = len(load) * step_s // DAY_S
    highest: Floats = load[: days * DAY_S // step_s].reshape(days, -1, per_bin).mean(axis=2).max(axis=1)
    return highest


def simulate_test_periods(arguments: Mapping[str, Any], interruption: Interruption | None = None) -> dict[str, int]:
    """Simulate a year under the baseline control, and return the day of each test period.

    The loads are the energies of the end uses heating and cooling, of all fuels. It takes from half a minute for a
    small building to several minutes for a hospital.

    Args:
        arguments: arguments of the scenario, as of an environment.
        interruption: ends it from another thread.

    Raises:
        ZenostatError: the building cannot be simulated for a year.
    """
    building = Building(arguments, last_day="2017-12-31", interruption=interruption)
    try:
        main = building.main
        columns = [_meters(main.manifest, use) for use in ("Heating", "Cooling")]
        loads: list[tuple[float, ...]] = []

        def add(sample: Any) -> None:
            values = sample.values
            loads.append(tuple(float(values[indices].sum()) for indices in columns))

        main.run_free(main.manifest.steps, add)
    finally:
        building.close()
    heating, cooling = np.array(loads).T / building.step_s
    return find_test_periods(heating, cooling, building.step_s)


def _meters(manifest: Manifest, end_use: str) -> NDArray[np.intp]:
    assert end_use in END_USES
    return np.array(
        [
            index
            for index, meter in enumerate(manifest.meters, len(manifest.sensors))
            if meter.unit == "J" and meter.meter.casefold().startswith(f"{end_use}:".casefold())
        ],
        np.intp,
    )
