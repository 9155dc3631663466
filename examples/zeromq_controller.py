"""A controller that uses only ZeroMQ and msgpack: a higher cooling setpoint of the core zone in the afternoon.

Start a node and the gateway first, in two other terminals:

    zenostat node --building office-small --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office
    zenostat gateway zeromq --node office

Then: `python examples/zeromq_controller.py` (needs pyzmq and msgpack, but not Zenostat)
"""

import argparse
import array

import msgpack
import zmq

parser = argparse.ArgumentParser()
parser.add_argument("--publish", default="tcp://127.0.0.1:5556")
parser.add_argument("--command", default="tcp://127.0.0.1:5557")
parser.add_argument("--node", default="office")
parser.add_argument("--name", default="drift")
arguments = parser.parse_args()
root, controller, context = f"zenostat/v3/{arguments.node}", arguments.name, zmq.Context()

published, requests = context.socket(zmq.SUB), context.socket(zmq.REQ)
published.connect(arguments.publish)
published.subscribe(f"{root}/sample")
published.subscribe(f"{root}/event")
requests.connect(arguments.command)


def request(key: str, **fields: object) -> dict:
    """Send a request and return the reply; exit with the reason if it is an error."""
    requests.send_multipart([f"{root}/{key}".encode(), msgpack.packb(fields)])
    _, encoding, payload = requests.recv_multipart()
    reply = msgpack.unpackb(payload)
    if encoding.endswith(b".ErrorReply"):
        raise SystemExit(f"{reply['error']}: {reply['message']}")
    return reply


def next_sample() -> dict:
    """Return the next sample; exit with the reason if the episode has failed or the node has stopped."""
    while True:
        topic, _, payload = published.recv_multipart()
        message = msgpack.unpackb(payload)
        if topic.endswith(b"/sample"):
            return message
        if message["kind"] in ("failed", "stopped"):
            raise SystemExit(message["text"])


actuators = [actuator["name"] for actuator in request("manifest")["actuators"]]
setpoint = actuators.index("core_zn_cooling_setpoint")
sample = next_sample()  # a new subscriber receives the latest sample
request(f"rpc/claim/{controller}", controller=controller, actuators=[actuators[setpoint]])
while not sample["flags"][0] & 2:  # 2: the run period is over
    values = array.array("d", [0.0] * len(actuators))
    operations = bytearray(len(actuators))  # 0: keep, 1: set, 2: relinquish
    values[setpoint], operations[setpoint] = (26.0 if sample["time"][0][11:13] >= "12" else 24.0), 1
    answered = sample["episode"], sample["step"]
    request(
        f"command/{controller}",
        episode=answered[0],
        step=answered[1],
        operations=bytes(operations),
        values=values.tobytes(),
    )
    while (sample["episode"], sample["step"]) == answered:  # skip repetitions of the answered sample
        sample = next_sample()
print(f"{sample['step'][0]} timesteps to {sample['time'][0]}")
context.destroy()
