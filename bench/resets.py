"""What a reset costs, forked and started, in one process: prints milliseconds as JSON.

`python -m bench.resets BUILDING`
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from typing import Any

import gymnasium as gym
import psutil

import agent_sdk  # noqa: F401  # registers the environments
from topics.messages import Start

FORKED, STARTED = 15, 5
DAY = {"weather": "USA_CO_Denver", "begin": "07-03", "end": "07-03", "steps_per_hour": 4}


def _reset_ms(env: Any, expected: Start) -> float:
    env.step(env.action_space.low)  # else the engine that waits untouched would do
    begin = time.perf_counter()
    _, info = env.reset()
    spent_ms = 1e3 * (time.perf_counter() - begin)
    if info["start"] != expected:
        raise RuntimeError(f"the reset was {info['start']}, {expected} expected")
    return spent_ms


def _end_waiting(env: Any) -> None:
    """Ends the engine that waits to be forked, which is the oldest: the next reset has to start one."""
    engines = psutil.Process(env.unwrapped.own_node.pid).children()
    waiting = min(engines, key=lambda engine: engine.create_time())
    waiting.kill()
    while waiting.is_running() and waiting.status() != psutil.STATUS_ZOMBIE:
        time.sleep(0.01)


def main() -> None:
    """Measures what the command line says."""
    env = gym.make("zenostat/Building-v1", building=sys.argv[1], **DAY)
    try:
        env.reset(seed=0)
        env.step(env.action_space.low)
        forked = [_reset_ms(env, Start.FORKED) for _ in range(FORKED)]
        started = []
        for _ in range(STARTED):
            _end_waiting(env)
            started.append(_reset_ms(env, Start.STARTED))
    finally:
        env.close()
    print(json.dumps({"forked": statistics.median(forked), "started": statistics.median(started)}))


if __name__ == "__main__":
    main()
