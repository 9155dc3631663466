"""Model predictive control with the building itself as the model: each hour, try plans in branches and apply the best.

A branch is a copy of the running simulation that continues from the present step. So no model has to be identified,
and each branch has the true future weather and occupancy. The result is therefore an upper limit: in a real building,
forecasts have errors.

Run it: `python examples/mpc_by_branching.py [--days 5] [--plot mpc.png]`
"""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from zenostat import BuildingEnv
from zenostat.controllers import Agent, RuleBasedController

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--days", type=int, default=5)
parser.add_argument("--hours", type=int, default=6, help="prediction horizon in hours")
parser.add_argument("--moves", type=int, default=10**6, help="number of optimized hours; then follow the rules")
parser.add_argument("--plot", type=Path, help="plot the last two days to FILE.png (needs matplotlib)")
arguments = parser.parse_args()

SCENARIO = "zenostat/5zone-hot-continuous-v1"
"""Five zones in summer in the hot climate; its action is (heating setpoint, cooling setpoint), degC."""
PERIOD = {"begin": "07-03", "end": f"07-{arguments.days + 2:02}"}
STEPS = 4
"""Timesteps per hour."""
MOVES_K = (-3.0, -1.5, -0.5, 0.0, 0.1, 0.2, 0.4, 1.0)
"""Candidates for the cooling setpoint in the first hour, relative to the upper limit of the comfort band.

At most 1 K above it: the reward measures only one zone, and the others should stay comfortable as well.
"""


def rules(env: gym.Env[Any, Any], **parameters: float) -> Callable[[gym.Env[Any, Any]], Any]:
    """Return the rule-based controller as a function of the environment."""
    agent = Agent(RuleBasedController(env.unwrapped.manifest, **parameters))
    return lambda env: agent.action(env.unwrapped.sample)


def baseline(_: gym.Env[Any, Any]) -> Callable[[gym.Env[Any, Any]], Any]:
    """Return a function for baseline control, in an environment without actuators."""
    return lambda _: np.zeros(0, np.float32)


class Mpc:
    """Model predictive controller: apply the first hour of the best plan, then plan again.

    A plan is one hour with one of the cooling setpoints, heating on or off, followed by rules that keep the limits of
    the comfort band. One of the plans is to follow the rules from the start.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        self.rules = rules(env, setback=0.0, margin=0.0)
        self.low, self.high = env.action_space.low, env.action_space.high
        self.pool = ThreadPoolExecutor(os.cpu_count())  # each thread waits for a branch
        self.move, self.moves, self.branch_steps, self.seconds = None, 0, 0, 0.0

    def __call__(self, env: gym.Env[Any, Any]) -> Any:
        """Return the action of the best plan, or that of the rules after the last optimized hour."""
        rule = self.rules(env)
        if self.moves >= arguments.moves:
            return rule
        if env.unwrapped.sample.step % STEPS == 0:
            start = time.perf_counter()
            plans = list(self.plans(rule))
            outcomes = list(self.pool.map(partial(self.simulate, env.unwrapped), plans))
            self.seconds += time.perf_counter() - start
            self.branch_steps += sum(steps for _, steps in outcomes)
            self.moves += 1
            self.move = plans[max(range(len(plans)), key=lambda i: outcomes[i][0])][0]
        return self.move

    def plans(self, rule: Any) -> Iterator[list[Any]]:
        """Yield plans: an action for each timestep of the horizon."""
        heating, cooling = rule
        for move, heat in product(MOVES_K, (heating, self.low[0])):
            first = np.clip(np.array([heat, cooling + move], np.float32), self.low, self.high)
            yield [first] * STEPS + [rule] * STEPS * (arguments.hours - 1)

    @staticmethod
    def simulate(building: BuildingEnv, plan: list[Any]) -> tuple[float, int]:
        """Simulate a plan in a branch, at most to the end of the episode; return reward and number of timesteps."""
        total, steps = 0.0, 0
        with closing(building.branch()) as branch:
            for action in plan:
                _, reward, terminated, truncated, _ = branch.step(action)
                total, steps = total + float(reward), steps + 1
                if terminated or truncated:
                    break
        return total, steps


def episode(name: str, make: Callable[[Any], Any], **overrides: Any) -> tuple[float, dict[str, float], list[Any], Any]:
    """Run one episode; return the reward, its terms, a row for each timestep, and the controller."""
    with closing(gym.make(SCENARIO, **PERIOD, **overrides)) as env:
        env.reset(seed=0)
        act, total, terms, rows, truncated = make(env), 0.0, {}, [], False
        while not truncated:
            _, reward, _, truncated, info = env.step(act(env))
            total += float(reward)
            for term, value in info["reward_terms"].items():
                terms[term] = terms.get(term, 0.0) + value
            sample = env.unwrapped.sample
            power_kw = sample["HVAC_electricity_demand_rate"] / 1e3
            rows.append((sample.time, sample["air_temperature"], sample["cooling_setpoint"], power_kw))
    print(f"{name}: done", flush=True)
    return total, terms, rows, act


def draw(path: Path, results: dict[str, Any]) -> None:
    """Plot temperature, setpoint and power of the last two days."""
    import matplotlib.pyplot as plt

    figure, (room, plant) = plt.subplots(2, 1, figsize=(11, 6), sharex=True, layout="constrained")
    for (name, (_, _, rows, _)), color in zip(results.items(), ("tab:blue", "tab:orange"), strict=True):
        times, temperatures, setpoints, powers = zip(*rows[-2 * 24 * STEPS :], strict=True)
        room.plot(times, temperatures, color=color, label=f"{name}: air")
        room.step(times, setpoints, where="pre", color=color, linestyle=":", label=f"{name}: cooling setpoint")
        plant.step(times, powers, where="pre", color=color, label=name)
    room.axhspan(23.0, 26.0, color="tab:green", alpha=0.12, label="comfort band")
    room.set(ylabel="degC", title=f"{SCENARIO}, the last two days")
    plant.set(ylabel="HVAC electricity, kW")
    for axes in (room, plant):
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    figure.savefig(path, dpi=110)


results = {
    "MPC by branching": episode("MPC by branching", Mpc),
    "rbc, setback=0": episode("rbc, setback=0", partial(rules, setback=0.0, margin=0.3)),
    "rbc, setback=0, margin=0": episode("rbc, setback=0, margin=0", partial(rules, setback=0.0, margin=0.0)),
    "rbc": episode("rbc", partial(rules, setback=6.0, margin=0.3)),
    "baseline control": episode("baseline control", baseline, actuators={}),
}
mpc = results["MPC by branching"][3]
print(f"\n{SCENARIO}, {arguments.days} days; plans of {arguments.hours} h, {mpc.moves} moves")
print(f"{'':28}{'reward':>10}{'energy':>10}{'comfort':>10}{'HVAC kWh':>10}")
for name, (total, terms, rows, _) in results.items():
    energy_kwh = sum(row[3] for row in rows) / STEPS
    print(f"{name:28}{total:10.1f}{terms['energy']:10.1f}{terms['comfort']:10.1f}{energy_kwh:10.1f}")
print(f"{mpc.branch_steps} branch timesteps, {mpc.branch_steps / mpc.seconds:,.0f} per second")
if arguments.plot:
    draw(arguments.plot, {name: results[name] for name in ("MPC by branching", "rbc, setback=0")})
