"""A controller without Gymnasium: raises the cooling setpoint of the core zone while it is unoccupied.

Start a node first, in another terminal:

    zenostat node --building office-small --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office

Then: `python examples/controller_on_the_bus.py [--connect tcp/127.0.0.1:7447] [--node office]`
"""

import argparse

import zenostat

parser = argparse.ArgumentParser()
parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
parser.add_argument("--node", default="office")
arguments = parser.parse_args()

with zenostat.connect(arguments.connect) as bus:
    print(f"nodes: {', '.join(bus.nodes())}")
    with bus.controller(arguments.node, name="saver") as link:
        print(f"{link.name} controls {len(link.manifest.actuators)} actuators of {link.manifest.building}")
        energy_kwh = 0.0
        for sample in link:  # to the end of the run period
            energy_kwh += sample["electricity_facility"] / 3.6e6
            is_unoccupied = sample["core_zn_occupants"] == 0.0
            # All other actuators keep their value source: here baseline control.
            sample.send({"core_zn_cooling_setpoint": 29.0 if is_unoccupied else 25.0})
        print(f"{sample.step} timesteps to {sample.time}: {energy_kwh:.0f} kWh")
        print(f"value source of the core cooling setpoint: {sample.value_source['core_zn_cooling_setpoint']}")
