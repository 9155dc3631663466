"""One worker: simulates in bursts, as it is told (`bench.pace`).

`python -m bench.worker KIND SCENE OPTIONS`
"""

from __future__ import annotations

import json
import os
import queue
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench import scenes
from bench.listeners import listening
from bench.pace import Over, Pace

WARM_UP = 1000
"""Steps before the first burst."""


class InProcess:
    """EnergyPlus in this process, as peers run it: through the wheel's own Python API."""

    def __init__(self, found: dict[str, Any], folder: Path) -> None:
        from pyenergyplus.api import EnergyPlusAPI

        checked, files = scenes.prepared(found, folder)
        self.points = checked.points
        self.action = scenes.setpoints(self.points.actuators)
        self.arguments = ["-w", str(files.weather), "-d", str(folder), str(files.model)]
        self.api = EnergyPlusAPI()
        self.state = self.api.state_manager.new_state()
        self.api.runtime.set_console_output_status(self.state, False)
        for sensor in self.points.sensors:
            self.api.exchange.request_variable(self.state, sensor.variable, sensor.key)

    def run(self, exchange: Callable[[Any], None], tick: Callable[[], None] | None) -> None:
        """Simulates; `exchange` at the end of each timestep, and `tick` after it."""
        live = False

        def step(state: Any) -> None:
            try:
                exchange(state)
                if tick is not None:
                    tick()
            except Over:
                os._exit(0)  # the files are in a folder of whoever started this worker

        def warm(state: Any) -> None:
            nonlocal live
            if self.api.exchange.kind_of_sim(state) == 3 and not live:
                live = True
                self._find(state)
                step(state)

        def end(state: Any) -> None:
            if live:
                step(state)

        self.api.runtime.callback_after_new_environment_warmup_complete(self.state, warm)
        self.api.runtime.callback_end_zone_timestep_after_zone_reporting(self.state, end)
        self.api.runtime.run_energyplus(self.state, self.arguments)

    def _find(self, state: Any) -> None:
        exchange, points = self.api.exchange, self.points
        self.sensors = [exchange.get_variable_handle(state, s.variable, s.key) for s in points.sensors]
        self.actuators = [
            exchange.get_actuator_handle(state, a.component_type, a.control_type, a.key) for a in points.actuators
        ]

    def read(self, state: Any) -> list[float]:
        """All points, as they are."""
        exchange = self.api.exchange
        values = [exchange.get_variable_value(state, h) for h in self.sensors]
        return values + [exchange.get_meter_value(state, h) for h in self.points.meter_handles]

    def set(self, state: Any, values: Any) -> None:
        """All actuators."""
        for handle, value in zip(self.actuators, values, strict=True):
            self.api.exchange.set_actuator_value(state, handle, value)


def chain(run: InProcess, pace: Pace, *, affinity: str) -> None:
    """Across processes over Zenoh as `env.step` is, with bare bytes and nothing done to them."""
    from bench.chain import Chain
    from bridge.runtime.affinity import Affinity

    with Chain(run, Path(tempfile.mkdtemp()), Affinity(affinity)) as made:
        _in_turn(made.step, pace)


class _FirstTick:
    """Begins at the first tick, which is sample 0."""

    def __init__(self, pace: Pace) -> None:
        self._pace, self._begun = pace, False

    def __call__(self) -> None:
        if self._begun:
            self._pace.tick()
        else:
            self._begun = True
            self._pace.begin()


def bare(run: InProcess, pace: Pace) -> None:
    """EnergyPlus alone, with an empty callback."""
    run.run(lambda state: None, _FirstTick(pace))


def callback(run: InProcess, pace: Pace) -> None:
    """A callback in EnergyPlus's own process reads and writes the points."""

    def exchange(state: Any) -> None:
        run.read(state)
        run.set(state, run.action)

    run.run(exchange, _FirstTick(pace))


def queues(run: InProcess, pace: Pace) -> None:
    """EnergyPlus in a thread, two queues of one entry: how peers make an environment of it."""
    observations: queue.Queue[list[float]] = queue.Queue(maxsize=1)
    actions: queue.Queue[Any] = queue.Queue(maxsize=1)

    def exchange(state: Any) -> None:
        observations.put(run.read(state))
        run.set(state, actions.get())

    threading.Thread(target=run.run, args=(exchange, None), daemon=True).start()
    observations.get()
    try:
        pace.begin()
        while True:
            actions.put(run.action)
            np.array(observations.get(), np.float32)
            pace.tick()
    except Over:
        os._exit(0)


def _in_turn(step: Callable[[], Any], pace: Pace, **about: Any) -> None:
    """Steps in bursts, once what a forked engine writes to is its own."""
    for _ in range(WARM_UP):
        step()
    pace.begin(**about)
    while True:
        step()
        pace.tick()


