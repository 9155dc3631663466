"""A district heating plant against the solutions of its equations."""

from math import exp
from typing import Any

import pytest

from zenostat.plants.heat import DistrictHeating
from zenostat.testing import check_plant
from zenostat.topics.errors import InvalidConfig

WATER = 4186.0
COMMANDS = {"setpoint": 70.0, "outdoor_temperature": 0.0, "north_demand": 30e3, "south_demand": 20e3}
IDLE = {**COMMANDS, "setpoint": 40.0, "north_demand": 0.0, "south_demand": 0.0}


def test_district_heating__tank_without_demand_cools_exponentially() -> None:
    plant = DistrictHeating(tank_m3=2.0, tank_loss_w_k=50.0, ambient_c=10.0, initial_c=80.0)
    plant.reset(0)
    time_constant_s = 2.0 * 1000.0 * WATER / 50.0
    for step in range(1, 101):
        values = plant.step(IDLE)
        assert values["tank_temperature"] == pytest.approx(
            10.0 + 70.0 * exp(-300.0 * step / time_constant_s), rel=1e-12
        )
        assert (values["flow"], values["source_heat"], values["pipe_loss"]) == (0.0, 0.0, 0.0)


def test_district_heating__steady_state_is_the_balance_of_source_demand_and_losses() -> None:
    plant = DistrictHeating()
    plant.reset(0)
    for _ in range(500):
        values = plant.step(COMMANDS)
    assert values["tank_temperature"] == pytest.approx(70.0, abs=1e-9)
    flow, loss = values["flow"] * WATER, 500.0 * 0.25
    supply = 10.0 + (70.0 - 10.0) * exp(-loss / flow)
    assert values["supply_temperature"] == pytest.approx(supply, abs=1e-9)
    assert values["return_temperature"] == pytest.approx(10.0 + (40.0 - 10.0) * exp(-loss / flow), abs=1e-9)
    assert flow * (supply - 40.0) == pytest.approx(50e3, rel=1e-6)
    assert values["source_heat"] == pytest.approx(50e3 + values["pipe_loss"] + 20.0 * (70.0 - 15.0), rel=1e-6)
    assert values["efficiency"] == pytest.approx(0.5 * 343.15 / 70.0)
    assert values["electricity"] == pytest.approx(values["source_heat"] / values["efficiency"] * 300.0)


@pytest.mark.parametrize("demand_w", [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1.0])
@pytest.mark.parametrize("tank_loss_w_k", [0.0, 1e-13, 1e-9, 1e-3])
def test_district_heating__smallest_flows_and_losses_are_exact(demand_w: float, tank_loss_w_k: float) -> None:
    """A tank that has its setpoint keeps it, also where a conductance is next to none: the source covers the rest."""
    plant = DistrictHeating(pipe_m=0.0, tank_loss_w_k=tank_loss_w_k, consumers={"a": 0.0})
    plant.reset(0)
    values = plant.step({"setpoint": 70.0, "outdoor_temperature": 0.0, "a_demand": demand_w})
    assert values["supply_temperature"] == pytest.approx(70.0 if demand_w else 10.0, abs=1e-9)
    assert values["tank_temperature"] == pytest.approx(70.0, abs=1e-12)
    assert values["efficiency"] == pytest.approx(0.5 * 343.15 / 70.0, rel=1e-12)
    assert values["a_heat"] == pytest.approx(demand_w, rel=1e-9)
    assert values["source_heat"] == pytest.approx(demand_w + tank_loss_w_k * 55.0, rel=1e-9)


@pytest.mark.parametrize("source", ["boiler", "heat_pump"])
def test_district_heating__energy_balances_in_each_timestep(source: str) -> None:
    plant = DistrictHeating(source=source, power_w=60e3, efficiency=0.5)
    before = plant.reset(0)["tank_temperature"]
    for step in range(200):
        commands = {**COMMANDS, "setpoint": 45.0 + step % 40, "north_demand": 1e3 * (step % 50)}
        values = plant.step(commands)
        stored = 10.0 * 1000.0 * WATER * (values["tank_temperature"] - before) / 300.0
        used = values["north_heat"] + values["south_heat"] + values["tank_loss"] + values["pipe_loss"]
        assert values["source_heat"] == pytest.approx(stored + used, abs=1e-5)
        assert 0.0 <= values["source_heat"] <= 60e3
        before = values["tank_temperature"]


