"""The PID controller; a timestep is a quarter of an hour."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.builders import manifest, sensor, view
from support.controller_nodes import COOL, HEAT, PEOPLE, ROOM, node, single

from zenostat.agent_sdk.controllers import PIDController, make_controller
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest


def outputs(control: PIDController, airs: list[float], name: str = "valve") -> list[float]:
    return [control.act(view(control.manifest, air=air))[name] for air in airs]


def test_pid__against_a_sequence_by_hand() -> None:
    """kp 2, ki 4 (1 a K and step), kd 0.5 (2 a K of change), about 50.

    T    e     P    I    D                      u
    20   1     2    1    0                      53
    20.5 0.5   1    1.5  -0.5 * 0.5 / 0.25 = -1 51.5
    21.5 -0.5  -1   1    -0.5 * 1 / 0.25 = -2   48
    21   0     0    1    +1                     52
    """
    control = PIDController(single("valve", 0.0, 100.0), setpoint=21.0, kp=2.0, ki=4.0, kd=0.5)
    assert outputs(control, [20.0, 20.5, 21.5, 21.0]) == pytest.approx([53.0, 51.5, 48.0, 52.0])


def test_pid__direct_acting_is_the_mirror_image() -> None:
    of = single("valve", 0.0, 100.0)
    heats = PIDController(of, setpoint=21.0, kp=2.0, ki=4.0, kd=0.5)
    cools = PIDController(of, setpoint=21.0, kp=2.0, ki=4.0, kd=0.5, reverse=False)
    airs = [20.0, 20.5, 21.5, 21.0]
    assert outputs(cools, airs) == pytest.approx([100.0 - u for u in outputs(heats, airs)])


def test_pid__takes_no_integral_on_while_it_is_at_a_limit() -> None:
    """ki 4 is 1 a K and step. At -1 K the output stands at 51 after a step, then at its limit of 52."""
    of = single("valve", 0.0, 52.0)
    control = PIDController(of, setpoint=21.0, kp=0.0, ki=4.0, bias=50.0)
    assert outputs(control, [20.0] * 100) == [51.0] + [52.0] * 99
    # It leaves the limit at once; a wound up integral would hold it there for ninety steps more.
    assert outputs(control, [22.0, 22.0]) == [51.0, 50.0]
    low = PIDController(single("valve", 48.0, 100.0), setpoint=21.0, kp=0.0, ki=4.0, bias=50.0)
    assert outputs(low, [22.0] * 100) == [49.0] + [48.0] * 99
    assert outputs(low, [20.0, 20.0]) == [49.0, 50.0]


def test_pid__forgets_at_an_episodes_begin() -> None:
    control = PIDController(single("valve", 0.0, 100.0), setpoint=21.0, kp=2.0, ki=4.0, kd=0.5)
    first = outputs(control, [20.0, 20.5])
    control.begin(view(control.manifest))
    assert outputs(control, [20.0, 20.5]) == first


@given(st.lists(st.floats(-80.0, 80.0), min_size=1, max_size=30), st.booleans())
def test_pid__stays_within_its_limits(airs: list[float], reverse: bool) -> None:
    control = PIDController(single("valve", 0.0, 1.0), setpoint=21.0, kp=3.0, ki=9.0, kd=2.0, low=0.2, reverse=reverse)
    assert all(0.2 <= u <= 1.0 for u in outputs(control, airs))


def test_pid__holds_a_room_without_offset() -> None:
    """A room that loses 1 K an hour for each K to 0 degC outside and is heated by up to 40 K an hour: 21 needs 21."""
    control = PIDController(single("valve", 0.0, 40.0), setpoint=21.0, kp=2.0, ki=2.0, bias=0.0)
    air = 15.0
    for _ in range(400):
        (heat,) = outputs(control, [air])
        air += (heat - air) * 0.25
    assert air == pytest.approx(21.0, abs=1e-6)
    assert heat == pytest.approx(21.0, abs=1e-6)


def test_pid__drives_a_named_actuator_and_holds_others() -> None:
    of = node(sensors=(sensor("a"), sensor("b")))
    control = PIDController(of, setpoint=21.0, sensor="b", actuator=HEAT.name, kp=1.0, ki=0.0, cooling_setpoint=28.0)
    assert control.act(view(of, a=0.0, b=20.0)) == {HEAT.name: 22.0, COOL.name: 28.0}  # the setpoint, and 1


@pytest.mark.parametrize(
    ("of", "arguments", "message"),
    [
        (node(sensors=(PEOPLE,)), {}, r"pid needs a sensor in degC, but node 'office' has none: add one"),
        (node(), {}, r"pid takes one actuator: name it by actuator=...; there are: 'heating_setpoint', 'cooling"),
        (node(HEAT, sensors=(sensor("a"), sensor("b"))), {},
            r"pid takes one sensor: name it by sensor=...; there are: 'a'"),
        (node(HEAT), {"sensor": "aire"}, "there is no sensor 'aire' in degC for pid; did you mean 'air'"),
        (node(HEAT), {"actuator": "heat"},
            "there is no action or actuator 'heat' for pid; did you mean 'heating_setpoint'"),
        (single("valve", 0.0, None), {}, "'valve' has no bounds: set the limits of the output by low="),
        (node(HEAT), {"high": 30}, "high = 30; expected a number from 15 to 22.5"),
        (node(HEAT), {"low": 20, "high": 18}, "low = 20 is not below high = 18"),
        (node(HEAT), {"kp": -1}, "kp = -1; expected a number of at least 0"),
        (node(HEAT), {"reverse": "yes"}, "reverse = 'yes'; expected true or false"),
        (node(HEAT), {"heating_setpoint": 20},
            "heating_setpoint: the controller's own output cannot have a fixed value"),
        (manifest(sensors=[ROOM]), {}, "pid needs an actuator, but node 'office' has none"),
    ],
)  # fmt: skip
def test_controllers__pids_that_cannot_be(of: Manifest, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidConfig, match=message):
        make_controller(PIDController, of, {"setpoint": 21.0, **arguments})


def test_pid__needs_a_setpoint() -> None:
    with pytest.raises(
        InvalidConfig, match=r"PIDController needs setpoint: --set setpoint=\.\.\., or setpoint= in Python"
    ):
        make_controller(PIDController, node(HEAT), {})
