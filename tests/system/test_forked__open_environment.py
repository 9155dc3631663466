"""A process forked with an open environment: clear errors there, a prompt end, and the parent goes on."""

import json
from typing import Any

import pytest
from support.nodes import SMALL, Program

pytestmark = pytest.mark.usefixtures("scratch")

PROGRAM = """
import gc, json, os, sys
import gymnasium as gym
import zenostat

slots, settings = int(sys.argv[1]), json.loads(sys.argv[2])
if slots == 1:
    env = gym.make("zenostat/Building-v1", **settings, affinity="off")
else:
    env = gym.make_vec("zenostat/Building-v1", slots, "vector_entry_point", **settings, affinity="off")
env.reset(seed=0)
action = env.action_space.sample()
env.step(action)
bus = zenostat.connect(env.unwrapped.local_node.endpoint, affinity="off")
listening = bus.listen("building")
samples = listening.__enter__()
pid = os.fork()
if pid == 0:
    said = {}
    def attempt(what, do):
        try:
            do()
        except Exception as error:
            said[what] = [type(error).__name__, str(error)]
    attempt("step", lambda: env.step(action))
    attempt("snapshot", env.unwrapped.snapshot)
    attempt("reset", env.reset)
    attempt("nodes", bus.nodes)
    attempt("listen", lambda: next(samples))
    listening.__exit__(None, None, None)
    bus.close()
    env.close()
    attempt("closed", env.reset)
    del env, bus, samples, listening
    gc.collect()
    print(json.dumps(said), flush=True)
    sys.exit(7)
_, status = os.waitpid(pid, 0)
env.step(action)
print(json.dumps({"child": os.waitstatus_to_exitcode(status), "heard": next(samples).step}), flush=True)
listening.__exit__(None, None, None)
bus.close()
env.reset(seed=0)
env.step(action)
env.close()
print("done", flush=True)
"""


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("slots", [1, 2])
def test_forked_child__gets_an_error_and_the_parent_goes_on(slots: int) -> None:
    with Program(PROGRAM, str(slots), json.dumps(SMALL)) as program:
        outcome: dict[str, Any] = program.json()
        assert {outcome[what][0] for what in ("step", "reset", "snapshot", "nodes", "listen")} == {"BusError"}
        assert all("this process was forked" in outcome[what][1] for what in ("step", "reset", "snapshot", "nodes"))
        assert outcome["closed"][0] == "EpisodeChanged"
        assert program.json() == {"child": 7, "heard": 2}
        assert program.line() == "done"
        assert program.end()[0] == 0
