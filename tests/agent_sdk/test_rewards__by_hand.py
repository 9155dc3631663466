"""Rewards of each kind, against numbers worked out by hand."""

import math
from datetime import datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from support.builders import manifest, meter, sensor
from support.rewards import KWH, MINIMAL_FIELDS, NODE, PERIODS, SENSORS, SUMMER, WINTER, node_of, reward_config, values

from zenostat.agent_sdk.rewards import (
    CarbonReward,
    EnergyCostReward,
    ExponentialReward,
    HourlyReward,
    MultiZoneReward,
    NormalizedReward,
    OccupiedReward,
    PeakReward,
    TariffReward,
    read_reward,
)
from zenostat.topics.errors import InvalidConfig


def test_rewards__exponential() -> None:
    bound = ExponentialReward().bind(NODE)
    assert bound(values(north=20.0, south=23.5), WINTER).reward == 0.0  # the ends belong to the band
    got = bound(values(north=18.0, south=24.5, power=2000.0), WINTER)
    assert got.terms == pytest.approx({"energy": -0.1, "comfort": -0.5 * (math.exp(2.0) + math.exp(1.0))})
    assert got.metrics == pytest.approx({"power_w": 2000.0, "degrees_outside": 3.0})
    just_outside = bound(values(north=20.0 - 1e-9), WINTER).terms["comfort"]
    assert just_outside == pytest.approx(-0.5)
    assert bound(values(north=1e6), WINTER).reward == pytest.approx(-0.5 * math.exp(100.0))


@pytest.mark.parametrize(
    ("hours", "hour", "inside"),
    [((9, 20), 8, False), ((9, 20), 9, True), ((9, 20), 19, True), ((9, 20), 20, False), ((22, 6), 23, True),
     ((22, 6), 5, True), ((22, 6), 6, False), ((22, 6), 12, False)],
)  # fmt: skip
def test_rewards__hourly(hours: tuple[int, int], hour: int, inside: bool) -> None:
    sample, begin = values(north=18.0, power=1000.0), WINTER.replace(hour=hour, minute=45)
    got = HourlyReward(weight=0.4, hours=hours).bind(NODE)(sample, begin)
    expected = {"energy": -0.04, "comfort": -1.2} if inside else {"energy": -0.1, "comfort": 0.0}
    assert got.terms == pytest.approx(expected)
    half = HourlyReward(weight=0.4, weight_outside=0.5, hours=hours).bind(NODE)(sample, begin)
    assert half.terms["comfort"] == pytest.approx(-1.2 if inside else -1.0)


def test_rewards__each_slot_has_its_own_hour() -> None:
    rows, begins = np.array([values(power=1000.0)] * 2), [WINTER, WINTER.replace(hour=3)]
    assert HourlyReward(weight=0.4).bind(NODE)(rows, begins).terms["energy"] == pytest.approx([-0.04, -0.1])
    costs = reward_config("tariff").bind(NODE)(np.array([values(electricity=KWH)] * 2), begins).metrics["cost"]
    assert costs == pytest.approx([0.3, 0.1])
    peaks = PeakReward().bind(NODE)
    peaks(np.array([values(electricity=KWH)] * 2), begins)
    later = peaks(np.array([values(electricity=KWH)] * 2), [WINTER, SUMMER]).terms["peak"]
    assert later == pytest.approx([0.0, -4.0])


def test_rewards__normalised_by_what_was_seen() -> None:
    bound = NormalizedReward(weight=0.25).bind(NODE)
    nothing = bound(values(), WINTER)
    assert (nothing.reward, nothing.metrics["max_power_w"]) == (0.0, 0.0)  # 0 of 0 is 0
    assert bound(values(power=4000.0, north=18.0), WINTER).terms == pytest.approx({"energy": -0.25, "comfort": -0.75})
    got = bound(values(power=1000.0, north=19.5), WINTER)
    assert got.terms == pytest.approx({"energy": -0.25 / 4, "comfort": -0.75 / 4})
    assert got.metrics == pytest.approx(
        {"power_w": 1000.0, "degrees_outside": 0.5, "max_power_w": 4000.0, "max_degrees": 2.0}
    )


