"""Part `plans`: plans simulated in one request, in turn with the same plans in branches that are stepped one by one.

Both simulate 16 plans of six hours of the five-zone building in each round, with the same results: once by `env.plan`,
once as `examples/mpc_by_branching.py` does it, with a branch for each plan and a thread for each core.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from bench import pace, programs, scenes
from zenostat.topics.arrays import Floats

SCENES = ("five-zone", "office-small")
PLANS, TIMESTEPS, BEGIN = 16, 24, 40


def measure(*, quick: bool) -> dict[str, Any]:
    """Measure each building in a process of its own."""
    return {scene: programs.result("plans", scene, "3" if quick else "20") for scene in SCENES}


class _Building:
    """An episode in which plans are made."""

    def __init__(self, scene: str) -> None:
        self.env = scenes.environment(scene).unwrapped
        self.env.reset(seed=0)
        self.pool = ThreadPoolExecutor(os.cpu_count())
        space = self.env.action_space
        middle = ((space.low + space.high) / 2.0).astype(np.float32)
        self.action = middle
        spread = np.linspace(-0.2, 0.2, PLANS)[:, None] * (space.high - space.low)
        self.actions = np.repeat((middle + spread).astype(np.float32)[:, None], TIMESTEPS, axis=1)
        for _ in range(BEGIN):
            self.env.step(middle)

    def together(self) -> Floats:
        """Simulate the plans in one request."""
        rewards: Floats = self.env.plan(self.actions)
        return rewards

    def one_by_one(self) -> Floats:
        """Simulate each plan in a branch of its own."""

        def simulate(plan: NDArray[np.float32]) -> list[float]:
            with self.env.branch() as branch:
                return [branch.step(action)[1] for action in plan]

        return np.array(list(self.pool.map(simulate, self.actions)))


def _timed(work: Callable[[], Floats]) -> tuple[Floats, float]:
    begin = time.perf_counter()
    rewards = work()
    return rewards, time.perf_counter() - begin


def main() -> None:
    """Measure one scene: SCENE ROUNDS."""
    building, count = _Building(sys.argv[1]), PLANS * TIMESTEPS
    rates: dict[str, list[float]] = {"plan": [], "branches": [], "ratio": []}
    try:
        for _ in range(int(sys.argv[2])):
            together, plan_s = _timed(building.together)
            single, branches_s = _timed(building.one_by_one)
            if not np.array_equal(together, single):
                raise RuntimeError("the plans have other rewards than the branches")
            rates["plan"].append(count / plan_s)
            rates["branches"].append(count / branches_s)
            rates["ratio"].append(branches_s / plan_s)
            building.env.step(building.action)
    finally:
        building.env.close()
    print(json.dumps({name: pace.spread(figures) for name, figures in rates.items()}))


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table."""
    table = Table("", "plan", "branches, one by one", "ratio", title="branch timesteps per second, median (quartiles)")
    for scene, result in results.items():
        cells = [f"{c['median']:,.1f} ({c['low']:,.1f}-{c['high']:,.1f})" for c in result.values()]
        table.add_row(scene, *cells)
    console.print(table)


if __name__ == "__main__":
    main()
