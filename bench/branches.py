"""Part `branches`: time of a snapshot, a reset to it, a branch and trials within an episode, and memory of a branch."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bench import pace, programs, scenes

SCENES = ("five-zone", "office-medium")
MID_EPISODE = 2000
TRIALS = (1, 8)
"""Numbers of alternatives in a request."""
MEMORY_AFTER = (0, 100, 3000)
SEASONS = (10_000, 19_000, 28_000)
"""Steps after 1 July: in October, January and April."""


def measure(*, quick: bool) -> dict[str, Any]:
    """Measure each building in a process of its own."""
    arguments = ("5",) if quick else ("40", *map(str, SEASONS))
    return {scene: programs.result("branches", scene, *arguments) for scene in SCENES}


def _timed(times: list[float], work: Callable[[], Any]) -> Any:
    begin = time.perf_counter()
    result = work()
    times.append(1e3 * (time.perf_counter() - begin))
    return result


class _Episode:
    """An episode at step `MID_EPISODE`."""

    def __init__(self, scene: str) -> None:
        self.env = scenes.environment(scene)
        self.inner = self.env.unwrapped
        self.env.reset(seed=0)
        actuators = self.inner.manifest.actuators
        self.action = scenes.setpoints(actuators)[: self.env.action_space.shape[0]].astype(np.float32)
        self.steps = 0
        self.step_until(MID_EPISODE)

    def step_until(self, until: int) -> None:
        """Step until the episode has this number of steps."""
        for _ in range(until - self.steps):
            self.env.step(self.action)
        self.steps = max(self.steps, until)

    def times(self, count: int) -> dict[str, dict[str, float]]:
        """Return milliseconds of each operation, repeated `count` times."""
        branch: list[float] = []
        first_step: list[float] = []
        snapshot: list[float] = []
        reset: list[float] = []
        for _ in range(count):
            self.env.step(self.action)
            with _timed(branch, self.inner.branch) as branched:
                _timed(first_step, partial(branched.step, self.action))
        for _ in range(count):
            self.env.step(self.action)
            _timed(snapshot, self.inner.snapshot).close()
        with self.inner.snapshot() as kept:
            for _ in range(count):
                self.env.step(self.action)
                _timed(reset, lambda: self.env.reset(options={"snapshot": kept}))
        trials: dict[int, list[float]] = {number: [] for number in TRIALS}
        for _ in range(count):
            self.env.step(self.action)
            for number, figures in trials.items():
                alternatives = np.repeat(self.action[None], number, axis=0)
                _timed(figures, partial(self.inner.try_step, alternatives))
        times = {"branch": branch, "first step of a branch": first_step, "snapshot": snapshot, "reset to it": reset}
        times |= {f"{number} trial{'s' * (number > 1)}": figures for number, figures in trials.items()}
        return {title: pace.spread(figures) for title, figures in times.items()}

    def memory_mb(self) -> dict[str, float]:
        """Return private megabytes of a branch's engine by the number of steps since the fork."""
        bus, node = self.inner.link.bus, self.inner.manifest.node
        memory_mb, done = {}, 0
        with self.inner.branch() as branch:
            for steps in MEMORY_AFTER:
                for _ in range(steps - done):
                    branch.step(self.action)
                done = steps
                memory_mb[str(steps)] = bus.status(node, memory=True).branches[0].private_bytes / 1e6
        return memory_mb

    def season_mb(self, step: int) -> float:
        """Return private megabytes of a branch's engine 100 steps after the fork, at a step of the year."""
        self.step_until(step)
        bus, node = self.inner.link.bus, self.inner.manifest.node
        with self.inner.branch() as branch:
            for _ in range(100):
                branch.step(self.action)
            return float(bus.status(node, memory=True).branches[0].private_bytes / 1e6)


def main() -> None:
    """Measure one scene: SCENE COUNT [STEP ...], with the memory of branches created at these steps."""
    scene, count, *seasons = sys.argv[1:]
    episode = _Episode(scene)
    try:
        results = {"ms": episode.times(int(count)), "memory_mb": episode.memory_mb()}
        results["seasons_mb"] = {step: episode.season_mb(int(step)) for step in seasons}
    finally:
        episode.env.close()
    print(json.dumps(results))


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table of times and one of memory."""
    titles = [*next(iter(results.values()))["ms"]]
    table = Table("", *titles, title="milliseconds, median (quartiles)")
    memory = Table("", *(f"{steps} steps" for steps in MEMORY_AFTER), title="private MB of a branch after")
    for scene, result in results.items():
        cells = (result["ms"][title] for title in titles)
        table.add_row(scene, *(f"{c['median']:.1f} ({c['low']:.1f}-{c['high']:.1f})" for c in cells))
        memory.add_row(scene, *(f"{mb:.1f}" for mb in result["memory_mb"].values()))
    console.print(table)
    console.print(memory)
    for scene, result in results.items():
        for step, mb in result["seasons_mb"].items():
            console.print(f"{scene}: {mb:.1f} MB after 100 steps of a branch created at step {step}")


if __name__ == "__main__":
    main()