def test_normalized_reward__uses_given_limits() -> None:
    sample = values(power=4000.0, north=14.0)
    fixed = NormalizedReward(max_power_w=2000.0, max_degrees=12.0, moving=False).bind(NODE)
    for _ in range(2):
        assert fixed(sample, WINTER).terms == pytest.approx({"energy": -1.0, "comfort": -0.25})
    growing = NormalizedReward(max_power_w=2000.0, max_degrees=12.0).bind(NODE)
    assert growing(sample, WINTER).terms == pytest.approx({"energy": -0.5, "comfort": -0.25})
    with pytest.raises(ValidationError, match="max_power_w and max_degrees"):
        NormalizedReward(moving=False, max_power_w=1.0)


def test_rewards__maxima_stay_unless_they_are_to_be_forgotten() -> None:
    for forget, share in ((False, -0.25), (True, -0.5)):
        bound = NormalizedReward(forget=forget).bind(NODE)
        bound(values(power=2000.0), WINTER)
        bound.reset()
        assert bound(values(power=1000.0), WINTER).terms["energy"] == pytest.approx(share)


def test_rewards__multi_zone_by_the_thermostats_with_the_zones_keys() -> None:
    bound = MultiZoneReward().bind(NODE)
    assert bound(values(north=20.5, south=25.5), WINTER).reward == 0.0
    got = bound(values(north=19.5, south=26.5, power=1000.0), SUMMER)  # 20.5 and 25.5 are the ends
    assert got.metrics["degrees_outside"] == pytest.approx(1.0 + 1.0)
    assert got.terms == pytest.approx({"energy": -0.05, "comfort": -1.0})


def test_rewards__multi_zone_by_names() -> None:
    one = MultiZoneReward(zones={"north": "south_heating"}, threshold=1.0).bind(NODE)  # 19 to 21
    assert one(values(north=22.5), WINTER).metrics["degrees_outside"] == pytest.approx(1.5)
    assert one(values(north=18.0, south=0.0), WINTER).metrics["degrees_outside"] == pytest.approx(1.0)
    two = MultiZoneReward(zones={"north": ("north_heating", "south_cooling")}, threshold=0.0).bind(NODE)
    assert two(values(north=22.5), WINTER).reward == 0.0
    assert two(values(north=0.0), WINTER).metrics["degrees_outside"] == pytest.approx(21.0)


def test_rewards__multi_zone_without_a_limit_where_the_thermostat_does_not_use_a_setpoint() -> None:
    bound = MultiZoneReward().bind(NODE)
    heated = values(north=15.72, north_heating=21.0, north_cooling=0.0, south_heating=0.0)
    assert bound(heated, WINTER).metrics["degrees_outside"] == pytest.approx(21.0 - 0.5 - 15.72)
    for air, outside in [(40.0, 0.0), (10.0, 10.5)]:
        got = bound(values(north=air, north_cooling=0.0), WINTER).metrics["degrees_outside"]
        assert got == pytest.approx(outside)
    rows = np.stack([heated, values(north=26.0, north_heating=0.0, north_cooling=24.0)])
    np.testing.assert_allclose(bound(rows, WINTER).metrics["degrees_outside"], [4.78, 1.5])


