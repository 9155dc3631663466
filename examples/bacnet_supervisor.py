"""Pre-cooling over BACnet: a lower cooling setpoint before people come, at a higher priority than the PLC's.

It needs bacpypes3 only, and a node with a gateway (see docs/hardware-in-the-loop.md):

    zenostat gateway bacnet office --address 127.0.0.1:47808
    python examples/bacnet_supervisor.py
"""

import argparse
import asyncio

from bacpypes3.app import Application
from bacpypes3.errors import ExecutionError
from bacpypes3.local.device import DeviceObject
from bacpypes3.local.networkport import NetworkPortObject
from bacpypes3.pdu import Address
from bacpypes3.primitivedata import Null

parser = argparse.ArgumentParser()
parser.add_argument("--device", default="127.0.0.1:47808", help="address of the gateway")
parser.add_argument("--own", default="127.0.0.1:47809", help="own address; on the loopback with another port")
parser.add_argument("--output", default="core_zn_cooling_setpoint")
parser.add_argument("--value", type=float, default=23.0)
parser.add_argument("--hours", type=int, nargs=2, default=(3, 6), help="begin and end, in simulated time")
parser.add_argument("--priority", type=int, default=8)
parser.add_argument("--pause", type=float, default=0.5, help="seconds between two looks at the simulated time")
arguments = parser.parse_args()


async def main() -> None:
    """Write the value once the hours begin, relinquish it once they are over, and end."""
    port = NetworkPortObject(arguments.own, objectIdentifier=("network-port", 1), objectName="port")
    supervisor = DeviceObject(objectIdentifier=("device", 2), objectName="supervisor", vendorIdentifier=999)
    app = Application.from_object_list([supervisor, port])
    device = Address(arguments.device)
    answers = await app.who_is(address=device)
    if not answers:
        raise SystemExit(f"no BACnet device answers at {device}; start the gateway first")
    (answer,) = answers
    identifiers = await app.read_property(device, answer.iAmDeviceIdentifier, "object-list")
    objects = {await app.read_property(device, each, "object-name"): each for each in identifiers}
    output, begin_end, is_active = objects[arguments.output], tuple(arguments.hours), False
    print(f"{answer.iAmDeviceIdentifier} with {len(objects)} objects", flush=True)
    while True:
        time = (await app.read_property(device, objects["node/time"], "present-value")).time
        if not is_active and begin_end[0] <= time[0] < begin_end[1]:
            await app.write_property(device, output, "present-value", arguments.value, priority=arguments.priority)
            is_active = True
            print(f"{time}: {arguments.output} = {arguments.value}", flush=True)
        elif is_active and not begin_end[0] <= time[0] < begin_end[1]:
            await app.write_property(device, output, "present-value", Null(()), priority=arguments.priority)
            print(f"{time}: relinquished", flush=True)
            break
        await asyncio.sleep(arguments.pause)
    app.close()


try:
    asyncio.run(main())
except ExecutionError as error:  # of the gateway: the node is gone, or rejected the write
    raise SystemExit(f"{error}") from None
