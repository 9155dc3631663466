"""Workers of the part `plants`: the same exchange of a command and a measurement by different means."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bench import programs
from bench.pace import EndOfBursts, Pace
from zenostat.bridge.runtime import affinity
from zenostat.bridge.runtime.affinity import Affinity

NAME = "empty"
WARM_UP = 1000
"""Steps before the first burst."""


def run(step: Callable[[], Any], pace: Pace) -> None:
    """Step in bursts."""
    for _ in range(WARM_UP):
        step()
    pace.begin()
    while True:
        step()
        pace.tick()


def queues(pace: Pace) -> None:
    """Exchange the values with a thread through two queues of one entry."""
    observations: queue.Queue[Any] = queue.Queue(maxsize=1)
    actions: queue.Queue[Any] = queue.Queue(maxsize=1)

    def simulate() -> None:
        while True:
            observations.put(actions.get())

    def step() -> None:
        actions.put([1.0])
        np.array(observations.get(), np.float32)

    threading.Thread(target=simulate, daemon=True).start()
    try:
        run(step, pace)
    except EndOfBursts:
        os._exit(0)


def echo(pace: Pace, *, placement: str) -> None:
    """Exchange the values as bare bytes with a process that sends them back over Zenoh."""
    from bench.chain import Chain

    with Chain(None, Path(tempfile.mkdtemp()), Affinity(placement)) as chain:
        run(chain.step, pace)


@contextmanager
def _empty_node(placement: Affinity) -> Iterator[tuple[str, int | None]]:
    """Run a node with the plant that does nothing; its endpoint and core."""
    folder = tempfile.mkdtemp()
    endpoint = f"unixsock-stream/{folder}/bus"
    engine_core, core = affinity.pick_cores(placement)
    settings = {"name": NAME, "listen": [endpoint], "folder": folder, "affinity": placement}
    settings |= {"cpu": core, "engine_cpu": engine_core}
    command, pipe = programs.command("empty_plant"), subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, process_group=0, env=programs.environment()) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(settings).encode() + b"\n")
        process.stdin.flush()
        reply = process.stdout.readline()
        if b'"ready"' not in reply:
            raise RuntimeError(f"the node with the empty plant did not start: {reply.decode()}")
        yield endpoint, core


def in_node(pace: Pace, *, placement: str) -> None:
    """Call `env.step` on a plant that does nothing in the node's own process."""
    from zenostat.agent_sdk.envs.building_env import BuildingEnv

    with ExitStack() as stack:
        endpoint, _ = stack.enter_context(_empty_node(Affinity(placement)))
        env = BuildingEnv(connect=endpoint, node=NAME, affinity=placement)
        stack.callback(env.close)
        _step_env(env, pace)


def link(pace: Pace, *, placement: str) -> None:
    """Send commands to that plant and receive its samples, without an environment."""
    from zenostat.bridge.client.bus import connect

    with ExitStack() as stack:
        endpoint, core = stack.enter_context(_empty_node(Affinity(placement)))
        bus = stack.enter_context(connect(endpoint, affinity=Affinity(placement), core=core))
        controller = stack.enter_context(bus.controller(NAME))
        controller.reset(seed=0)
        values = np.ones(1)

        def step() -> None:
            controller.send(values)
            controller.receive()

        run(step, pace)


def in_process_of_its_own(pace: Pace, *, placement: str) -> None:
    """Call `env.step` on a Python class that does nothing, in a process of its own."""
    import gymnasium as gym

    import zenostat  # noqa: F401  # registers the environments

    with ExitStack() as stack:
        plant = f"{Path(__file__).parent / 'idle_class.py'}:Idle"
        env = gym.make("zenostat/Plant-v1", plant=plant, affinity=placement)
        stack.callback(env.close)
        _step_env(env, pace)


def _step_env(env: Any, pace: Pace) -> None:
    env.reset(seed=0)
    action = np.ones(1, np.float32)
    run(lambda: env.step(action), pace)


def helics(pace: Pace, *, core: str, offset_s: float) -> None:
    """Exchange the values between two federates of HELICS."""
    from bench.helics_peer import Controller

    controller = Controller(core, offset_s)
    try:
        run(controller.step, pace)
    finally:
        controller.close()
        os._exit(0)  # HELICS would wait for the federation to end


KINDS: dict[str, Callable[..., None]] = {
    "plant-queues": queues,
    "plant-echo": echo,
    "plant-link": link,
    "plant-in-node": in_node,
    "plant-class": in_process_of_its_own,
    "plant-helics": helics,
}
