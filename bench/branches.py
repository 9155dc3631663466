"""Part `branches`: milliseconds of a snapshot, of going back and of a branch at mid-episode, and their memory."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bench import pace, scenes

SCENES = ("five-zone", "office-medium")
MID = 2000
MEMORY_AFTER = (0, 100, 3000)
SEASONS = (10_000, 19_000, 28_000)
"""Steps from 1 July on: in October, January and April."""


def measure(*, quick: bool) -> dict[str, Any]:
    """Of each building, in a process of its own."""
    found = {}
    for scene in SCENES:
        command = [sys.executable, "-m", "bench.branches", scene, *(("5",) if quick else ("40", *map(str, SEASONS)))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr[-3000:]}")
        found[scene] = json.loads(done.stdout.splitlines()[-1])
    return found


def _timed(times: list[float], work: Callable[[], Any]) -> Any:
    begin = time.perf_counter()
    result = work()
    times.append(1e3 * (time.perf_counter() - begin))
    return result


class _Episode:
    """An episode at mid-way."""

    def __init__(self, scene: str) -> None:
        self.env = scenes.environment(scene)
        self.inner = self.env.unwrapped
        self.env.reset(seed=0)
        actuators = self.inner.manifest.actuators
        self.action = scenes.setpoints(actuators)[: self.env.action_space.shape[0]].astype(np.float32)
        self.steps = 0
        self.go_on(MID)

    def go_on(self, until: int) -> None:
        """Steps on, as far as a number of steps."""
        for _ in range(until - self.steps):
            self.env.step(self.action)
        self.steps = max(self.steps, until)

    def times(self, count: int) -> dict[str, dict[str, float]]:
        """Milliseconds of each of them."""
        branch: list[float] = []
        first: list[float] = []
        snapshot: list[float] = []
        back: list[float] = []
        for _ in range(count):
            self.env.step(self.action)
            with _timed(branch, self.inner.branch) as made:
                _timed(first, partial(made.step, self.action))
        for _ in range(count):
            self.env.step(self.action)
            _timed(snapshot, self.inner.snapshot).close()
        with self.inner.snapshot() as kept:
            for _ in range(count):
                self.env.step(self.action)
                _timed(back, lambda: self.env.reset(options={"snapshot": kept}))
        found = {"branch": branch, "first step of a branch": first, "snapshot": snapshot, "going back": back}
        return {title: pace.spread(figures) for title, figures in found.items()}

    def memory_mb(self) -> dict[str, float]:
        """Private megabytes of a branch's engine by steps since the fork, and of the engine that goes on beside it."""
        bus, node = self.inner.link.bus, self.inner.manifest.node
        found, done = {}, 0
        with self.inner.branch() as made:
            for steps in MEMORY_AFTER:
                for _ in range(steps - done):
                    made.step(self.action)
                done = steps
                told = bus.status(node, memory=True)
                found[str(steps)] = told.branches[0].private_bytes / 1e6
        return found

    def season_mb(self, at: int) -> float:
        """Private megabytes of a branch's engine 100 steps after it was made, at a step of the year."""
        self.go_on(at)
        bus, node = self.inner.link.bus, self.inner.manifest.node
        with self.inner.branch() as made:
            for _ in range(100):
                made.step(self.action)
            return float(bus.status(node, memory=True).branches[0].private_bytes / 1e6)


def main() -> None:
    """Measures what the command line says: a scene, how often, and at which steps the memory once more."""
    scene, count, *seasons = sys.argv[1:]
    episode = _Episode(scene)
    try:
        found = {"ms": episode.times(int(count)), "memory_mb": episode.memory_mb()}
        found["seasons_mb"] = {at: episode.season_mb(int(at)) for at in seasons}
    finally:
        episode.env.close()
    print(json.dumps(found))


def show(results: dict[str, Any], console: Console) -> None:
    """Two tables."""
    titles = [*next(iter(results.values()))["ms"]]
    table = Table("", *titles, title="milliseconds, median (quartiles)")
    memory = Table("", *(f"{steps} steps" for steps in MEMORY_AFTER), title="private MB of a branch after")
    for scene, found in results.items():
        cells = (found["ms"][title] for title in titles)
        table.add_row(scene, *(f"{c['median']:.1f} ({c['low']:.1f}-{c['high']:.1f})" for c in cells))
        memory.add_row(scene, *(f"{mb:.1f}" for mb in found["memory_mb"].values()))
    console.print(table)
    console.print(memory)
    for scene, found in results.items():
        for at, mb in found["seasons_mb"].items():
            console.print(f"{scene}: {mb:.1f} MB after 100 steps of a branch made at step {at}")


if __name__ == "__main__":
    main()
