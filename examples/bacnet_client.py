"""A BACnet client that uses only bacpypes3: a higher cooling setpoint in the afternoon, one timestep at a time.

Start a node and the gateway first, in two other terminals:

    zenostat node --building office-small --weather USA_CO_Denver --begin 07-03 --end 07-03 --name office --mode free
    zenostat gateway bacnet office --address 127.0.0.1:47808

Then: `python examples/bacnet_client.py` (needs bacpypes3, but not Zenostat)
"""

import argparse
import asyncio

from bacpypes3.apdu import ErrorPDU
from bacpypes3.app import Application
from bacpypes3.local.device import DeviceObject
from bacpypes3.local.networkport import NetworkPortObject
from bacpypes3.pdu import Address
from bacpypes3.primitivedata import Null, ObjectIdentifier

parser = argparse.ArgumentParser()
parser.add_argument("--device", default="127.0.0.1:47808", help="address of the gateway")
parser.add_argument("--own", default="127.0.0.1:47809", help="own address; on the loopback with another port")
parser.add_argument("--output", default="core_zn_cooling_setpoint")
parser.add_argument("--input", default="core_zn_air_temperature")
parser.add_argument("--steps", type=int, default=144)
arguments = parser.parse_args()
device = Address(arguments.device)
PRIORITY = 8  # a manual operator


async def main() -> None:
    """Find the device, and step it through some timesteps."""
    app = Application.from_object_list(
        [
            DeviceObject(objectIdentifier=("device", 1), objectName="thermostat", vendorIdentifier=999),
            NetworkPortObject(arguments.own, objectIdentifier=("network-port", 1), objectName="port"),
        ]
    )
    answers = await app.who_is(address=device)
    if not answers:
        raise SystemExit(f"no BACnet device answers at {device}; start the gateway first")
    (answer,) = answers
    print(f"{answer.iAmDeviceIdentifier} on {answer.pduSource}")
    identifiers = await app.read_property(device, answer.iAmDeviceIdentifier, "object-list")
    objects = {await app.read_property(device, each, "object-name"): each for each in identifiers}

    async def read(name: str) -> object:
        return await app.read_property(device, objects[name], "present-value")

    async def write(name: str, value: object) -> None:
        await app.write_property(device, objects[name], "present-value", value, priority=PRIORITY)

    print(f"{len(objects)} objects; {arguments.output} is {ObjectIdentifier(objects[arguments.output])}")
    await write("node/paused", "active")
    try:
        for _ in range(arguments.steps):
            time = await read("node/time")
            await write(arguments.output, 28.0 if 14 <= time.time[0] < 18 else Null(()))
            await write("node/advance", 1)
            temperature, setpoint = await read(arguments.input), await read(arguments.output)
            print(f"{time.time}  {temperature:5.1f} degC  setpoint {setpoint:.1f} degC")
        await write(arguments.output, Null(()))
    except ErrorPDU:  # write-access-denied
        print("the episode is over")
    await write("node/paused", "inactive")
    app.close()


asyncio.run(main())