@pytest.mark.parametrize(
    ("limits", "air", "outside"),
    [
        (["north_heating", None], 40.0, 0.0),
        (["north_heating", None], 18.0, 3.0),
        ([None, "north_cooling"], 18.0, 0.0),
        ([None, "north_cooling"], 27.0, 3.0),
    ],
)
def test_rewards__multi_zone_with_a_limit_on_one_side(limits: list[str | None], air: float, outside: float) -> None:
    reward = read_reward({"kind": "multi_zone", "zones": {"north": limits}, "threshold": 0.0})
    assert isinstance(reward, MultiZoneReward)
    assert read_reward(reward.model_dump(mode="json")) == reward
    assert reward.bind(NODE)(values(north=air), WINTER).metrics["degrees_outside"] == pytest.approx(outside)


@pytest.mark.parametrize("limits", [[None], [None, None], [], ["north_heating", None, None]])
def test_rewards__multi_zone_needs_a_limit(limits: list[str | None]) -> None:
    with pytest.raises(InvalidConfig, match=r"\[heating, cooling\] expected"):
        read_reward({"kind": "multi_zone", "zones": {"north": limits}})


def test_rewards__multi_zone_has_zero_as_a_limit_of_other_sensors() -> None:
    """Only thermostats report 0 for what they do not use; 0 degC is a setpoint of a schedule."""
    node = manifest(sensors=[sensor("room", "Zone Air Temperature"), sensor("limit", "Schedule Value")])
    bound = MultiZoneReward(zones={"room": (None, "limit")}, threshold=0.0, power=()).bind(node)
    assert bound(np.array([2.0, 0.0]), WINTER).metrics["degrees_outside"] == 2.0


PRICE = {"table": PERIODS, "otherwise": 100.0, "unit": "EUR/MWh"}


@pytest.mark.parametrize(("hour", "price"), [(7, 0.1), (8, 0.3), (19, 0.3), (20, 0.1)])
def test_rewards__energy_cost(hour: int, price: float) -> None:
    bound = EnergyCostReward.model_validate({"price": PRICE, "lambda_cost": 2.0}).bind(NODE)
    got = bound(values(electricity=5 * KWH, north=18.0, power=1e9), WINTER.replace(hour=hour))
    assert got.metrics == pytest.approx(
        {"power_w": 20_000.0, "degrees_outside": 2.0, "energy_kwh": 5.0, "cost": 5.0 * price}
    )
    assert got.terms == pytest.approx({"energy": -0.8, "comfort": -0.8, "cost": -0.2 * 2.0 * 5.0 * price})


def test_rewards__price_below_zero_is_an_income() -> None:
    reward = EnergyCostReward.model_validate(
        {"price": {"value": -0.5, "unit": "EUR/kWh"}, "weight": 0.0, "weight_temperature": 0.0}
    )
    assert reward.bind(NODE)(values(electricity=KWH), WINTER).reward == pytest.approx(0.5)


def test_rewards__weights_of_energy_cost_fit() -> None:
    with pytest.raises(InvalidConfig, match="above 1"):
        reward_config("energy_cost", weight=0.7, weight_temperature=0.4)
    bound = reward_config("energy_cost", weight=0.7, weight_temperature=0.3).bind(NODE)
    assert bound(values(electricity=KWH), WINTER).terms["cost"] == pytest.approx(0.0, abs=1e-12)


def test_rewards__tariff() -> None:
    bound = TariffReward.model_validate({**MINIMAL_FIELDS["tariff"], "weight": 0.25, "lambda_cost": 2.0}).bind(NODE)
    monday = bound(values(electricity=10 * KWH, north=18.0), WINTER)
    assert monday.terms == pytest.approx({"cost": -0.25 * 2.0 * 3.0, "comfort": -1.5})
    assert monday.metrics == pytest.approx({"degrees_outside": 2.0, "energy_kwh": 10.0, "cost": 3.0})
    sunday = bound(values(electricity=10 * KWH), WINTER - timedelta(days=1))
    assert sunday.metrics["cost"] == pytest.approx(1.0)


