"""Values of plants whose timesteps are shorter than that of the district."""

import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.coupled_plants import FakeCoupled, district_file, manifest_of, orchestrated

import zenostat  # noqa: F401  # registers the environments
from zenostat.cosim.market import MarketSpec
from zenostat.cosim.market_plant import market_manifest
from zenostat.cosim.run import DistrictRun
from zenostat.topics.messages import Aggregation, Manifest, Sensor

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_run__values_are_combined_by_their_aggregation(folder: Path) -> None:
    manifest = manifest_of({}, {"u": ("1", None, None)}, meters={"heat": "J"}, step_s=300.0, steps=3)
    sensors = tuple(Sensor(name=kind, unit="1", aggregation=kind) for kind in Aggregation)
    plant = FakeCoupled(
        manifest.model_copy(update={"sensors": sensors}),
        lambda state, _: ([state[0] * 2.0], [state[0]] * 4),
        first=[1.0],
    )
    file = district_file(folder, 'timestep: 15min\nplants: {a: {plant: "x:A"}}\n')
    _, binding, guarded = orchestrated(file, {"a": plant})
    run = DistrictRun(binding, guarded, file.spec.solver)
    run.start({"a": 1})
    run.step(np.array([np.nan]).tobytes())
    row = dict(zip([*Aggregation, "available", "heat"], np.frombuffer(run.values), strict=True))
    assert row == {"mean": 7.0 / 3.0, "sum": 7.0, "instant": 4.0, "available": 1.0, "heat": 7.0}


DISTRICT = """name: coarse
timestep: 1h
duration: 6h
plants:
  feeder: {grid: feeder.yaml, plant_arguments: {step_s: 900}}
  heat:
    plant: zenostat.plants.heat:DistrictHeating
    plant_arguments: {step_s: 600, initial_c: 60, begin: "2026-07-01T00:00"}
"""


@pytest.mark.slow
def test_district__powers_of_grids_and_heat_networks_are_those_of_their_meters(scratch: Path) -> None:
    pytest.importorskip("power_grid_model")
    for name in ("feeder.yaml", "feeder.csv"):
        shutil.copy(EXAMPLES / name, scratch)
    (scratch / "coarse.yaml").write_text(DISTRICT)
    with gym.make("zenostat/District-v1", file=scratch / "coarse.yaml", reward=None) as created:
        env: Any = created.unwrapped
        env.reset(seed=1)
        for _ in range(6):
            env.step((env.action_space.low + env.action_space.high) / 2.0)
            sample = env.sample
            for power, meter in (
                ("feeder.import", "feeder.electricity"),
                ("feeder.export", "feeder.electricity_exported"),
                ("feeder.losses", "feeder.losses_energy"),
                ("heat.source_power", "heat.electricity"),
            ):
                assert sample[power] * 3600.0 == pytest.approx(sample[meter], rel=1e-12, abs=1e-6), power
            taken = sum(sample[f"heat.{name}"] for name in ("north_heat", "south_heat", "tank_loss", "pipe_loss"))
            assert sample["heat.source_heat"] == pytest.approx(taken + sample["heat.tank_charge"], rel=1e-9)


def test_market__holds_its_price_for_the_timestep() -> None:
    spec = MarketSpec(high=1.0, limit_w=1.0, bidders=[{"demand": "a.y"}])
    manifest: Manifest = market_manifest("m", spec, {"a": manifest_of({"y": "W"}, {})}, None)
    means = {sensor.name for sensor in manifest.sensors if sensor.aggregation is Aggregation.MEAN}
    assert means == {"price", "demand", "cleared_demand", "limit"}


@pytest.mark.parametrize(("step_s", "steps"), [(0.1, 10), (0.2, 5), (60.0, 24), (1e-3, 3000)])
def test_market__has_as_many_timesteps_as_its_plants(step_s: float, steps: int) -> None:
    spec = MarketSpec(high=1.0, limit_w=1.0, bidders=[{"demand": "a.y"}])
    others = {"a": manifest_of({"y": "W"}, {}, step_s=step_s, steps=steps)}
    assert market_manifest("m", spec, others, None).steps == steps
