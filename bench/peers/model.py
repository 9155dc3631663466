"""The model that all tools couple: an office, and a cooling setpoint that follows the office's power.

Plain functions without any tool. A step of the office is a function of its temperature at the beginning and of the
setpoint, so it can be computed again; it is taken by keeping the temperature at its end.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from math import pi, sin
from pathlib import Path

STEP_S = 900.0
STEPS_PER_DAY = 96
START_DEGC = 24.0
LOW_DEGC, HIGH_DEGC = 22.5, 30.0
MIDDLE_DEGC, MIDDLE_KW = 24.0, 2.0
TOLERANCE_K = 0.02
LIMIT = 24
"""Greatest number of evaluations of a step."""

_CAPACITY_W_K = 2e7 / STEP_S
_LOSS_W_K = 400.0
_CONTROL_W_K = 3000.0
_COP, _GROWTH_PER_W = 3.0, 0.3 / 1e4


def outdoor_degc(step: int) -> float:
    """Return the outdoor temperature of a step (1 is the first), between 20 and 34 degC."""
    return 27.0 + 7.0 * sin(2.0 * pi * ((step - 1) / STEPS_PER_DAY - 0.375))


def gains_w(step: int) -> float:
    """Return the heat gains of a step: 7 kW from 8 h to 18 h, else 1 kW."""
    return 7000.0 if 8.0 <= (step - 1) % STEPS_PER_DAY / 4.0 < 18.0 else 1000.0


def office(temperature: float, step: int, setpoint: float) -> tuple[float, float]:
    """Return the cooling power in kW, and the temperature at the end of the step in degC.

    The heat balance is solved by the backward Euler method; cooling Q is proportional to the distance of the
    temperature from the setpoint; electricity is Q/COP (1 + 0.3 Q/10 kW).
    """
    inflow = _CAPACITY_W_K * temperature + _LOSS_W_K * outdoor_degc(step) + gains_w(step)
    end = (inflow + _CONTROL_W_K * setpoint) / (_CAPACITY_W_K + _LOSS_W_K + _CONTROL_W_K)
    cooling = _CONTROL_W_K * (end - setpoint)
    if cooling <= 0.0:
        cooling, end = 0.0, inflow / (_CAPACITY_W_K + _LOSS_W_K)
    return cooling / _COP * (1.0 + _GROWTH_PER_W * cooling) / 1e3, end


def law(power_kw: float, gain: float) -> float:
    """Return the setpoint for a power, degC; gain in K/kW."""
    return min(max(MIDDLE_DEGC + gain * (power_kw - MIDDLE_KW), LOW_DEGC), HIGH_DEGC)


@dataclass
class Day:
    """Report of a run.

    Attributes:
        setpoints, powers: of each step, degC and kW, as the office took it.
        evaluations: number of evaluations of the office.
        times: at the end of each step, s.
    """

    setpoints: list[float] = field(default_factory=list)
    powers: list[float] = field(default_factory=list)
    evaluations: int = 0
    times: list[float] = field(default_factory=list)

    def add(self, setpoint: float, power: float) -> None:
        """Add a step that was taken."""
        self.setpoints.append(setpoint)
        self.powers.append(power)
        self.times.append(time.perf_counter())

    def write(self, path: str | Path) -> None:
        """Write it as JSON."""
        Path(path).write_text(json.dumps(vars(self)))