def test_rewards__carbon() -> None:
    bound = reward_config("carbon", weight=0.25, lambda_carbon=2.0).bind(NODE)  # the intensity of hour k is k g/kWh
    got = bound(values(electricity=10 * KWH, north=18.0), datetime(2017, 1, 11, 10, 30))
    assert got.metrics == pytest.approx({"degrees_outside": 2.0, "energy_kwh": 10.0, "co2_kg": 2.5})
    assert got.terms == pytest.approx({"carbon": -0.25 * 2.0 * 2.5, "comfort": -1.5})
    heavy = CarbonReward.model_validate({"intensity": {"value": 0.4, "unit": "t/MWh"}}).bind(NODE)
    assert heavy(values(electricity=KWH), WINTER).metrics["co2_kg"] == pytest.approx(0.4)


def test_rewards__peak() -> None:
    """Kilowatts of quarters of an hour, from the threshold of 10 on; the new month begins anew."""
    bound = PeakReward(threshold_kw=10.0, lambda_peak=3.0, weight=0.5).bind(NODE)
    begin = datetime(2017, 1, 31, 23)
    schedule = [(8.0, 0, 10), (12.0, 2, 12), (11.0, 0, 12), (15.0, 3, 15), (11.0, 1, 11), (9.0, 0, 11), (20.0, 9, 20)]
    for k, (kw, added, peak) in enumerate(schedule):
        got = bound(values(electricity=kw / 4 * KWH), begin + timedelta(minutes=15 * k))
        assert got.terms == pytest.approx({"energy": -0.05 * kw, "comfort": 0.0, "peak": -3.0 * added})
        assert got.metrics["peak_kw"] == pytest.approx(peak)
    bound.reset()
    assert bound(values(electricity=2.75 * KWH), begin).terms["peak"] == pytest.approx(-3.0)
    same_month_next_year = bound(values(electricity=2.75 * KWH), begin.replace(year=2018))
    assert same_month_next_year.terms["peak"] == pytest.approx(-3.0)


def test_rewards__occupied_cost() -> None:
    """Wednesday 11 January: quarters of an hour with 2.5 kWh (10 kW) and 4 kWh (16 kW), 8 kWh of gas, three people."""
    bound = read_reward(
        {
            "kind": "occupied_cost", "weight": 0.25, "gas_price": {"value": 60.0, "unit": "EUR/MWh"}, "by": "people",
            "price": {"table": PERIODS, "otherwise": 100.0, "unit": "EUR/MWh"}, "lambda_cost": 2.0, "lambda_peak": 3.0,
            "threshold_kw": 9.0, "lambda_temperature": 0.5,
        }
    ).bind(NODE)  # fmt: skip
    sample = values(electricity=2.5 * KWH, gas=8.0 * KWH, north=18.0, south=10.0, north_people=3.0)
    first = bound(sample, datetime(2017, 1, 11, 10, 30))
    assert first.terms == pytest.approx(
        {
            "cost": -0.25 * 2.0 * (2.5 * 0.3),
            "gas": -0.25 * 2.0 * (8.0 * 0.06),
            "peak": -0.25 * 3.0 * (10.0 - 9.0),
            "comfort": -0.75 * 0.5 * 0.25 * (3 * 2.0),  # a quarter of an hour; nobody is in the south
        }
    )
    assert first.reward == pytest.approx(sum(first.terms.values()))
    assert first.metrics == pytest.approx(
        {
            "energy_kwh": 2.5, "cost": 0.75, "gas_kwh": 8.0, "gas_cost": 0.48, "demand_kwh": 2.5, "peak_kw": 10.0,
            "degrees_outside": 6.0, "people": 3.0,
        }
    )  # fmt: skip
    night = bound(values(electricity=4.0 * KWH), datetime(2017, 1, 11, 22))
    assert night.terms == pytest.approx(
        {"cost": -0.25 * 2.0 * 0.4, "gas": 0.0, "peak": -0.25 * 3.0 * 6.0, "comfort": 0.0}
    )
    assert bound(sample, datetime(2017, 1, 12)).terms["peak"] == 0.0  # below the month's peak


