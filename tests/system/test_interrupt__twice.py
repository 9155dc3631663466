"""Ctrl-C twice while an environment is made: one KeyboardInterrupt, and nothing is left."""

import json
import os
import signal

import psutil
import pytest
from support.nodes import SMALL, Program, command_of, until

pytestmark = pytest.mark.usefixtures("scratch")

PROGRAM = """
import json, sys, traceback
import gymnasium as gym
import zenostat

print("ready", flush=True)
try:
    gym.make("zenostat/Building-v1", **json.loads(sys.argv[1]), affinity="off")
except KeyboardInterrupt:
    print(json.dumps(traceback.format_exc().count("Traceback")), flush=True)
"""


def holds_pipe(pid: int, pipe: str) -> bool:
    return any(target(f"/proc/{pid}/fd/{number}") == pipe for number in os.listdir(f"/proc/{pid}/fd"))


def target(link: str) -> str:
    try:
        return os.readlink(link)
    except FileNotFoundError:  # closed meanwhile
        return ""


def node_of(program: Program) -> psutil.Process | None:
    children = psutil.Process(program.pid).children()
    return next((child for child in children if "zenostat.eplus_node" in command_of(child)), None)


@pytest.mark.slow
def test_interrupt__second_does_not_disturb_what_the_first_began() -> None:
    with Program(PROGRAM, json.dumps(SMALL)) as program:
        program.line()
        node = until(lambda: node_of(program), "there is a node")
        pipe = os.readlink(f"/proc/{node.pid}/fd/0")
        node.suspend()  # it cannot end, and its owner waits for it
        try:
            program.process.send_signal(signal.SIGINT)
            until(lambda: not holds_pipe(program.pid, pipe), "the environment is being closed")
            program.process.send_signal(signal.SIGINT)
        finally:
            node.resume()
        assert program.json() == 1
        code, _, stderr = program.end()
        assert (code, stderr) == (0, "")
