"""Part `resets`: time of a reset that forks an engine and of one that starts an engine, in one environment."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import psutil
from rich.console import Console
from rich.table import Table

from bench import pace, programs, scenes
from zenostat.topics.messages import EngineStart

SCENES = ("five-zone", "office-small", "office-medium", "outpatient")


def measure(*, quick: bool) -> dict[str, Any]:
    """Measure each building in a process of its own."""
    arguments = ("5", "1") if quick else ("25", "5")
    return {scene: programs.result("resets", scene, *arguments) for scene in SCENES}


def _reset_ms(env: Any, expected: EngineStart) -> float:
    env.step(env.action_space.low)  # otherwise the untouched engine would be reused
    begin = time.perf_counter()
    _, info = env.reset()
    spent_ms = 1e3 * (time.perf_counter() - begin)
    if info["engine_start"] != expected:
        raise RuntimeError(f"expected engine_start {expected}, got {info['engine_start']}")
    return spent_ms


def _kill_template(env: Any) -> None:
    """Kill the template engine, which is the oldest, so that the next reset has to start an engine."""
    engines = psutil.Process(env.unwrapped.local_node.pid).children()
    template = min(engines, key=lambda engine: engine.create_time())
    template.kill()
    while template.is_running() and template.status() != psutil.STATUS_ZOMBIE:
        time.sleep(0.01)


def main() -> None:
    """Measure one scene: SCENE FORKS STARTS."""
    forks, starts = map(int, sys.argv[2:])
    env = scenes.environment(sys.argv[1])
    try:
        env.reset(seed=0)
        env.step(env.action_space.low)
        forked = [_reset_ms(env, EngineStart.FORKED) for _ in range(forks)]
        started = []
        for _ in range(starts):
            _kill_template(env)
            started.append(_reset_ms(env, EngineStart.STARTED))
    finally:
        env.close()
    print(json.dumps({"forked": pace.spread(forked), "started": pace.spread(started)}))


def show(results: dict[str, Any], console: Console) -> None:
    """Print a table."""
    table = Table("", "forked (ms)", "quartiles", "started (ms)", "ratio", title="env.reset")
    for scene, ms in results.items():
        forked, started = ms["forked"], ms["started"]["median"]
        quartiles = f"{forked['low']:.1f} to {forked['high']:.1f}"
        ratio = f"{started / forked['median']:.0f}"
        table.add_row(scene, f"{forked['median']:.1f}", quartiles, f"{started:.0f}", ratio)
    console.print(table)


if __name__ == "__main__":
    main()
