"""Train PPO on the paper's data center: `python training_worker.py KIND STEPS SLOTS SEED`.

KIND is `zenostat` or `sinergym`, SEED that of the algorithm and of the first episodes. The program prints a line of
JSON: for each finished training episode the training step, the seconds and the processor seconds since the start of
learning, and the episode's return. It imports nothing else of this folder, so that it runs under another interpreter,
too.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from typing import Any

ID = "datacenter_dx-mixed-continuous-stochastic-v1"
MONTH, DAYS, STEPS_PER_HOUR = 7, 31, 4
LOW, HIGH = -1.0, 1.0
PARAMETERS = {"n_steps": 744, "batch_size": 248, "n_epochs": 10, "learning_rate": 3e-4, "gamma": 0.99}
"""A rollout is a quarter of an episode of 2,976 timesteps in each slot."""


def _sinergym(slots: int) -> Any:
    import logging
    from functools import partial

    import sinergym  # noqa: F401  # registers the environments
    from stable_baselines3.common.vec_env import SubprocVecEnv

    logging.disable(logging.CRITICAL)
    return SubprocVecEnv([partial(_one_sinergym, slot) for slot in range(slots)], start_method="spawn")


def _with_sun_on_design_days() -> None:
    """Let Sinergym size the building as it is sized here.

    It writes two fields of a design day under names that EnergyPlus does not know (`…_taub` and `…_taud` without the
    last underscore). Without them there is no sun on the summer design day, and the systems are 4 % smaller.
    """
    from sinergym.config.modeling import ModelJSON

    adapt = ModelJSON.adapt_building_to_epw

    def corrected(self: Any, *args: Any, **kwargs: Any) -> None:
        adapt(self, *args, **kwargs)
        for day in self.building["SizingPeriod:DesignDay"].values():
            for name in [name for name in day if name.endswith(("_taub", "_taud"))]:
                day[f"{name}_"] = day.pop(name)

    ModelJSON.adapt_building_to_epw = corrected


def _one_sinergym(slot: int) -> Any:
    import logging

    import gymnasium as gym
    import numpy as np
    import sinergym  # noqa: F401

    logging.disable(logging.CRITICAL)
    _with_sun_on_design_days()
    # This replaces the id's own configuration, which also sets the timesteps.
    config = {"timesteps_per_hour": STEPS_PER_HOUR, "runperiod": (1, MONTH, 1991, DAYS, MONTH, 1991)}
    env = gym.make(f"Eplus-{ID}", building_config=config, env_name=f"slot-{slot}")
    return gym.wrappers.RescaleAction(env, np.float32(LOW), np.float32(HIGH))


def _zenostat(slots: int) -> Any:
    import gymnasium as gym
    import numpy as np

    from zenostat.envs import as_sb3

    arguments = {"begin": f"{MONTH:02}-01", "end": f"{MONTH:02}-{DAYS}", "steps_per_hour": STEPS_PER_HOUR}
    arguments |= {"noise_start": "third_day"}
    env = gym.make_vec(f"zenostat:zenostat/{ID}", num_envs=slots, autoreset_mode="SameStep", **arguments)
    return as_sb3(gym.wrappers.vector.RescaleAction(env, np.float32(LOW), np.float32(HIGH)))


def _processor_s() -> float:
    """Return the time of this process and its descendants, with the ended children that each waited for."""
    import psutil

    total = 0.0
    for process in [psutil.Process(), *psutil.Process().children(recursive=True)]:
        try:
            times = process.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total += sum(times[:4])
    return total


def main() -> None:
    """Train as the command line says."""
    kind, (steps, slots, seed) = sys.argv[1], map(int, sys.argv[2:])
    output = os.dup(1)
    os.dup2(2, 1)  # other output of the programs goes to standard error
    os.chdir(tempfile.mkdtemp(prefix="zenostat-bench-", dir=os.environ["TMPDIR"]))
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    torch.set_num_threads(1)
    rows: list[tuple[int, float, float, float]] = []
    begin, begin_cpu = time.perf_counter(), _processor_s()

    class Episodes(BaseCallback):
        """Records each episode that ends."""

        def _on_step(self) -> bool:
            for info in self.locals["infos"]:
                if "episode" in info:
                    spent = time.perf_counter() - begin, _processor_s() - begin_cpu
                    rows.append((self.num_timesteps, *spent, float(info["episode"]["r"])))
            return True

    env = VecNormalize(VecMonitor({"sinergym": _sinergym, "zenostat": _zenostat}[kind](slots)))
    try:
        PPO("MlpPolicy", env, seed=seed, device="cpu", **PARAMETERS).learn(steps, callback=Episodes())
    finally:
        env.close()
    os.write(output, json.dumps(rows).encode() + b"\n")


if __name__ == "__main__":
    main()
