"""The defaults of the controllers that come along: no less comfortable than the building's own control."""

import math
from contextlib import closing
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import data_packs as packs
from support.builders import actuator, manifest, sensor, view
from support.nodes import SMALL

from zenostat.agent_sdk.controllers import Agent, PIDController
from zenostat.agent_sdk.controllers.comfort_band import inside
from zenostat.agent_sdk.envs.arguments import of_scenario
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.lab.evaluate import evaluate
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

SETPOINT_NAMES = ("heating_setpoint", "cooling_setpoint")
WEEK = {"begin": "07-10", "end": "07-16", "affinity": "off"}


@pytest.fixture(scope="module", autouse=True)
def pack() -> Any:
    """The data pack, fetched if it is not there."""
    return packs.sinergym()


def outside_kh(scenario: str, *controllers: str) -> dict[str, float]:
    """Degree-hours outside the comfort band by controller."""
    evaluation = evaluate(scenario, ["baseline", *controllers], **WEEK)
    assert evaluation.unfit == {}
    return {row["controller"]: row["outside_kh"] for row in evaluation.table()}


@pytest.mark.slow
@pytest.mark.parametrize(
    "scenario",
    [
        "datacenter_dx-chicago-continuous-v1", "datacenter_cw-chicago-continuous-v1", "office-mixed-continuous-v1",
        "shop-mixed-continuous-v1", "warehouse-mixed-continuous-v1",
    ],
)  # fmt: skip
def test_controllers__rules_are_no_less_comfortable_than_the_buildings_own_control(scenario: str) -> None:
    discomfort = outside_kh(scenario, "rbc", "incremental")
    assert discomfort["rbc"] <= discomfort["baseline"]
    assert discomfort["incremental"] <= discomfort["baseline"]


def test_controllers__band_is_kept_by_a_kelvin_or_a_third_of_it() -> None:
    assert inside((18.0, 27.0)) == (19.0, 26.0)
    assert inside((20.0, 21.5)) == (20.5, 21.0)
    assert inside((20.0, 21.0), 5.0) == (20.5, 20.5)
    assert inside((20.0, 21.0), 0.0) == (20.0, 21.0)


