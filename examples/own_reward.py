"""Your own rewards: a function, and a class with state. Each is used for two days of a small office.

Run it: `python examples/own_reward.py`
"""

from collections.abc import Mapping, Sequence
from datetime import datetime

import gymnasium as gym
import numpy as np


def cool_and_cheap(values: Mapping[str, float], begin: datetime) -> dict[str, float]:
    """Return reward terms by name; the reward is their sum. `values` has the node's sensors and meters by name."""
    too_warm = max(values["core_temperature"] - 24.0, 0.0) if 8 <= begin.hour < 18 else 0.0
    return {"energy": -values["electricity"] / 3.6e6, "comfort": -too_warm}


class Steady:
    """Penalize changes of temperature. Each environment creates its own instance."""

    previous: float | None = None

    def reset(self, slots: Sequence[int] | None) -> None:  # noqa: ARG002
        """Reset the state at the start of an episode."""
        self.previous = None

    def __call__(self, values: Mapping[str, float], begin: datetime) -> float:  # noqa: ARG002
        """Return the reward, without terms."""
        now = values["core_temperature"]
        change, self.previous = 0.0 if self.previous is None else abs(now - self.previous), now
        return -change


for reward in (cool_and_cheap, Steady):
    env = gym.make(
        "zenostat:zenostat/Building-v1",
        building="office-small",
        weather="USA_CO_Denver",
        begin="07-01",
        end="07-02",
        steps_per_hour=4,
        sensors={"core_temperature": ("Zone Air Temperature", "Core_ZN")},
        meters={"electricity": "Electricity:Facility"},
        actuators={"core_cooling": ("Zone Temperature Control", "Cooling Setpoint", "Core_ZN", 22.5, 30.0)},
        reward=reward,
    )
    env.reset(seed=0)
    sums, truncated = {}, False
    while not truncated:
        _, _, _, truncated, info = env.step(np.array([24.0], np.float32))
        for name, term in info["reward_terms"].items():
            sums[name] = sums.get(name, 0.0) + term
    env.close()
    print(f"{reward.__name__}: " + ", ".join(f"{name} {total:.2f}" for name, total in sums.items()))