def test_rewards__occupied_cost_in_two_currencies_is_refused() -> None:
    prices = {"price": {"value": 30.0, "unit": "ct/kWh"}, "gas_price": {"value": 0.06, "unit": "EUR/kWh"}}
    with pytest.raises(InvalidConfig, match="price and gas_price are in EUR and ct; one currency expected"):
        read_reward({"kind": "occupied_cost", **prices})


def test_rewards__occupied_cost_charges_the_peak_of_another_meter() -> None:
    """The bill is on electricity, the peak on 20 kW of a power sensor; without a price gas is not counted."""
    reward = {"kind": "occupied_cost", "price": {"value": 0.2, "unit": "EUR/kWh"}, "demand": "power"}
    got = read_reward(reward).bind(NODE)(values(electricity=KWH, gas=KWH, power=2e4), WINTER)
    assert got.terms == pytest.approx({"cost": -0.5 * 0.2, "peak": -0.5 * 20.0, "comfort": 0.0})
    with pytest.raises(InvalidConfig, match=r"name the meter 'NaturalGas:Facility' in meters=.*`gas`"):
        read_reward({**reward, "gas_price": reward["price"]}).bind(node_of(*SENSORS, meters=[meter("electricity")]))


@given(st.lists(st.floats(0.0, 1e3), min_size=1, max_size=20), st.floats(0.0, 500.0))
def test_rewards__month_of_peaks_is_a_demand_charge(kilowatts: list[float], threshold_kw: float) -> None:
    bound = PeakReward(threshold_kw=threshold_kw).bind(NODE)
    begin = datetime(2017, 7, 1)
    terms = [bound(values(electricity=kw / 4 * KWH), begin).terms["peak"] for kw in kilowatts]
    assert sum(terms) == pytest.approx(-max(max(kilowatts) - threshold_kw, 0.0), abs=1e-6)


@pytest.mark.parametrize(
    ("more", "people", "degrees_outside"),
    [
        ({}, (0.0, 0.0), 0.0),
        ({}, (3.0, 0.0), 2.0),
        ({}, (0.0, 0.5), 1.0),
        ({}, (3.0, 2.0), 3.0),
        ({"by": "people"}, (3.0, 2.0), 3.0 * 2.0 + 2.0 * 1.0),
        ({"by": "people"}, (0.0, 2.0), 2.0),
        ({"empty_weight": 0.1}, (3.0, 0.0), 2.0 + 0.1),
        ({"by": "people", "empty_weight": 0.1}, (0.0, 2.0), 0.2 + 2.0),
        ({"occupants": {"north": "south_people", "south": "south_people"}}, (3.0, 0.0), 0.0),
        ({"temperatures": ("south",)}, (3.0, 2.0), 1.0),
    ],
)
def test_rewards__occupied(more: dict[str, Any], people: tuple[float, float], degrees_outside: float) -> None:
    sample = values(north=18.0, south=24.5, power=1000.0, north_people=people[0], south_people=people[1])
    got = OccupiedReward(**more).bind(NODE)(sample, WINTER)
    assert got.metrics["degrees_outside"] == pytest.approx(degrees_outside)
    assert got.terms == pytest.approx({"energy": -0.05, "comfort": -0.5 * degrees_outside})


def test_rewards__zones_without_people_are_left_out_unless_they_are_named() -> None:
    node = node_of(*SENSORS[:6])  # the people of the south are not measured
    got = OccupiedReward().bind(node)(values(node, north=19.0, south=0.0, north_people=2.0), WINTER)
    assert got.metrics == pytest.approx({"power_w": 0.0, "degrees_outside": 1.0, "people": 2.0})
    with pytest.raises(InvalidConfig, match=r"at 'south': .*\('Zone People Occupant Count', 'South'\)"):
        OccupiedReward(temperatures=("north", "south")).bind(node)