@pytest.mark.variants
@pytest.mark.parametrize("steps_per_hour", [1, 4, 12, 60])
@pytest.mark.parametrize("lag_h", [0.0, 0.2, 1.0, 8.0])
@pytest.mark.parametrize("gain", [0.1, 0.5, 1.0])
def test_controllers__pid_settles_where_a_zone_follows_its_setpoint_at_once_or_with_a_lag(
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


def thermostat(name: str, step_s: float = 900.0) -> Manifest:
    """A node with one zone setpoint of 10 to 40 degC."""
    of = manifest(sensors=[sensor("air")], actuators=[actuator(name, 10.0, 40.0)])
    return of.model_copy(update={"step_s": step_s})


def output(control: PIDController, air: float) -> float:
    (setpoint,) = control.act(view(control.manifest, air=air)).values()
    return setpoint


@pytest.mark.parametrize(
    ("name", "floats_at", "comes_back_at", "integral"),
    [
        ("cooling_setpoint", 20.0, 26.0, 0.0),
        ("cooling_setpoint", 24.8, 26.0, 0.25),  # until the setpoint is 0.5 K above the zone, of which 0.06 K by kp
        ("heating_setpoint", 30.0, 24.0, 0.0),
        ("heating_setpoint", 25.2, 24.0, -0.25),
    ],
)
def test_controllers__pid_is_ready_when_a_zone_returns_after_it_floated(
    name: str, floats_at: float, comes_back_at: float, integral: float
) -> None:
    control = PIDController(thermostat(name), setpoint=25.0)
    for _ in range(48):
        output(control, floats_at)
    proportional_and_step = (25.0 - comes_back_at) * (0.3 + 0.5 / 4)
    assert output(control, comes_back_at) == pytest.approx(25.0 + integral + proportional_and_step, abs=0.02)


@pytest.mark.parametrize("name", SETPOINT_NAMES)
def test_controllers__pid_leaves_its_limit_at_once(name: str) -> None:
    """A zone that cannot follow: at 20 degC kp takes 1.5 K of the 2 K to the limit, and the integral the rest."""
    control = PIDController(thermostat(name), setpoint=25.0)
    for _ in range(48):
        output(control, 20.0)
    assert output(control, 26.0) <= 25.0 + 0.5 - 0.3 + 1e-9
    control = PIDController(thermostat(name), setpoint=25.0)
    for _ in range(48):
        output(control, 30.0)
    assert output(control, 24.0) >= 25.0 - 0.5 + 0.3 - 1e-9


@given(airs=st.lists(st.floats(-20.0, 60.0), max_size=40), kd=st.floats(0.0, 2.0), name=st.sampled_from(SETPOINT_NAMES))
def test_controllers__pid_keeps_a_zone_setpoint_near_its_own(airs: list[float], kd: float, name: str) -> None:
    control = PIDController(thermostat(name), setpoint=25.0, kd=kd)
    assert all(23.0 <= output(control, air) <= 27.0 for air in airs)
    wide = PIDController(thermostat(name), setpoint=25.0, kd=kd, max_offset=5.0, low=24.0)
    assert all(24.0 <= output(wide, air) <= 30.0 for air in airs)


def test_controllers__pid_refuses_a_setpoint_that_its_output_cannot_reach() -> None:
    with pytest.raises(
        InvalidConfig, match=r"setpoint = 45 is out of reach: 'cooling_setpoint' has bounds of 10 to 40"
    ):
        PIDController(thermostat("cooling_setpoint"), setpoint=45.0)
    with pytest.raises(InvalidConfig, match="max_offset = 0; expected more than 0 K"):
        PIDController(thermostat("cooling_setpoint"), setpoint=25.0, max_offset=0)


@given(
    step_h=st.floats(1 / 60, 24.0),
    gain=st.floats(0.3, 1.0),
    lag_h=st.floats(0.0, 10.0),
    kp=st.floats(0.0, 0.9),
    ki=st.floats(0.0, 5.0),
    offset=st.floats(-0.4, 1.5),
)
def test_controllers__pid_settles_at_any_timestep_where_a_zone_follows_its_setpoint(
    step_h: float, gain: float, lag_h: float, kp: float, ki: float, offset: float
) -> None:
    """A zone that follows its cooling setpoint by `gain`, and stands `offset` above it; the output is not limited."""
    control = PIDController(
        thermostat("cooling_setpoint", 3600.0 * step_h), setpoint=25.0, kp=kp, ki=ki, max_offset=15.0
    )
    air, left, airs = 25.1, math.exp(-step_h / lag_h) if lag_h else 0.0, []
    for _ in range(300):
        goal = 25.0 + gain * (output(control, air) - 25.0) + gain * offset
        air = goal + (air - goal) * left
        airs.append(air)
    assert max(abs(a - b) for a, b in pairwise(airs[-20:])) < 0.05, "no swing is left"
    if not lag_h and min(ki * step_h, 1.0 - kp) * gain > 0.1:
        assert airs[-1] == pytest.approx(25.0, abs=1e-3)


def test_controllers__pid_of_a_valve_is_stable_for_a_day_as_a_timestep() -> None:
    """A room that a valve of 0 to 1 heats by up to 10 K: kp = 0.3 (high - low) / change, as the page has it."""
    of = manifest(sensors=[sensor("air")], actuators=[actuator("valve", 0.0, 1.0)])
    of = of.model_copy(update={"step_s": 86400.0})
    control, air = PIDController(of, setpoint=21.0, kp=0.03), 15.0
    for _ in range(60):
        air = 15.0 + 10.0 * output(control, air)
    assert air == pytest.approx(21.0, abs=1e-3)


def test_controllers__pid_integrates_up_to_its_limit_in_long_timesteps() -> None:
    """A step of the integral that would pass the limit (0.95 * 3 K) still takes the output to it."""
    control = PIDController(thermostat("heating_setpoint", 86400.0), setpoint=25.0, kp=0.05)
    assert output(control, 22.0) == 27.0
    assert output(control, 22.0) == 27.0


@pytest.mark.slow
def test_controllers__pid_does_not_swing_in_a_building() -> None:
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
def test_controllers__evaluate_goes_on_without_a_controller_that_does_not_fit() -> None:
    day = {**SMALL, "affinity": "off"}
    evaluation = evaluate(day, ["baseline", "pid", "rbc"], parameters={"setpoint": 24.0})
    assert [row["controller"] for row in evaluation.table()] == ["baseline", "rbc"]
    assert list(evaluation.unfit) == ["pid"]
    assert "pid takes one sensor: name it by sensor=" in evaluation.unfit["pid"]
    with pytest.raises(InvalidConfig, match="pid takes one sensor"):
        evaluate(day, ["pid"], parameters={"setpoint": 24.0})
    named = {"setpoint": 24.0, "sensor": "core_zn_air_temperature", "actuator": "core_zn_cooling_setpoint"}
    silent = evaluate(day, ["pid", "rbc"], parameters=named)  # the other actions are left to the building
    assert [row["controller"] for row in silent.table()] == ["rbc"]
    assert "leaves" in silent.unfit["pid"]
