"""A reset after engines died, at whatever moment before it, begins an episode as if nothing had happened."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from support.nodes import SMALL, NodeProgram, engines_of, hosts_of, node_on_bus, runs, until

import zenostat
from zenostat import ControllerLink
from zenostat.topics import codec
from zenostat.topics.messages import EngineStart, Event, State

pytestmark = pytest.mark.usefixtures("scratch")

NOISE = {"weather_noise": {"dry_bulb": {"sigma": 2.0, "tau_h": 12.0}}}
CASES: dict[str, dict[str, Any]] = {
    "one weather": {},
    "slots and baseline": {"slots": 2, "baseline": True},
    "noise": NOISE,
    "late noise": NOISE | {"noise_start": "third_day", "end": "07-06"},
    "weather in turn": {"weather": ["USA_CO_Denver", "USA_FL_Miami"], "weather_order": "sequence"},
}
TANK = """
class Tank:
    step_s, duration_s = 60.0, 3600.0
    sensors, actuators = {"level": "m"}, {"valve": ("1", 0.0, 1.0, 0.5)}

    def reset(self, seed):
        self.level = float(seed)
        return {"level": self.level}

    def step(self, commands):
        self.level += commands["valve"]
        return {"level": self.level}
"""

Moment = Callable[[zenostat.Bus, list[psutil.Process]], Any]
MOMENTS: dict[str, Moment] = {
    "killed just now": lambda *_: None,
    "dead": lambda _, dead: until(lambda: not any(map(runs, dead)), "the system has ended them"),
    "failed": lambda bus, _: until(lambda: bus.status("office").state is State.FAILED, "the node has noticed"),
}


def kill_all(node: NodeProgram) -> list[psutil.Process]:
    processes = engines_of(node.pid) + hosts_of(node.pid)
    for process in processes:
        with suppress(psutil.NoSuchProcess):  # it was just replaced
            process.kill()
    return processes


@contextmanager
def controlled(folder: Path, **settings: Any) -> Iterator[tuple[NodeProgram, zenostat.Bus, ControllerLink]]:
    with node_on_bus(folder / "node", **settings) as (node, bus), bus.controller("office") as link:
        yield node, bus, link


def first_samples(link: ControllerLink) -> list[Any]:
    """Values and weather of the first samples of an episode of seed 3."""
    seen = [link.reset(seed=3).message.values]
    seen.append([(start.weather, start.noise_parameters) for start in link.accepted.episode_starts])
    bounds = np.array([(a.low, a.high) for a in link.manifest.actuators])
    for step in range(1, 4):
        values = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * step / 4
        link.send(np.tile(values, (link.manifest.slots, 1)) if link.manifest.slots > 1 else values)
        seen.append(link.receive().message.values)
    return seen


def check(node: NodeProgram, bus: zenostat.Bus, link: ControllerLink) -> None:
    undisturbed = first_samples(link)
    for moment in [MOMENTS["killed just now"], *MOMENTS.values()]:
        link.reset(seed=3)  # they wait at sample 0
        moment(bus, kill_all(node))
        assert first_samples(link) == undisturbed
        starts = [start.engine_start for start in link.accepted.episode_starts]
        assert EngineStart.REUSED not in starts, "the reply tells of no engine that is dead"


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("case", CASES)
def test_reset__energyplus_that_died_at_sample_0_is_replaced(scratch: Path, case: str) -> None:
    with controlled(scratch, **SMALL | CASES[case]) as (node, bus, link):
        check(node, bus, link)


@pytest.mark.slow
def test_reset__python_class_whose_process_died_is_started_again(scratch: Path) -> None:
    (scratch / "tank.py").write_text(TANK)
    with controlled(scratch, plant=f"{scratch}/tank.py:Tank", slots=2, baseline=True) as (node, bus, link):
        check(node, bus, link)


@pytest.mark.slow
def test_reset__engine_that_hangs_at_sample_0_is_replaced_and_named(scratch: Path) -> None:
    with (
        controlled(scratch, **SMALL, unresponsive_s=1.0) as (node, bus, link),
        bus.session.declare_subscriber("zenostat/v3/office/event") as events,
    ):
        link.reset(seed=3)
        engines_of(node.pid)[-1].suspend()
        assert first_samples(link)
        texts = [codec.decode(Event, event.payload.to_bytes()).text for event in iter(events.try_recv, None)]
        assert any("the engine waiting at sample 0 is replaced: the engine process neither" in text for text in texts)
