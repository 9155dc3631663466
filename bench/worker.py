"""A worker that simulates in bursts (`bench.pace`): `python -m bench.worker KIND SCENE OPTIONS`."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench import plant_workers, scenes
from bench.pace import EndOfBursts, Pace
from bench.programs import started

WARM_UP = 1000
"""Steps before the first burst."""


class InProcess:
    """EnergyPlus in this process, through the Python API of its wheel, as similar projects run it."""

    def __init__(self, node_settings: dict[str, Any], folder: Path) -> None:
        from pyenergyplus.api import EnergyPlusAPI

        checked, files = scenes.prepared(node_settings, folder)
        self.points = checked.points
        self.action = scenes.setpoints(self.points.actuators)
        self.arguments = ["-w", str(files.weather), "-d", str(folder), str(files.model)]
        self.api = EnergyPlusAPI()
        self.state = self.api.state_manager.new_state()
        self.api.runtime.set_console_output_status(self.state, False)
        for sensor in self.points.sensors:
            self.api.exchange.request_variable(self.state, sensor.variable, sensor.key)

    def run(self, exchange: Callable[[Any], None], tick: Callable[[], None] | None) -> None:
        """Simulate; call `exchange` at the end of each timestep, and `tick` after it."""
        warmed_up = False

        def step(state: Any) -> None:
            try:
                exchange(state)
                if tick is not None:
                    tick()
            except EndOfBursts:
                os._exit(0)  # the process that started this worker removes the files

        def warm(state: Any) -> None:
            nonlocal warmed_up
            if self.api.exchange.kind_of_sim(state) == 3 and not warmed_up:
                warmed_up = True
                self._find(state)
                step(state)

        def end(state: Any) -> None:
            if warmed_up:
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
        """Return the values of all points."""
        exchange = self.api.exchange
        values = [exchange.get_variable_value(state, h) for h in self.sensors]
        return values + [
            sum(exchange.get_meter_value(state, part.index) for part in parts) for parts in self.points.meter_parts
        ]

    def set(self, state: Any, values: Any) -> None:
        """Set all actuators."""
        for handle, value in zip(self.actuators, values, strict=True):
            self.api.exchange.set_actuator_value(state, handle, value)


def chain(run: InProcess, pace: Pace, *, affinity: str) -> None:
    """Step across processes over Zenoh like `env.step`, with bare bytes."""
    from bench.chain import Chain
    from zenostat.bridge.runtime.affinity import Affinity

    with Chain(run, Path(tempfile.mkdtemp()), Affinity(affinity)) as chained:
        _run(chained.step, pace)


class _FirstTick:
    """Begins the bursts at the first tick, which is sample 0."""

    def __init__(self, pace: Pace) -> None:
        self._pace, self._begun = pace, False

    def __call__(self) -> None:
        if self._begun:
            self._pace.tick()
        else:
            self._begun = True
            self._pace.begin()


def bare(run: InProcess, pace: Pace) -> None:
    """Run EnergyPlus alone, with an empty callback."""
    run.run(lambda state: None, _FirstTick(pace))


def callback(run: InProcess, pace: Pace) -> None:
    """Read and write the points in a callback in EnergyPlus's process."""

    def exchange(state: Any) -> None:
        run.read(state)
        run.set(state, run.action)

    run.run(exchange, _FirstTick(pace))


def _compute(seconds: float) -> None:
    """Use that much processor time."""
    if seconds:
        until = time.thread_time() + seconds
        while time.thread_time() < until:
            pass


def queues(run: InProcess, pace: Pace, *, compute_s: float = 0.0) -> None:
    """Run EnergyPlus in a thread with two queues of one entry, as similar projects build an environment."""
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
            _compute(compute_s)
            actions.put(run.action)
            np.array(observations.get(), np.float32)
            pace.tick()
    except EndOfBursts:
        os._exit(0)


def _run(step: Callable[[], Any], pace: Pace, **about: Any) -> None:
    """Step in bursts, after a warm-up in which a forked engine copies the pages that it writes to."""
    for _ in range(WARM_UP):
        step()
    pace.begin(**about)
    while True:
        step()
        pace.tick()


