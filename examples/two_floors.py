"""Three controllers on one building: each half answers for its own zones, a supervisor overrides for an hour.

Start a node first, in another terminal:

    zenostat node --building ref-small-office --weather USA_CO_Denver --begin 07-03 --end 07-03 --name office \
        --policy hold --grace 2 --deadline 5

Then: `python examples/two_floors.py [--connect tcp/127.0.0.1:7447] [--node office]`
"""

import argparse
import collections
import threading

import agent_sdk
from agent_sdk.bus.sample import SampleView

HALVES = {
    "north": ["core_zn_cooling_setpoint", "perimeter_zn_3_cooling_setpoint", "perimeter_zn_4_cooling_setpoint"],
    "south": ["perimeter_zn_1_cooling_setpoint", "perimeter_zn_2_cooling_setpoint"],
}
COOL = {"north": 25.0, "south": 24.0}

parser = argparse.ArgumentParser()
parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
parser.add_argument("--node", default="office")
asked = parser.parse_args()


def control(link: agent_sdk.ControllerLink, half: str) -> None:
    """One half's controller: the node waits for both."""
    for sample in link:
        if half == "north":
            supervise(link.bus, sample)  # before the answer: no timestep passes meanwhile
        open_ = 6 <= sample.time.hour < 19
        sample.send(dict.fromkeys(HALVES[half], COOL[half] if open_ else 29.0))


def supervise(bus: agent_sdk.Bus, sample: SampleView) -> None:
    """A price peak: the supervisor has the core drift for an hour."""
    if sample.time.hour == 15 and sample.time.minute == 0:
        bus.write(asked.node, "core_zn_cooling_setpoint", 28.0, priority=8, duration_s=3600, source="supervisor")


with agent_sdk.connect(asked.connect) as bus, bus.listen(asked.node) as samples:
    halves = [(bus.controller(asked.node, name=half, actuators=points), half) for half, points in HALVES.items()]
    threads = [threading.Thread(target=control, args=pair) for pair in halves]
    for thread in threads:
        thread.start()
    ruled = collections.Counter()
    for sample in samples:
        ruled.update(f"{name} by {who.partition('-')[0]}" for name, who in sample.value_source.items() if who)
        if sample.truncated:
            break
    for thread in threads:
        thread.join()

for who, steps in sorted(ruled.items()):
    print(f"{who}: {steps} timesteps")
