"""Three controllers of one building: one for each half, and a supervisor that overrides one of them for an hour.

Start a node first, in another terminal:

    zenostat node --building ref-small-office --weather USA_CO_Denver --begin 07-03 --end 07-03 --name office \
        --policy hold --grace 2 --deadline 5

Then: `python examples/two_floors.py [--connect tcp/127.0.0.1:7447] [--node office]`
"""

import argparse
import collections
import threading

import zenostat
from zenostat import SampleView

HALVES = {
    "north": ["core_zn_cooling_setpoint", "perimeter_zn_3_cooling_setpoint", "perimeter_zn_4_cooling_setpoint"],
    "south": ["perimeter_zn_1_cooling_setpoint", "perimeter_zn_2_cooling_setpoint"],
}
OCCUPIED_DEGC = {"north": 25.0, "south": 24.0}

parser = argparse.ArgumentParser()
parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
parser.add_argument("--node", default="office")
arguments = parser.parse_args()


def control(link: zenostat.ControllerLink, half: str) -> None:
    """Control one half of the building; the node waits for both controllers."""
    for sample in link:
        if half == "north":
            supervise(link.bus, sample)  # before the answer, so that the node still waits
        is_open = 6 <= sample.time.hour < 19
        sample.send(dict.fromkeys(HALVES[half], OCCUPIED_DEGC[half] if is_open else 29.0))


def supervise(bus: zenostat.Bus, sample: SampleView) -> None:
    """At a price peak, raise the cooling setpoint of the core zone for an hour."""
    if sample.time.hour == 15 and sample.time.minute == 0:
        bus.write(arguments.node, "core_zn_cooling_setpoint", 28.0, priority=8, duration_s=3600, source="supervisor")


with zenostat.connect(arguments.connect) as bus, bus.listen(arguments.node) as samples:
    halves = [(bus.controller(arguments.node, name=half, actuators=points), half) for half, points in HALVES.items()]
    threads = [threading.Thread(target=control, args=pair) for pair in halves]
    for thread in threads:
        thread.start()
    timesteps = collections.Counter()
    for sample in samples:
        sources = {name: source.partition("-")[0] for name, source in sample.value_source.items() if source}
        timesteps.update(f"{name} by {source}" for name, source in sources.items())
        if sample.truncated:
            break
    for thread in threads:
        thread.join()

for name_and_source, count in sorted(timesteps.items()):
    print(f"{name_and_source}: {count} timesteps")
