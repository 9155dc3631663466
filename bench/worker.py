"""One measurement in a process of its own: prints microseconds a step as JSON.

`python -m bench.worker KIND BUILDING DAYS MONITORS`
"""

from __future__ import annotations

import json
import queue
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from models import design_days
from models.building import prepared, read_building, write
from models.catalog import find_building, find_weather
from models.points import Points, choose
from models.survey import survey
from models.weather import read_header

WEATHER = "USA_CO_Denver"
SKIP = 96
STEPS_PER_HOUR = 4


def _days(days: int) -> tuple[str, str]:
    return "07-01", f"07-{days:02}"


def _action(points: int) -> Any:
    return np.tile([20.0, 25.0], points // 2)


class InProcess:
    """EnergyPlus in this process, as peers run it: through the wheel's own Python API."""

    def __init__(self, building: str, days: int, folder: Path) -> None:
        from pyenergyplus.api import EnergyPlusAPI

        model = read_building(find_building(building))
        weather = find_weather(WEATHER).path
        period = model.period(*_days(days), STEPS_PER_HOUR)
        self.points: Points = choose(model, survey(model, weather), None, None, None)
        self.steps = period.steps
        objects = design_days.apply(prepared(model, period), design_days.site(weather, read_header(weather)))
        path = write(objects, folder)
        self.arguments = ["-w", str(weather), "-d", str(folder), str(path)]
        self.api = EnergyPlusAPI()
        self.state = self.api.state_manager.new_state()
        self.api.runtime.set_console_output_status(self.state, False)
        for sensor in self.points.sensors:
            self.api.exchange.request_variable(self.state, sensor.variable, sensor.key)
        self.times: list[float] = []

    def run(self, exchange: Callable[[Any], None]) -> None:
        live = False
        step = 0

        def warm(state: Any) -> None:
            nonlocal live
            if self.api.exchange.kind_of_sim(state) == 3 and not live:
                live = True
                self._find(state)
                exchange(state)

        def end(state: Any) -> None:
            nonlocal step
            if live:
                step += 1
                if step < self.steps:
                    exchange(state)
                self.times.append(time.perf_counter())

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
        exchange = self.api.exchange
        values = [exchange.get_variable_value(state, h) for h in self.sensors]
        return values + [exchange.get_meter_value(state, h) for h in self.points.meter_handles]

    def set(self, state: Any, values: Any) -> None:
        for handle, value in zip(self.actuators, values, strict=True):
            self.api.exchange.set_actuator_value(state, handle, value)


def bare(run: InProcess) -> list[float]:
    """EnergyPlus alone, with an empty callback."""
    run.run(lambda state: None)
    return run.times


def callback(run: InProcess) -> list[float]:
    """A callback in EnergyPlus's own process reads and writes the points."""
    action = _action(len(run.points.actuators))

    def exchange(state: Any) -> None:
        run.read(state)
        run.set(state, action)

    run.run(exchange)
    return run.times


def queues(run: InProcess) -> list[float]:
    """EnergyPlus in a thread, two queues of one entry: how peers make an environment of it."""
    action = _action(len(run.points.actuators))
    observations: queue.Queue[list[float]] = queue.Queue(maxsize=1)
    actions: queue.Queue[Any] = queue.Queue(maxsize=1)

    def exchange(state: Any) -> None:
        observations.put(run.read(state))
        run.set(state, actions.get())

    thread = threading.Thread(target=run.run, args=(exchange,))
    thread.start()
    for _ in range(run.steps):
        np.array(observations.get(), np.float32)
        actions.put(action)
    thread.join()
    return run.times


def environment(building: str, days: int, monitors: int, affinity: str) -> tuple[list[float], float]:
    """`env.step` across processes over Zenoh; also the resident megabytes of node and engine."""
    import gymnasium as gym

    import agent_sdk
    from bench.listeners import listening

    begin, end = _days(days)
    times = []
    with ExitStack() as stack:
        env = gym.make(
            "zenostat/Building-v1",
            building=building,
            weather=WEATHER,
            begin=begin,
            end=end,
            steps_per_hour=STEPS_PER_HOUR,
            affinity=affinity,
        )
        stack.callback(env.close)
        stack.enter_context(listening(env.unwrapped.own_node.endpoint, monitors))
        env.reset(seed=0)
        action = _action(env.action_space.shape[0]).astype(np.float32)
        truncated = False
        while not truncated:
            truncated = env.step(action)[3]
            times.append(time.perf_counter())
            if len(times) == SKIP:
                status = env.unwrapped.link.bus.status(env.unwrapped.manifest.node)
    assert agent_sdk
    return times, (status.node_rss_bytes + status.engine_rss_bytes) / 1e6


def main() -> None:
    """Measures what the command line says."""
    kind, building, days, monitors = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    memory_mb = None
    in_process = {"bare": bare, "callback": callback, "queues": queues}
    if kind in in_process:
        with tempfile.TemporaryDirectory(prefix="zenostat-bench-") as folder:
            times = in_process[kind](InProcess(building, days, Path(folder)))
    else:
        times, memory_mb = environment(building, days, monitors, kind)
    spans = np.diff(times[SKIP + 1 :])
    figures = {"mean_us": float(spans.mean() * 1e6), "median_us": float(np.median(spans) * 1e6)}
    print(json.dumps({**figures, "memory_mb": memory_mb}))


if __name__ == "__main__":
    main()
