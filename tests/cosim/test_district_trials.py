"""Trials of a whole district, by trials of its plants: the samples of the steps that follow, and no trace of them."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.coupled_plants import FakeCoupled, district_file, manifest_of, orchestrated

from zenostat.bridge.node.plant import Provenance, TryingPlant
from zenostat.cosim.copies import DistrictCopy, PlantSnapshots
from zenostat.cosim.coupled import GuardedPlant
from zenostat.cosim.file import OnLost
from zenostat.cosim.market_plant import MarketPlant, market_manifest
from zenostat.cosim.plant import DistrictPlant, describe
from zenostat.cosim.trials import MAX_TIMESTEPS, PlantTrials, is_short
from zenostat.topics.errors import EngineDied, ForkFailed

ACYCLIC = """timestep: 30min
plants: {a: {plant: "p.py:P"}, b: {plant: "p.py:P"}, c: {plant: "p.py:P"}}
connections:
  - {from: a.x, to: b.u, resample: mean}
  - {from: b.x, to: c.u, delay: 1}
"""
SOLVED = ACYCLIC + "  - {from: b.x, to: a.u, resample: mean, solve: true, tolerance: 1.0e-6}\n"
LOOP = SOLVED.replace(", delay: 1", ", resample: mean").replace(
    "from: b.x, to: a.u, resample: mean", "from: c.x, to: a.u"
)
TRADED = """timestep: 30min
plants:
  market: {market: {high: 1.0, limit_w: 1.2, tolerance_w: 0.01, bidders: [{demand: a.x}, {demand: b.x}]}}
  a: {plant: "p.py:P"}
  b: {plant: "p.py:P"}
  c: {plant: "p.py:P"}
connections:
  - {from: market.price, to: a.u, unit: EUR/kWh}
  - {from: market.price, to: b.u, unit: EUR/kWh}
  - {from: b.x, to: c.u, delay: 1}
