"""Traces of episodes made by formulas, for reports."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np

from support.builders import actuator, manifest, meter, own_action, sensor
from zenostat.bridge.client.sample import SampleView
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.metrics.episode_weather import EpisodeWeather
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics.messages import Manifest, Sample, Task
from zenostat.topics.points import value_index
from zenostat.views.report import Comparison, Run

J_PER_KWH = 3.6e6
USES = ("Cooling", "Fans", "InteriorLights")
"""End uses of the made-up office: 50, 20 and 30 % of its electricity."""
SHARES = (0.5, 0.2, 0.3)


def office(
    zones: Sequence[str] = ("core", "south"), *, steps: int = 96, begin: str = "2017-07-03T00:00:00"
) -> Manifest:
    """An office with meters of its electricity and end uses, and a temperature, occupants and a setpoint a zone."""
    cool = [actuator(f"{zone}_cooling_setpoint", 22.5, 30.0) for zone in zones]
    base = manifest(
        sensors=[
            *(sensor(f"{zone}_air_temperature", key=zone) for zone in zones),
            *(sensor(f"{zone}_occupants", "Zone People Occupant Count", zone, "1") for zone in zones),
        ],
        meters=[
            meter("electricity"), meter("hvac", "HVAC:Electricity"), *(meter(use, f"{use}:Electricity") for use in USES)
        ],
        actuators=cool,
        task=Task(actions=tuple(own_action(one) for one in cool), reward={"kind": "linear"}),
    )  # fmt: skip
    end = datetime.fromisoformat(begin) + steps * base.timestep
    return base.model_copy(update={"begin": begin, "end": end.isoformat(), "steps": steps, "floor_area_m2": 100.0})


def sample(of: Manifest, step: int, values: Sequence[float], *, source: int = 0, setpoint: float = 24.0) -> SampleView:
    """The sample at the end of a timestep, in which `sources[source]` set all actuators."""
    time = datetime.fromisoformat(of.begin) + step * of.timestep
    message = Sample(
        episode=[0],
        step=[step],
        time=[time.isoformat()],
        elapsed_s=[of.step_s * step],
        flags=[0],
        values=np.array(values, "<f8").tobytes(),
        effective=np.full(len(of.actuators), setpoint).tobytes(),
        source_index=np.full(len(of.actuators), source, "<u2").tobytes(),
        sources=["", "env-1", "operator"],
    )
    return SampleView(message, of, value_index(of))


def recorded(
    of: Manifest,
    kw: Sequence[float],
    temperatures: Sequence[Sequence[float]],
    occupants: Sequence[Sequence[float]],
    *,
    terms: Mapping[str, float] | None = None,
    source: int = 0,
) -> tuple[Trajectory, EpisodeMetrics]:
    """Record an episode: power of the facility in kW; temperatures and occupants of each zone."""
    recorder, metrics = TrajectoryRecorder(of), MetricsAccumulator(of)
    joules = np.asarray(kw) * of.step_s / 3600.0 * J_PER_KWH
    meters = np.column_stack([joules, 0.7 * joules, *(share * joules for share in SHARES)])
    table = np.column_stack([*temperatures, *occupants, meters])
    before = np.append(table[0, : -meters.shape[1]], np.full(meters.shape[1], 1e9))  # energy before does not count
    for step, row in enumerate(np.vstack([before, table])):
        view = sample(of, step, row.tolist(), source=source)
        recorder.add(view, terms if step else None)
        metrics.add(view, terms if step else None)
    return recorder.trajectory({"env-1": "rbc"}), metrics.result()


def run(name: str, of: Manifest, *recording: Any, episodes: int = 1, **options: Any) -> Run:
    """A run of equal episodes; see `recorded`."""
    trajectory, metrics = recorded(of, *recording, **options)
    weather = EpisodeWeather(3600.0, np.linspace(10.0, 30.0, 24), np.linspace(0.0, 900.0, 24))
    return Run(
        name, (metrics,) * episodes, trajectory, tuple(range(episodes)), ("Denver",) * episodes, (weather,) * episodes
    )  # fmt: skip


def office_comparison(
    names: Sequence[str] = ("baseline", "rbc"), *, building: str = "office", **texts: Any
) -> Comparison:
    """Two controllers on one day: the second one saves a tenth of the electricity and lets the south overheat."""
    of = office().model_copy(update={"building": building})
    hours = np.arange(96) / 4
    kw = 10.0 + 20.0 * ((hours >= 8) & (hours < 18))
    people = ((hours >= 8) & (hours < 18)).astype(float)
    mild, hot = np.full(96, 24.0), np.where(people > 0, 28.0, 24.0)
    first = run(names[0], of, kw, (mild, mild), (people, people), terms={"energy": -2.0, "comfort": 0.0})
    second = run(
        names[1], of, 0.9 * kw, (mild, hot), (people, people), terms={"energy": -1.8, "comfort": -1.0}, source=1
    )  # fmt: skip
    return Comparison((first, second), **texts)
