"""The defaults of the controllers that come along: no less comfortable than the building's own control."""

from __future__ import annotations

import math
from contextlib import closing
from itertools import pairwise
from typing import Any

import pytest
from support import data_packs as packs
from support.builders import actuator, manifest, sensor, view
from support.nodes import SMALL

from agent_sdk.controllers import Agent, PIDController
from agent_sdk.controllers.comfort_band import inside
from agent_sdk.envs.arguments import of_scenario
from agent_sdk.envs.building_env import BuildingEnv
from agent_sdk.evaluation.evaluate import evaluate
from topics.errors import InvalidConfig

WEEK = {"begin": "07-10", "end": "07-16", "affinity": "off"}


@pytest.fixture(scope="module", autouse=True)
def pack() -> Any:
    """The data pack, fetched if it is not there."""
    return packs.sinergym()


def outside_kh(scenario: str, *controllers: str) -> dict[str, float]:
    """Degree-hours outside the comfort band by controller."""
    found = evaluate(scenario, ["baseline", *controllers], **WEEK)
    assert found.unfit == {}
    return {row["controller"]: row["outside_kh"] for row in found.table()}


@pytest.mark.slow
@pytest.mark.parametrize(
    "scenario",
    [
        "datacenter_dx-chicago-continuous-v1",
        "datacenter_cw-chicago-continuous-v1",
        "office-mixed-continuous-v1",
        "shop-mixed-continuous-v1",
        "warehouse-mixed-continuous-v1",
    ],
)
def test_rules_are_no_less_comfortable_than_the_buildings_own_control(scenario: str) -> None:
    found = outside_kh(scenario, "rbc", "incremental")
    assert found["rbc"] <= found["baseline"]
    assert found["incremental"] <= found["baseline"]


def test_a_band_is_kept_by_a_kelvin_or_a_third_of_it() -> None:
    assert inside((18.0, 27.0)) == (19.0, 26.0)
    assert inside((20.0, 21.5)) == (20.5, 21.0)
    assert inside((20.0, 21.0), 5.0) == (20.5, 20.5)
    assert inside((20.0, 21.0), 0.0) == (20.0, 21.0)


@pytest.mark.parametrize("steps_per_hour", [1, 4, 12, 60])
@pytest.mark.parametrize("lag_h", [0.0, 0.2, 1.0, 8.0])
@pytest.mark.parametrize("gain", [0.1, 0.5, 1.0])
def test_pid_settles_where_a_zone_follows_its_setpoint_at_once_or_with_a_lag(
    steps_per_hour: int, lag_h: float, gain: float
) -> None:
    """A zone that follows its setpoint by `gain`, and stands 2 K above it."""
    of = manifest(sensors=[sensor("air")], actuators=[actuator("cooling_setpoint", 15.0, 35.0)])
    of = of.model_copy(update={"step_s": 3600.0 / steps_per_hour})
    control, air, airs = PIDController(of, setpoint=24.0), 27.0, []
    left = math.exp(-1.0 / steps_per_hour / lag_h) if lag_h else 0.0
    for _ in range(200 * steps_per_hour):
        (setpoint,) = control.act(view(of, air=air)).values()
        goal = 24.0 + gain * (setpoint - 22.0)
        air = goal + (air - goal) * left
        airs.append(air)
    assert airs[-1] == pytest.approx(24.0, abs=0.1)
    late = airs[len(airs) // 2 :]
    assert max(late) - min(late) < 0.5


def test_pid_does_not_swing_in_a_building() -> None:
    with closing(BuildingEnv(**of_scenario("datacenter_dx-chicago-continuous-v1"), **WEEK)) as env:
        agent = Agent(PIDController(env.manifest, setpoint=24.0))
        env.reset(seed=0)
        for _ in range(300):
            env.step(agent.action(env.sample))
        airs = []
        for _ in range(96):
            env.step(agent.action(env.sample))
            airs.append(env.sample["west_zone_air_temperature"])
    assert max(abs(a - b) for a, b in pairwise(airs)) < 1.0
    assert sum(airs) / len(airs) == pytest.approx(24.0, abs=0.3)


@pytest.mark.slow
def test_evaluate_goes_on_without_a_controller_that_does_not_fit() -> None:
    day = {**SMALL, "affinity": "off"}
    found = evaluate(day, ["baseline", "pid", "rbc"], parameters={"setpoint": 24.0})
    assert [row["controller"] for row in found.table()] == ["baseline", "rbc"]
    assert list(found.unfit) == ["pid"]
    assert "pid takes one sensor: name it by sensor=" in found.unfit["pid"]
    with pytest.raises(InvalidConfig, match="pid takes one sensor"):
        evaluate(day, ["pid"], parameters={"setpoint": 24.0})
    named = {"setpoint": 24.0, "sensor": "core_zn_air_temperature", "actuator": "core_zn_cooling_setpoint"}
    silent = evaluate(day, ["pid", "rbc"], parameters=named)  # the other actions are left to the building
    assert [row["controller"] for row in silent.table()] == ["rbc"]
    assert "leaves" in silent.unfit["pid"]