"""
FILES = {"acyclic": ACYCLIC, "delayed": SOLVED, "loop": LOOP, "market": TRADED}


def mixed(state: list[float], row: list[float]) -> tuple[list[float], list[float]]:
    value = 0.7 * state[0] + 0.3 * float(np.sin(np.nan_to_num(row[0]) + np.nan_to_num(row[1])))
    return [value], [value]


def district(
    folder: Path, text: str, on_lost: OnLost = OnLost.STOP, log: list[str] | None = None, seed: int | None = None
) -> Any:
    """A district at sample 0 whose plant b has half the timestep, and its plants; `seed` of the first episode."""
    file = district_file(folder, text)
    actuators: Any = {"u": ("W", None, None), "v": ("W", -9.0, 9.0)}
    plants: dict[str, Any] = {
        name: FakeCoupled(
            manifest_of({"x": "W"}, actuators, step_s=900.0 if name == "b" else 1800.0, steps=48),
            mixed, first=[start], name=name, log=log,
        )
        for name, start in (("a", 1.0), ("b", -2.0), ("c", 0.5))
    }  # fmt: skip
    if market := file.spec.plants.get("market"):
        manifest = market_manifest("market", market.market, {n: p.manifest for n, p in plants.items()}, 1800.0)
        plants = {"market": MarketPlant(manifest, market.market), **plants}
    _, binding, guarded = orchestrated(file, plants, on_lost)
    plant = DistrictPlant(
        binding, describe(binding, "quarter", "", Provenance()), guarded, file.spec.solver, threading.Event(), seed
    )
    if seed is None:
        plant.next_episode([0], [5], [1], [False])
    plant.start([0])
    return plant, plants


def test_district_plant__seed_of_the_first_episode_is_that_of_a_reset(tmp_path: Path) -> None:
    """Both give the plants the same seeds, in this episode and in the next one without a seed."""
    (first, own), (reset, others) = district(tmp_path, ACYCLIC, seed=5), district(tmp_path, ACYCLIC)
    for plant in (first, reset):
        plant.next_episode([0], [None], [2], [False])
        plant.start([0])
    seeds = [own[name].seeds[-2:] for name in "abc"]
    assert seeds == [others[name].seeds[-2:] for name in "abc"]
    assert len({seed for of_plant in seeds for seed in of_plant}) == 6


def taken(plant: Any, commands: Any) -> tuple[bytes, bytes]:
    plant.step(commands.tobytes(), [0])
    return plant.values(), plant.effective


def commands_of(plant: Any, count: int, seed: int) -> Any:
    return np.random.default_rng(seed).uniform(-3.0, 3.0, (count, len(plant.description.actuators)))


@pytest.mark.parametrize("name", FILES)
@settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), trials=st.lists(st.integers(0, 3), min_size=4, max_size=4))
def test_district_trials__equal_the_steps_and_leave_no_trace(
    tmp_path: Path, name: str, seed: int, trials: list[int]
) -> None:
    """Random trials of up to three steps before each of four steps: to the bit, with all points of the district."""
    plant, plants = district(tmp_path, FILES[name])
    untried, _ = district(tmp_path, FILES[name])
    steps, others = commands_of(plant, 8, seed), commands_of(plant, 3, seed + 1)
    expected = [taken(untried, commands) for commands in steps]
    assert isinstance(plant, TryingPlant)
    for number, length in enumerate(trials):
        if length:
            copy = plant.fork_for_trial([0, 0], tmp_path / "unused", length)
            for later in range(length):
                copy.step(steps[number + later].tobytes() + others[later].tobytes(), [0, 1])
                size = len(copy.values()) // 2
                assert copy.values()[:size] == expected[number + later][0]
                assert copy.effective[: len(copy.effective) // 2] == expected[number + later][1]
                assert copy.values()[size:] != expected[number + later][0]
            copy.close()
        assert taken(plant, steps[number]) == expected[number]
    assert [len(plants[name].commands) for name in "abc"] == [4, 8, 4]


def test_district_trials__plants_of_two_threads_have_one_request_each(tmp_path: Path) -> None:
    """Loops that are solved at the same time: a thread asks for its samples while another one sends all requests."""
    _, plants = district(tmp_path, ACYCLIC)
    guarded = {
        name: GuardedPlant(name, plants[name], OnLost.STOP, timeout_s=0.0, stop=threading.Event()) for name in "ac"
    }
    tried = PlantTrials(guarded).branches(threading.Event(), None)  # type: ignore[arg-type]
    results: list[Any] = []
    begin = plants["a"].begin_trial

    def finish_c() -> None:
        try:
            results.append(tried["c"].finish())
        except Exception as error:
            results.append(error)

    other = threading.Thread(target=finish_c)

    def send(commands: Any) -> None:
        other.start()
        other.join(0.1)  # it ends only if it does not wait for this request
        begin(commands)

    plants["a"].begin_trial = send
    for name in "ac":
        tried[name].begin(np.zeros((1, 2)))
    samples = tried["a"].finish()
    other.join()
    assert [type(result) for result in results] == [type(samples)], results


def test_district_trials__plants_of_a_level_try_side_by_side(tmp_path: Path) -> None:
    """In a trial of the district, and in the trials of a loop."""
    log: list[str] = []
    fan = LOOP.replace("from: b.x, to: c.u, resample: mean", "from: a.x, to: c.u")
    plant, plants = district(tmp_path, fan, log=log)
    commands = commands_of(plant, 1, 3)[0]
    plant.fork_for_trial([0], tmp_path, 1).step(commands.tobytes(), [0])
    assert len(plants["a"].commands) == 0
    first = ["a tries", "a has tried", "c tries", "c has tried"]
    assert log[:4] == first
    assert log[-2:] == ["b tries", "b has tried"]
    log.clear()
    side, _ = district(
        tmp_path, ACYCLIC.replace("from: a.x, to: b.u, resample: mean", "from: c.x, to: b.u, delay: 1"), log=log
    )
    side.fork_for_trial([0], tmp_path, 1).step(commands_of(side, 1, 3).tobytes(), [0])
    assert log == ["a tries", "b tries", "c tries", "a has tried", "b has tried", "c has tried"]


def test_district_trials__plant_has_one_request_for_all_alternatives(tmp_path: Path) -> None:
    """Those of a loop and of a market, which differ from alternative to alternative, come in turn."""
    log: list[str] = []
    plant, plants = district(tmp_path, ACYCLIC, log=log)
    copy = plant.fork_for_trial([0] * 5, tmp_path, 2)
    copy.step(commands_of(plant, 5, 3).tobytes(), range(5))
    assert log == ["a tries", "c tries", "a has tried", "c has tried", "b tries", "b has tried"]
    assert [plants[name].tries for name in "abc"] == [5, 5, 5]
    with pytest.raises(ForkFailed, match="a trial has no copies"):
        copy.fork([0], tmp_path)


def test_district_trials__lost_plant_is_named_and_the_district_goes_on(tmp_path: Path) -> None:
    plant, plants = district(tmp_path, ACYCLIC, OnLost.GO_ON)
    commands = commands_of(plant, 3, 1)
    plants["c"].fails_at = 0
    with pytest.raises(EngineDied, match=r"plant 'c': node 'node' is gone"):
        plant.fork_for_trial([0], tmp_path, 1).step(commands[0].tobytes(), [0])
    taken(plant, commands[0])
    with pytest.raises(ForkFailed, match=r"plant 'c' is lost, and a trial has all plants or none"):
        plant.fork_for_trial([0], tmp_path, 1)
    plants["c"].is_back = True
    taken(plant, commands[1])
    plant.fork_for_trial([0], tmp_path, 1).step(commands[2].tobytes(), [0])


def test_district_trials__long_ones_take_snapshots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each timestep of a trial repeats those before it, which a branch does not."""
    plant, _ = district(tmp_path, ACYCLIC)
    monkeypatch.setattr(PlantSnapshots, "_add", lambda *_: None)
    sources = [plant.fork_for_trial([0], tmp_path, count).source for count in (MAX_TIMESTEPS, MAX_TIMESTEPS + 1)]
    assert [type(source) for source in sources] == [PlantTrials, PlantSnapshots]


def test_district_trials__reply_has_room_for_the_timesteps_of_plants(tmp_path: Path) -> None:
    """At most 48 of the plant with the shortest timestep, unless the trial is a single step."""
    plant, _ = district(tmp_path, ACYCLIC)
    plants = plant.run.plants
    expected = {(1, 1e6): True, (2, 24 * 900.0): True, (2, 25 * 900.0): False, (6, 7200.0): True, (6, 8100.0): False}
    assert {key: is_short(*key, plants) for key in expected} == expected


def test_district_trials__copy_can_be_interrupted(tmp_path: Path) -> None:
    plant, plants = district(tmp_path, ACYCLIC)
    cancelled: list[str] = []
    for name, each in plants.items():
        each.cancel_trial = lambda name=name: cancelled.append(name)
    copy = plant.fork_for_trial([0], tmp_path, 1)
    assert isinstance(copy, DistrictCopy)
    copy.step(commands_of(plant, 1, 1).tobytes(), [0])
    copy.interrupt()
    assert cancelled == ["a", "b", "c"]
