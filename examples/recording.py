"""Record a building, simulate the recording again to see that it is the same to the bit, and read it.

An environment records to run.mcap for a summer day with noisy weather under random setpoints. The recording is then
verified: a new EnergyPlus gets the recorded actuator values, and every value has to be equal. At last it is read: as
arrays by name, as a log of who commanded what, and as a table.

Run it: `python examples/recording.py [--days 1] [--out run.mcap]`
"""

import argparse
from contextlib import closing
from pathlib import Path

import gymnasium as gym
import numpy as np

from zenostat import recording
from zenostat.eplus_node.verify_recording import verify

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--days", type=int, default=1)
parser.add_argument("--out", type=Path, default=Path("run.mcap"), help="the recording; it must not exist yet")
arguments = parser.parse_args()

TEMPERATURE, SETPOINT = "core_zn_air_temperature", "core_zn_cooling_setpoint"

# Make a recording.
env = gym.make(
    "zenostat/Building-v1",
    building="ref-small-office",
    weather="USA_CO_Denver",
    begin="07-03",
    end=f"07-{2 + arguments.days:02}",
    weather_noise={"dry_bulb_temperature": {"sigma": 2.0, "mu": 0.0, "tau_h": 12.0}},
    record=arguments.out,
)
with closing(env):
    env.reset(seed=1)
    env.action_space.seed(1)
    truncated = False
    while not truncated:
        _, _, _, truncated, _ = env.step(env.action_space.sample())

# Verify it.
result = verify(arguments.out)
print(result)
assert result.passed

# Read it. The first episode is the one that the reset with a seed replaced.
run = recording.load(arguments.out)
day = run.episodes[-1]
print(f"episode {day.number}, seed {day.seed}, {day.weather}: {len(day)} samples of {len(run.manifest.names)} points")
warmest = int(np.argmax(day[TEMPERATURE]))
print(f"warmest at {day.time[warmest].astype('datetime64[m]')}: {day[TEMPERATURE][warmest]:.1f} degC in the core zone,")
print(f"  cooling setpoint {day[SETPOINT][warmest]:.1f} degC, set by {day.value_source(SETPOINT)[warmest]}")
for entry in run.log[-3:]:
    print(f"{entry.simulated}  {entry.source}: {entry.kind} {entry.subject}, {entry.count} times, {entry.result}")
recording.write_csv(run, arguments.out.with_suffix(".csv"))
print(f"the same as a table: {arguments.out.with_suffix('.csv')}")