def environment(
    node_settings: dict[str, Any], pace: Pace, *, monitors: int = 0, compute_s: float = 0.0, **arguments: Any
) -> None:
    """Call `env.step`, across processes over Zenoh."""
    import gymnasium as gym

    import zenostat  # noqa: F401  # registers the environments

    identity = node_settings.pop("scenario", "zenostat/Building-v1")
    with ExitStack() as stack:
        env: Any = gym.make(identity, **node_settings, **arguments)
        stack.callback(env.close)
        folder, endpoint = stack.enter_context(tempfile.TemporaryDirectory()), env.unwrapped.local_node.endpoint
        for number in range(monitors):
            monitor = ("monitor", "--connect", endpoint, "--save", f"{folder}/{number}.rrd")
            stack.enter_context(started(*monitor, stderr=subprocess.DEVNULL))
        env.reset(seed=0)
        action = scenes.setpoints(env.unwrapped.manifest.actuators)[: env.action_space.shape[0]].astype(np.float32)
        status = env.unwrapped.link.bus.status(env.unwrapped.manifest.node)
        memory_mb = (status.node_rss_bytes + status.engine_rss_bytes) / 1e6

        def step() -> None:
            _compute(compute_s)
            env.step(action)

        _run(step, pace, memory_mb=memory_mb)


def engines(node_settings: dict[str, Any], pace: Pace, *, count: int) -> None:
    """Step the engines of one node together through their sockets alone: no bus, no node, no controller."""
    from zenostat.bridge.engine.client import EngineClient
    from zenostat.bridge.engine.group import EngineGroup
    from zenostat.eplus_node.engine_spec import engine_spec

    folder = Path(tempfile.mkdtemp())
    checked, files = scenes.prepared(node_settings, folder)
    cores, points = sorted(os.sched_getaffinity(0)), checked.points
    spec = engine_spec(checked, files, folder)
    with ExitStack() as stack:
        first = EngineClient(spec)
        stack.callback(first.close)
        first.receive()
        clients = []
        for number in range(count):
            subfolder = folder / f"slot-{number}"
            subfolder.mkdir()
            clients.append(first.fork(replace(spec, folder=subfolder, cpus=(cores[number % len(cores)],))))
            stack.callback(clients[-1].close)
            clients[-1].receive()
        values = np.tile(scenes.setpoints(points.actuators), count).tobytes()
        group = EngineGroup(len(points.actuators), clients)
        group.begin(range(count))
        _run(lambda: group.step(values, range(count)), pace)


def slots(node_settings: dict[str, Any], pace: Pace, *, count: int, **arguments: Any) -> None:
    """Step the slots of one node without an environment: the cost of bus and node."""
    from zenostat.bridge.client.bus import connect
    from zenostat.bridge.client.local_node import LocalNode
    from zenostat.bridge.runtime.affinity import Affinity

    placement = Affinity(arguments.get("affinity", Affinity.SEPARATE_CORES))
    node = LocalNode({**node_settings, "slots": count, "name": "bench"}, placement)
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

        _run(step, pace)


def vector(node_settings: dict[str, Any], pace: Pace, *, count: int, mode: str, **arguments: Any) -> None:
    """Step a vector environment: Zenostat's (`vector_entry_point`), or Gymnasium's over single environments."""
    import gymnasium as gym

    import zenostat  # noqa: F401  # registers the environments

    identity = node_settings.pop("scenario", "zenostat/Building-v1")
    kwargs: dict[str, Any] = {"vector_kwargs": {"context": "spawn"}} if mode == "async" else {}
    envs: Any = gym.make_vec(identity, num_envs=count, vectorization_mode=mode, **kwargs, **node_settings, **arguments)
    with ExitStack() as stack:
        stack.callback(envs.close)
        envs.reset(seed=0)
        width = envs.single_action_space.shape[0]
        action = np.tile([20.0, 25.0], (count, width // 2)).astype(np.float32)
        _run(lambda: envs.step(action), pace)


IN_PROCESS: dict[str, Callable[..., None]] = {"bare": bare, "callback": callback, "queues": queues, "chain": chain}
ACROSS = {"env": environment, "engines": engines, "slots": slots, "vector": vector}


def main() -> None:
    """Run the worker that the command line names."""
    kind, scene, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
    if kind in plant_workers.KINDS:
        with suppress(EndOfBursts):
            plant_workers.KINDS[kind](Pace(), **options)
        return
    node_settings, core = scenes.settings(scene, options.pop("sensors", None)), options.pop("core", None)
    if core is not None:
        os.sched_setaffinity(0, {core})
    pace = Pace()
    if kind in IN_PROCESS:
        with suppress(EndOfBursts):
            IN_PROCESS[kind](InProcess(node_settings, Path(tempfile.mkdtemp())), pace, **options)
        return
    with suppress(EndOfBursts):
        ACROSS[kind](node_settings, pace, **options)


if __name__ == "__main__":
    main()
