"""Cost of a fleet for its controller and a router: `python -m bench.fleet --nodes 4 --steps 2000`.

Processor time rather than wall time, so that the result depends little on what else runs on the machine.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import psutil

from bench.programs import started
from zenostat.agent_sdk.envs.fleet_env import FleetVectorEnv
from zenostat.bridge.runtime.processor_time import processor_s
from zenostat.topics import codec

SCENARIO = {"building": "ref-small-office", "weather": "USA_CO_Denver", "begin": "07-01", "end": "07-31"}


def measure(endpoints: list[str], names: list[str], router: psutil.Process | None, steps: int) -> dict[str, float]:
    """Return processor time and wall time per slot and step, and the size of messages."""
    env = FleetVectorEnv(endpoints, names)
    try:
        env.reset(seed=0)
        action = np.tile(env.single_action_space.low * 0.5 + env.single_action_space.high * 0.5, (env.num_envs, 1))
        watched = {"controller": psutil.Process(), **({"router": router} if router else {})}
        for _ in range(100):
            env.step(action)
        before, start_s = {name: processor_s(process) for name, process in watched.items()}, time.perf_counter()
        for _ in range(steps):
            env.step(action)
        wall_s = time.perf_counter() - start_s
        slot_steps = steps * env.num_envs
        used = {
            f"{name}, processor us": 1e6 * (processor_s(process) - before[name]) / slot_steps
            for name, process in watched.items()
        }
        message, values = env.envs[0].sample.message, bytes(8 * len(env.manifest.actuators))
        return {
            **used,
            "wall us": 1e6 * wall_s / slot_steps,
            "sample bytes": len(codec.encode(message)),
            "command bytes": len(
                codec.pack(episode=message.episode, step=message.step, operations=None, values=values)
            ),
        }
    finally:
        env.close()


def main() -> None:
    """Measure a fleet whose nodes are reached directly, and one behind a router."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nodes", type=int, default=4)
    parser.add_argument("--steps", type=int, default=2000)
    arguments = parser.parse_args()
    settings = [word for name, value in SCENARIO.items() for word in (f"--{name}", value)]
    names = [f"n{i}" for i in range(arguments.nodes)]
    for with_router in (False, True):
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir="/tmp")))
            at = f"unixsock-stream/{folder}/router"
            router = psutil.Process(stack.enter_context(started("router", "--listen", at))[0]) if with_router else None
            places = [at if with_router else f"unixsock-stream/{folder}/{name}" for name in names]
            for name, place in zip(names, places, strict=True):
                where = ["--no-listen", "--connect", place] if with_router else ["--listen", place]
                stack.enter_context(started("node", "--name", name, *where, *settings))
            row = measure(places, names, router, arguments.steps)
        print("behind a router" if with_router else "direct", {name: round(value, 1) for name, value in row.items()})


if __name__ == "__main__":
    main()
