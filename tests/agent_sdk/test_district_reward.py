"""The reward of districts and the rules of the coordinator, on samples by hand."""

from datetime import datetime
from typing import Any

import numpy as np
import pytest
from support.builders import manifest, sensor
from support.trajectories import sample

from zenostat.agent_sdk.controllers import DistrictCoordinator
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.agent_sdk.rewards import DistrictReward
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Actuator, Aggregation, Manifest, Sensor, Task

NOON = datetime(2026, 7, 1, 12)
POINTS = {
    "g.import": "W", "g.export": "W", "g.loading": "percent", "g.price": "EUR/MWh", "g.b_power": "W",
    "g.b_state_of_charge": "fraction", "g.c_power": "W", "g.c_needed": "J", "g.c_departure": "s", "h.own": "degC",
}  # fmt: skip
REWARD = {
    "kind": "district", "consumption": "g.import", "generation": "g.export", "price": "g.price",
    "limits": [{"point": "g.loading", "high": 80.0}],
}  # fmt: skip


def district(**changes: Any) -> Manifest:
    cooling = Actuator(name="h.cooling_setpoint", unit="degC", low=20.0, high=30.0, baseline_sensor="h.own")
    battery = Actuator(name="g.b_setpoint", unit="W", low=-6000.0, high=6000.0, default=0.0)
    charger = Actuator(name="g.c_limit", unit="W", low=0.0, high=10000.0, default=10000.0)
    base = manifest(
        sensors=[Sensor(name=name, unit=unit) for name, unit in POINTS.items()], task=Task(reward={**REWARD, **changes})
    )
    return base.model_copy(update={"actuators": (cooling, battery, charger)})


