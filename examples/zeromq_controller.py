"""A controller that speaks ZeroMQ and msgpack alone: warm afternoons in the core zone, an episode in lockstep.

Start a node and the gateway first, in two other terminals:

    zenostat node --building office-small --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office
    zenostat gateway zeromq --node office

Then: `python examples/zeromq_controller.py` (it needs pyzmq and msgpack, nothing of Zenostat)
"""

import argparse
import array

import msgpack
import zmq

parser = argparse.ArgumentParser()
parser.add_argument("--publish", default="tcp://127.0.0.1:5556")
parser.add_argument("--command", default="tcp://127.0.0.1:5557")
parser.add_argument("--node", default="office")
asked = parser.parse_args()
root, me, context = f"zenostat/v2/{asked.node}", "drift", zmq.Context()

samples, requests = context.socket(zmq.SUB), context.socket(zmq.REQ)
samples.connect(asked.publish)
samples.subscribe(f"{root}/sample")
requests.connect(asked.command)


def ask(what: str, **fields: object) -> dict:
    """A request and its answer, or the end with the reason why not."""
    requests.send_multipart([f"{root}/{what}".encode(), msgpack.packb(fields)])
    _, encoding, payload = requests.recv_multipart()
    answer = msgpack.unpackb(payload)
    if encoding.endswith(b".ErrorReply"):
        raise SystemExit(f"{answer['error']}: {answer['message']}")
    return answer


actuators = [actuator["name"] for actuator in ask("manifest")["actuators"]]
setpoint = actuators.index("core_zn_cooling_setpoint")
sample = msgpack.unpackb(samples.recv_multipart()[2])  # whoever subscribes gets the latest
ask("rpc/claim", controller=me, actuators=[actuators[setpoint]])
while not sample["flags"][0] & 2:  # 2: the run period is over
    values = array.array("d", [0.0] * len(actuators))
    operations = bytearray(len(actuators))  # 0: keep, 1: set, 2: relinquish
    values[setpoint], operations[setpoint] = (26.0 if sample["time"][0][11:13] >= "12" else 24.0), 1
    answered = sample["episode"], sample["step"]
    ask(f"command/{me}", episode=answered[0], step=answered[1], operations=bytes(operations), values=values.tobytes())
    while (sample["episode"], sample["step"]) == answered:  # one that is known already may come again
        sample = msgpack.unpackb(samples.recv_multipart()[2])
print(f"{sample['step'][0]} timesteps to {sample['time'][0]}")
context.destroy()