def test_district_heating__cold_tank_delivers_nothing_and_states_what_is_unmet() -> None:
    plant = DistrictHeating(initial_c=35.0, power_w=1e3)
    plant.reset(0)
    values = plant.step(COMMANDS)
    assert (values["north_heat"], values["north_unmet"], values["flow"]) == (0.0, 30e3, 0.0)


def test_district_heating__flow_is_limited() -> None:
    plant = DistrictHeating(flow_kg_s=0.1)
    plant.reset(0)
    values = plant.step(COMMANDS)
    assert values["flow"] == pytest.approx(0.2)
    assert values["north_unmet"] > 15e3


@pytest.mark.parametrize("demand", [1.0, 100.0, 3e3, 5.3e3, 5.5e3, 6.5e3, 20e3, 50e3, 90e3])
@pytest.mark.parametrize("ground_c", [0.0, 10.0, 55.0, 75.0])
@pytest.mark.parametrize("pipe_m", [0.0, 500.0, 5000.0])
def test_district_heating__demand_is_delivered_while_the_flow_suffices(
    demand: float, ground_c: float, pipe_m: float
) -> None:
    plant = DistrictHeating(
        consumers={"a": 0.6 * demand, "b": 0.4 * demand, "c": 0.0}, ground_c=ground_c, pipe_m=pipe_m, power_w=1e6,
        tank_m3=1e6, flow_kg_s=10.0,
    )  # fmt: skip
    plant.reset(0)
    values = plant.step({name: actuator[3] for name, actuator in plant.actuators.items()})
    assert (values["a_heat"], values["b_heat"], values["c_heat"]) == (
        pytest.approx(0.6 * demand, rel=1e-3), pytest.approx(0.4 * demand, rel=1e-3), 0.0
    )  # fmt: skip
    used = values["a_heat"] + values["b_heat"] + values["tank_loss"] + values["pipe_loss"]
    assert values["source_heat"] - values["tank_charge"] == pytest.approx(used, abs=1e-4)


def test_district_heating__limit_of_a_substation_leaves_the_demand_of_the_next_one_met() -> None:
    plant = DistrictHeating(flow_kg_s=0.1, tank_m3=1e6, power_w=1e6)
    plant.reset(0)
    values = plant.step({**COMMANDS, "south_demand": 2e3})
    assert values["flow"] == pytest.approx(0.1 + 2e3 / WATER / (values["supply_temperature"] - 40.0))
    assert values["south_heat"] == pytest.approx(2e3, rel=1e-3)
    assert values["north_heat"] == pytest.approx(0.1 * WATER * (values["supply_temperature"] - 40.0))


def test_district_heating__supply_that_arrives_colder_than_the_return_delivers_nothing() -> None:
    plant = DistrictHeating(pipe_m=50e3, flow_kg_s=0.1)
    plant.reset(0)
    values = plant.step(COMMANDS)
    assert (values["north_heat"], values["south_unmet"], values["flow"]) == (0.0, 20e3, 0.0)


def test_district_heating__passes_the_check_of_plants() -> None:
    check_plant("zenostat.plants.heat.district_heating:DistrictHeating", {"duration_s": 3000.0})


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"source": "oven"}, "source = 'oven': boiler or heat_pump expected"),
        ({"tank_m3": 0.0}, "tank_m3 = 0.0: a number above 0 expected"),
        ({"pipe_m": -1.0}, "pipe_m = -1.0: a number of at least 0 expected"),
        ({"consumers": {"a": "much"}}, "a number of at least 0 expected"),
        ({"consumers": {"a b": 1.0}}, "a consumer's name 'a b' is not valid"),
        ({"consumers": [1]}, r"consumers = \[1\]: demands by name expected"),
        ({"consumers": {"source": 1.0}}, "consumers = {'source': 1.0}: .* none is 'source'"),
        ({"return_c": 95.0}, "return_c = 95.0: a number below 95 expected"),
    ],
)
def test_district_heating__wrong_argument_is_named(arguments: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        DistrictHeating(**arguments)
