"""Part `loops`: an algebraic loop around a building, solved by trial steps, against a delay of one step.

In the same timestep the cooling setpoint follows the building's own mean HVAC power P: 24 degC + gain (P / P0 - 1),
within its bounds. A co-simulation without rollback uses the power of the previous timestep, damped or not. Trials solve
each timestep: setpoint and power agree before it is taken.

The residual is the difference between the setpoint and the law at the power of the same timestep. A timestep has no
fixed point where the power jumps with the setpoint (staged equipment): its residual changes its sign within a tenth of
the tolerance without being within it. Such a timestep is taken with the best trial, and counted.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

import zenostat  # noqa: F401  # registers the environments
from bench import programs
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.cosim.solver import Outcome, Problem, Secants, solve_in_bracket
from zenostat.topics.arrays import Floats

DAY = {"begin": "07-03", "end": "07-03", "steps_per_hour": 4}
BUILDINGS = {
    "office-small": ("office-small-USA_CO_Denver-continuous-v1", "hvac_electricity", 2.0),
    "five-zone": ("5zone-hot-continuous-v1", "total_electricity_HVAC", 4.0),
    "office-medium": ("office-medium-USA_CO_Denver-continuous-v1", "hvac_electricity", 12.0),
}
"""By name: the scenario, the meter of the HVAC power, and P0 in kW, about the mean of the day at 24 degC."""

GAINS_K = (3.0, 1.5)
DAMPING = (1.0, 0.5, 0.2)
MIDDLE_DEGC = 24.0
TOLERANCE_K, LIMIT, NOTICEABLE_K = 0.02, 24, 0.05


def measure(*, quick: bool) -> dict[str, Any]:
    """Simulate each building in a process of its own."""
    names = [*BUILDINGS][:1] if quick else BUILDINGS
    return {name: programs.result("loops", name, *map(str, GAINS_K[:1] if quick else GAINS_K)) for name in names}


@dataclass
class Day:
    """Results of a day.

    Attributes:
        residuals_k: of each timestep.
        setpoints_degc: of each timestep.
        powers_kw: mean of each timestep.
        trials: number of trials, 0 without rollback.
        jumps: timesteps without a fixed point.
        unsolved: timesteps in which the limit of trials was reached.
        trial_s: time of each timestep's trials, divided by their number.
    """

    residuals_k: list[float] = field(default_factory=list)
    setpoints_degc: list[float] = field(default_factory=list)
    powers_kw: list[float] = field(default_factory=list)
    trials: int = 0
    jumps: int = 0
    unsolved: int = 0
    trial_s: list[float] = field(default_factory=list)

    def summary(self, step_h: float) -> dict[str, float]:
        """Return the figures of the table."""
        count = len(self.residuals_k)
        setpoints = self.setpoints_degc
        return {
            "mean_k": sum(self.residuals_k) / count,
            "max_k": max(self.residuals_k),
            "noticeable": sum(residual > NOTICEABLE_K for residual in self.residuals_k),
            "travel_k": sum(abs(new - old) for old, new in pairwise(setpoints)),
            "peak_kw": max(self.powers_kw),
            "kwh": step_h * sum(self.powers_kw),
            "trials": self.trials / count,
            "no_fixed_point": self.jumps / count,
            "unsolved": self.unsolved / count,
            "trial_ms": 1e3 * median(self.trial_s) if self.trial_s else 0.0,
        }


class Loop:
    """A building whose cooling setpoint follows its own power.

    Args:
        building: a name in `BUILDINGS`.
        gain_k: change of the setpoint for P0 more power.
    """

    def __init__(self, env: BuildingEnv, building: str, gain_k: float) -> None:
        _, self._meter, self._reference_kw = BUILDINGS[building]
        self._env, self._gain_k = env, gain_k
        cooling = [a for a in env.manifest.actuators if "cooling_setpoint" in a.name]
        self._cooling = [actuator.name for actuator in cooling]
        self._low = max(actuator.low for actuator in cooling if actuator.low is not None)
        self._high = min(actuator.high for actuator in cooling if actuator.high is not None)
        low, high, tolerance = (np.array([number]) for number in (self._low, self._high, TOLERANCE_K))
        self._problem = Problem(self._tried_law, tolerance, low, high, LIMIT)

    def law(self, power_kw: float) -> float:
        """Return the setpoint for a power, degC."""
        setpoint = MIDDLE_DEGC + self._gain_k * (power_kw / self._reference_kw - 1.0)
        return min(max(setpoint, self._low), self._high)

    def _power_kw(self, sample: Any) -> float:
        return float(sample[self._meter]) / self._env.manifest.step_s / 1e3

    def _command(self, setpoint: float) -> dict[str, float | None]:
        return dict.fromkeys(self._cooling, setpoint)

    def _tried_law(self, setpoint: Floats) -> Floats:
        """Return the law at the power that the next timestep would have with a setpoint; shapes (1,)."""
        (sample,) = self._env.link.try_step([self._command(float(setpoint[0]))])
        return np.array([self.law(self._power_kw(sample))])

    def _step(self, day: Day, setpoint: float) -> None:
        link = self._env.link
        link.send(self._command(setpoint))
        power_kw = self._power_kw(link.receive())
        day.residuals_k.append(abs(setpoint - self.law(power_kw)))
        day.setpoints_degc.append(setpoint)
        day.powers_kw.append(power_kw)

    def _steps(self) -> Iterator[None]:
        self._env.link.reset(seed=0)
        for _ in range(self._env.manifest.steps):
            yield

    def delayed(self, damping: float) -> Day:
        """Simulate a day in which the setpoint follows the power of the previous timestep."""
        day, setpoint = Day(), MIDDLE_DEGC
        for _ in self._steps():
            if day.powers_kw:
                setpoint += damping * (self.law(day.powers_kw[-1]) - setpoint)
            self._step(day, setpoint)
        return day

    def solved(self) -> Day:
        """Simulate a day in which each timestep is tried until setpoint and power agree."""
        day, setpoint = Day(), MIDDLE_DEGC
        secants: Secants = ()
        for _ in self._steps():
            begin_s = time.perf_counter()
            solution = solve_in_bracket(self._problem, np.array([setpoint]), secants)
            secants = solution.secants
            setpoint = float(solution.best.x[0])
            day.trial_s.append((time.perf_counter() - begin_s) / solution.trials)
            day.trials += solution.trials
            day.jumps += solution.outcome is Outcome.JUMP
            day.unsolved += solution.outcome is Outcome.LIMIT
            self._step(day, setpoint)
        return day


def main() -> None:
    """Simulate one building: BUILDING GAIN ..."""
    building, *gains = sys.argv[1:]
    env = gym.make(f"zenostat/{BUILDINGS[building][0]}", reward=None, **DAY).unwrapped
    results: dict[str, Any] = {}
    try:
        env.reset(seed=0)
        for gain in gains:
            loop, step_h = Loop(env, building, float(gain)), env.manifest.step_s / 3600.0
            days = {f"delay, damping {damping:g}": loop.delayed(damping) for damping in DAMPING}
            days["solved by trials"] = loop.solved()
            results[gain] = {scheme: day.summary(step_h) for scheme, day in days.items()}
    finally:
        env.close()
    print(json.dumps(results))


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table for each building and gain."""
    for building, by_gain in results.items():
        for gain, schemes in by_gain.items():
            reference_kw = BUILDINGS[building][2]
            columns = ("residual K, mean", "max", f"> {NOTICEABLE_K:g} K", "travel K", "peak kW", "kWh")
            title = f"{building}, {float(gain) / reference_kw:g} K/kW around {reference_kw:g} kW"
            table = Table("", *columns, "trials/step", "ms/trial", "no fixed point", title=title)
            for scheme, row in schemes.items():
                figures = [f"{row['mean_k']:.3f}", f"{row['max_k']:.3f}", f"{row['noticeable']:.0f}"]
                figures += [f"{row['travel_k']:.1f}", f"{row['peak_kw']:.2f}", f"{row['kwh']:.1f}"]
                if row["trials"]:
                    figures += [f"{row['trials']:.2f}", f"{row['trial_ms']:.1f}", _shares(row)]
                table.add_row(scheme, *figures)
            console.print(table)


def _shares(row: dict[str, float]) -> str:
    """Return the share of timesteps without a fixed point, and that of undecided ones, if there are any."""
    undecided = f", {row['unsolved']:.1%} undecided" if row["unsolved"] else ""
    return f"{row['no_fixed_point']:.1%}{undecided}"


if __name__ == "__main__":
    main()
