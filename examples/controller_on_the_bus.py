"""A controller without Gymnasium: lets the core zone drift while nobody is in it.

Start a node first, in another terminal:

    zenostat node --building office-small --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office

Then: `python examples/controller_on_the_bus.py [--connect tcp/127.0.0.1:7447] [--node office]`
"""

import argparse

import agent_sdk

parser = argparse.ArgumentParser()
parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
parser.add_argument("--node", default="office")
asked = parser.parse_args()

with agent_sdk.connect(asked.connect) as bus:
    print(f"nodes: {', '.join(bus.nodes())}")
    with bus.controller(asked.node, name="saver") as link:
        print(f"{link.name} controls {len(link.manifest.actuators)} actuators of {link.manifest.building}")
        energy_kwh = 0.0
        for sample in link:  # to the end of the run period
            energy_kwh += sample["electricity_facility"] / 3.6e6
            empty = sample["core_zn_occupants"] == 0.0
            # Actuators that are not named keep what they have: here the building's own control.
            sample.send({"core_zn_cooling_setpoint": 29.0 if empty else 25.0})
        print(f"{sample.step} timesteps to {sample.time}: {energy_kwh:.0f} kWh")
        print(f"core cooling setpoint is ruled by {sample.value_source['core_zn_cooling_setpoint']}")
