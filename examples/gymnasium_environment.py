"""A building as a Gymnasium environment: one summer week of a small office with fixed setpoints.

Run it: `python examples/gymnasium_environment.py [--days 7]`
"""

import argparse

import gymnasium as gym
import numpy as np

from zenostat.rewards import LinearReward

parser = argparse.ArgumentParser()
parser.add_argument("--days", type=int, default=7)
days = parser.parse_args().days

# To list the points of a building: `zenostat points office-small --match core_zn`.
env = gym.make(
    "zenostat:zenostat/Building-v1",
    building="office-small",
    weather="USA_CO_Denver",
    begin="07-01",
    end=f"07-{days:02}",
    steps_per_hour=4,
    sensors={
        "outdoor_temperature": ("Site Outdoor Air Drybulb Temperature", "Environment"),
        "core_temperature": ("Zone Air Temperature", "Core_ZN"),
        "hvac_power": ("Facility Total HVAC Electricity Demand Rate", "Whole Building"),
    },
    meters={"electricity": "Electricity:Facility"},
    actuators={
        "core_heating": ("Zone Temperature Control", "Heating Setpoint", "Core_ZN", 15.0, 22.5),
        "core_cooling": ("Zone Temperature Control", "Cooling Setpoint", "Core_ZN", 22.5, 30.0),
    },
    reward=LinearReward(weight=0.5),
)

observation, info = env.reset(seed=0)
print(f"sample 0, after warm-up at {info['time']}: {env.unwrapped.observation_dict(observation)}")

total_reward, energy_kwh, truncated = 0.0, 0.0, False
while not truncated:
    action = np.array([20.0, 25.0], np.float32)
    observation, reward, terminated, truncated, info = env.step(action)
    values = env.unwrapped.observation_dict(observation)
    energy_kwh += values["electricity"] / 3.6e6
    total_reward += float(reward)

print(f"{info['step']} timesteps to {info['time']}: {energy_kwh:.0f} kWh, reward {total_reward:.1f}")
print(f"effective values at the end: {dict(zip(('heating', 'cooling'), info['effective'].tolist(), strict=True))}")
env.close()