def environment(found: dict[str, Any], pace: Pace, *, monitors: int = 0, **more: Any) -> None:
    """`env.step` across processes over Zenoh."""
    import gymnasium as gym

    import agent_sdk  # noqa: F401  # registers the environments

    identity = found.pop("scenario", "zenostat/Building-v1")
    with ExitStack() as stack:
        env: Any = gym.make(identity, **found, **more)
        stack.callback(env.close)
        stack.enter_context(listening(env.unwrapped.local_node.endpoint, monitors))
        env.reset(seed=0)
        action = scenes.setpoints(env.unwrapped.manifest.actuators)[: env.action_space.shape[0]].astype(np.float32)
        status = env.unwrapped.link.bus.status(env.unwrapped.manifest.node)
        memory_mb = (status.node_rss_bytes + status.engine_rss_bytes) / 1e6
        _in_turn(lambda: env.step(action), pace, memory_mb=memory_mb)


def engines(found: dict[str, Any], pace: Pace, *, count: int) -> None:
    """Engines of one node that step together by its sockets alone: no bus, no node, no controller."""
    from eplus_node.engine.client import EngineClient
    from eplus_node.engine.group import EngineGroup
    from eplus_node.engine.spec import EngineSpec

    folder = Path(tempfile.mkdtemp())
    checked, files = scenes.prepared(found, folder)
    cores, points, period = sorted(os.sched_getaffinity(0)), checked.points, checked.period
    run = EngineSpec(files.model, files.weather, folder, period.steps, period.steps_per_hour, points)
    with ExitStack() as stack:
        first = EngineClient(run)
        stack.callback(first.close)
        first.receive()
        links = []
        for number in range(count):
            own = folder / f"slot-{number}"
            own.mkdir()
            links.append(first.fork(replace(run, folder=own, cpus=(cores[number % len(cores)],))))
            stack.callback(links[-1].close)
            links[-1].receive()
        values = np.tile(scenes.setpoints(points.actuators), count).tobytes()
        together, nobody = EngineGroup(links), bytes(len(values) // 8)
        together.begin(range(count))
        _in_turn(lambda: together.step(values, nobody, range(count)), pace)


def slots(found: dict[str, Any], pace: Pace, *, count: int, **more: Any) -> None:
    """Slots of one node, without an environment around them: what the bus and the node take of it."""
    from agent_sdk.bus.bus import connect
    from agent_sdk.bus.local_node import LocalNode
    from bridge.runtime.affinity import Affinity

    placement = Affinity(more.get("affinity", Affinity.SEPARATE_CORES))
    node = LocalNode({**found, "slots": count, "name": "bench"}, placement)
    with ExitStack() as stack:
        stack.callback(node.close)
        bus = stack.enter_context(connect(node.endpoint, affinity=placement, core=node.core))
        link = stack.enter_context(bus.controller("bench"))
        link.reset(seed=0)
        values = scenes.setpoints(link.manifest.actuators)
        if count > 1:
            values = np.tile(values, (count, 1))

        def step() -> None:
            link.send(values)
            link.receive()

        _in_turn(step, pace)


def vector(found: dict[str, Any], pace: Pace, *, count: int, mode: str, **more: Any) -> None:
    """A vector environment: our own (`vector_entry_point`), or Gymnasium's over single environments."""
    import gymnasium as gym

    import agent_sdk  # noqa: F401  # registers the environments

    identity = found.pop("scenario", "zenostat/Building-v1")
    kwargs: dict[str, Any] = {"vector_kwargs": {"context": "spawn"}} if mode == "async" else {}
    envs: Any = gym.make_vec(identity, num_envs=count, vectorization_mode=mode, **kwargs, **found, **more)
    with ExitStack() as stack:
        stack.callback(envs.close)
        envs.reset(seed=0)
        width = envs.single_action_space.shape[0]
        action = np.tile([20.0, 25.0], (count, width // 2)).astype(np.float32)
        _in_turn(lambda: envs.step(action), pace)


IN_PROCESS: dict[str, Callable[..., None]] = {"bare": bare, "callback": callback, "queues": queues, "chain": chain}
ACROSS = {"env": environment, "engines": engines, "slots": slots, "vector": vector}


def main() -> None:
    """Simulates what the command line says."""
    kind, scene, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
    found, core = scenes.settings(scene, options.pop("sensors", None)), options.pop("core", None)
    if core is not None:
        os.sched_setaffinity(0, {core})
    pace = Pace()
    if kind in IN_PROCESS:
        with suppress(Over):
            IN_PROCESS[kind](InProcess(found, Path(tempfile.mkdtemp())), pace, **options)
        return
    with suppress(Over):
        ACROSS[kind](found, pace, **options)


if __name__ == "__main__":
    main()
