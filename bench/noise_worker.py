"""Episodes of three days with weather noise in one process: `python noise_worker.py KIND RESETS EPISODES`.

KIND is a `noise_start` of this project (`third_day`, `episode`) or `sinergym`. The program prints a line of JSON with
the milliseconds of each reset of a single environment, the seconds until eight slots are at their first step, and the
transitions per second of eight slots over EPISODES episodes of each, resets included. It imports nothing else of this
folder, so that it runs under another interpreter, too.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from typing import Any

SLOTS = 8
DAYS, STEPS_PER_HOUR = 3, 4
STEPS = DAYS * 24 * STEPS_PER_HOUR
ZENOSTAT, SINERGYM = "zenostat/5zone-mixed-continuous-stochastic-v1", "Eplus-5zone-mixed-continuous-stochastic-v1"


def _create(kind: str, count: int) -> Any:
    """Create a single environment, or a vector environment if `count` is not 0."""
    import gymnasium as gym

    if kind == "sinergym":
        import logging

        import sinergym  # noqa: F401  # registers the environments

        logging.disable(logging.CRITICAL)
        # Days and months of begin and end; the model's own year and its four timesteps an hour.
        arguments: dict[str, Any] = {"building_config": {"runperiod": (1, 1, 1991, DAYS, 1, 1991)}}
        if not count:
            return gym.make(SINERGYM, **arguments)
        kwargs: dict[str, Any] = {"vector_kwargs": {"context": "spawn"}}
        return gym.make_vec(SINERGYM, num_envs=count, vectorization_mode="async", **kwargs, **arguments)
    import zenostat  # noqa: F401  # registers the environments

    arguments = {"begin": "01-01", "end": f"01-0{DAYS}", "noise_start": kind}
    if not count:
        return gym.make(ZENOSTAT, **arguments)
    return gym.make_vec(ZENOSTAT, num_envs=count, **arguments)


def _resets_ms(kind: str, count: int) -> list[float]:
    env, spent = _create(kind, 0), []
    try:
        env.reset(seed=0)
        action = env.action_space.low
        for _ in range(count):
            for _ in range(STEPS_PER_HOUR):
                env.step(action)
            begin = time.perf_counter()
            env.reset()
            spent.append(1e3 * (time.perf_counter() - begin))
    finally:
        env.close()
    return spent


def _slots(kind: str, episodes: int) -> tuple[float, float]:
    import numpy as np

    begin = time.perf_counter()
    envs = _create(kind, SLOTS)
    try:
        envs.reset(seed=0)
        ready = time.perf_counter()
        action = np.tile(envs.single_action_space.low, (SLOTS, 1))
        for _ in range(episodes * STEPS):  # with Gymnasium's default, the step after an episode's last one is its reset
            envs.step(action)
        return ready - begin, SLOTS * episodes * STEPS / (time.perf_counter() - ready)
    finally:
        envs.close()


def main() -> None:
    """Measure what the command line names."""
    kind, resets, episodes = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    output = os.dup(1)
    os.dup2(2, 1)  # other output of the programs goes to standard error
    os.chdir(tempfile.mkdtemp(prefix="zenostat-bench-", dir=os.environ["TMPDIR"]))
    resets_ms = _resets_ms(kind, resets)
    set_up_s, per_second = _slots(kind, episodes)
    fields = {"resets_ms": resets_ms, "set_up_s": set_up_s, "per_second": per_second}
    os.write(output, json.dumps(fields).encode() + b"\n")


if __name__ == "__main__":
    main()