def row(**values: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    named = {f"g.{name}" if name != "own" else "h.own": value for name, value in values.items()}
    return np.array([named.get(name, 0.0) for name in POINTS])


def bound(**changes: Any) -> Any:
    return DistrictReward.model_validate({**REWARD, **changes}).bind(district())


def test_district_reward__is_the_sum_of_its_terms_by_hand() -> None:
    """w = 0.5; 4 kW for a quarter of an hour at 100 EUR/MWh are 0.1 EUR, at a loading of 100 % of 80 %."""
    reward = bound(peak=2.0, limit=8.0, ramping=0.5, cost=10.0, feed_in=3.0)
    first = reward(row(**{"import": 4000.0}, loading=100.0, price=100.0), NOON)
    assert first.terms == pytest.approx({
        "peak": -0.5 * 2.0 * 4.0, "limit": -0.5 * 8.0 * 0.25, "ramping": 0.0, "cost": -0.5 * 10.0 * 0.1, "feed_in": 0.0,
    })  # fmt: skip
    assert first.reward == pytest.approx(-4.0 - 1.0 - 0.5)
    assert first.metrics == pytest.approx(
        {"net_kw": 4.0, "peak_kw": 4.0, "limit_excess": 0.25, "ramp_kw": 0.0, "cost": 0.1, "feed_in_kwh": 0.0}
    )
    second = reward(row(export=2000.0, loading=50.0, price=300.0), NOON)
    assert second.terms == pytest.approx(
        {"peak": 0.0, "limit": 0.0, "ramping": -0.5 * 0.5 * 6.0, "cost": 0.0, "feed_in": -0.5 * 3.0 * 0.5}
    )
    third = reward(row(**{"import": 8000.0}, price=1000.0), NOON)
    assert third.terms["cost"] == pytest.approx(-0.5 * 10.0 * 2.0 * 0.3)  # at the price that the second sample had
    assert third.terms["peak"] == pytest.approx(-0.5 * 2.0 * (8.0 - 4.0))


def test_district_reward__price_that_is_a_mean_is_that_of_its_own_timestep() -> None:
    """A market's price holds for the timestep that has ended: 4 kW for a quarter of an hour at 100, then at 300."""
    plain = district()
    sensors = tuple(
        each.model_copy(update={"aggregation": Aggregation.MEAN}) if each.name == "g.price" else each
        for each in plain.sensors
    )
    reward = DistrictReward.model_validate(REWARD).bind(plain.model_copy(update={"sensors": sensors}))
    costs = [reward(row(**{"import": 4000.0}, price=price), NOON).metrics["cost"] for price in (100.0, 300.0)]
    assert costs == pytest.approx([0.1, 0.3])


def test_district_reward__peak_is_that_of_the_calendar_day() -> None:
    reward = bound()
    powers = [(NOON, 3.0), (NOON, 5.0), (NOON, 4.0), (datetime(2026, 7, 2, 0, 15), 1.0)]
    terms = [reward(row(**{"import": 1e3 * kw}), begin).terms["peak"] for begin, kw in powers]
    assert terms == pytest.approx([-1.5, -1.0, 0.0, -0.5])
    reward.reset()
    assert reward(row(**{"import": 1e3}), NOON).terms["ramping"] == 0.0


def test_district_reward__comfort_counts_the_named_temperatures_only() -> None:
    reward = bound(weight=0.75, temperatures=["h.own"], lambda_temperature=2.0)
    assert reward(row(own=28.0), NOON).terms["comfort"] == pytest.approx(-0.25 * 2.0 * 2.0)
    assert "comfort" not in bound()(row(own=28.0), NOON).terms


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"consumption": "g.imports"}, "did you mean 'g.import'"),
        ({"consumption": "g.loading"}, "needs energy or power, in units such as J or W, which 'g.loading' is not"),
        ({"limits": [{"point": "g.load", "high": 1.0}]}, "names 'g.load', which the node does not have"),
        ({"price": "g.import"}, "price 'g.import': "),
        ({"weight": 0.0}, "no weight above 0"),
    ],
)
def test_district_reward__point_that_does_not_fit_is_named(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        bound(**changes)


# The coordinator


def act(values: Any, coordinator: DistrictCoordinator | None = None, **parameters: Any) -> dict[str, float | None]:
    coordinator = coordinator or DistrictCoordinator(district(), **{"margin": 1.0, **parameters})
    return coordinator.act(sample(coordinator.manifest, 0, values.tolist()))


def test_coordinator__charges_vehicles_within_the_limit() -> None:
    """30 kW are the limit, 24 kW the houses: 6 kW are left, of which the vehicle needs 4 kW until it leaves."""
    values = row(**{"import": 24000.0}, b_state_of_charge=0.5, c_needed=8 * 3.6e6, c_departure=7200.0)
    commands = act(values, limit_kw=30.0)
    assert commands["g.c_limit"] == pytest.approx(6000.0)
    assert commands["g.b_setpoint"] == 0.0
    assert commands["h.cooling_setpoint"] is None


def test_coordinator__acts_on_the_values_with_injected_faults() -> None:
    coordinator = DistrictCoordinator(district(), margin=1.0, limit_kw=30.0)
    true, faulty = (row(**{"import": watts}, b_state_of_charge=0.5) for watts in (1000.0, 33000.0))
    observed = sample(coordinator.manifest, 0, faulty.tolist())
    observed.message = observed.message.model_copy(update={"fault_free_values": true.astype("<f8").tobytes()})
    assert observed.fault_free_values[0] == 1000.0
    assert coordinator.act(observed)["g.b_setpoint"] == pytest.approx(-3000.0)


def test_coordinator__discharges_for_what_is_missing_and_for_vehicles_that_leave() -> None:
    values = row(**{"import": 29000.0}, b_state_of_charge=0.5, c_needed=8 * 3.6e6, c_departure=7200.0)
    commands = act(values, limit_kw=30.0)
    assert commands["g.c_limit"] == pytest.approx(4000.0)
    assert commands["g.b_setpoint"] == pytest.approx(-3000.0)


def test_coordinator__limit_is_where_the_loading_would_reach_its_own() -> None:
    """40 kW load the transformer with 160 %: its 80 % are 20 kW, so 20 kW are missing, and the battery has 6."""
    values = row(**{"import": 40000.0}, loading=160.0, b_state_of_charge=0.9, own=24.0)
    commands = act(values, raise_k=3.0)
    assert commands["g.b_setpoint"] == pytest.approx(-6000.0)
    assert commands["h.cooling_setpoint"] == pytest.approx(25.5)  # half of the rise in a step


def test_coordinator__own_devices_are_no_demand() -> None:
    """The battery draws 6 of 30 kW and the vehicle 10: the rest is far below the limit."""
    values = row(**{"import": 30000.0}, b_power=6000.0, c_power=10000.0, b_state_of_charge=0.5, c_needed=3.6e6)
    commands = act(values, limit_kw=32.0)
    assert commands["g.c_limit"] == pytest.approx(4000.0)  # a kilowatt-hour in a quarter of an hour
    assert commands["g.b_setpoint"] == pytest.approx(0.0)  # 14 and 4 kW are above half of the limit


def test_coordinator__battery_takes_what_would_be_fed_in() -> None:
    commands = act(row(export=4000.0, b_state_of_charge=0.2), limit_kw=20.0, charge_below=0.0)
    assert commands["g.b_setpoint"] == pytest.approx(4000.0)


def test_coordinator__setpoints_return_within_an_hour() -> None:
    coordinator = DistrictCoordinator(district(), limit_kw=20.0, margin=1.0, raise_k=2.0)
    high = row(**{"import": 60000.0}, own=24.0)
    rises = [act(high, coordinator)["h.cooling_setpoint"] for _ in range(2)]
    assert rises == pytest.approx([25.0, 26.0])
    low = row(**{"import": 1000.0}, own=24.0, b_state_of_charge=0.9)
    returns = [act(low, coordinator)["h.cooling_setpoint"] for _ in range(4)]
    assert returns == [pytest.approx(25.5), pytest.approx(25.0), pytest.approx(24.5), None]


def test_coordinator__needs_a_limit_and_a_district() -> None:
    with pytest.raises(ControllerMismatch, match="reward is of the kind district"):
        DistrictCoordinator(manifest(sensors=[sensor("a")]))
    with pytest.raises(ControllerMismatch, match="limit_kw="):
        DistrictCoordinator(district(limits=[]))
    with pytest.raises(InvalidConfig, match=r"margin = 2; expected a number from 0.01 to 1"):
        DistrictCoordinator(district(), margin=2)
