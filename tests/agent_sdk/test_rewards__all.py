"""All kinds of reward: by hand, in all shapes, the sum of their terms, what they remember, seasons, files, mistakes."""

from __future__ import annotations

import importlib.util
import json
import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError
from support.builders import manifest, meter, sensor
from support.examples import examples

from zenostat import rewards
from zenostat.agent_sdk.rewards import (
    REWARDS,
    BoundReward,
    CarbonReward,
    EnergyCostReward,
    ExponentialReward,
    HourlyReward,
    LinearReward,
    MultiZoneReward,
    NormalizedReward,
    OccupiedReward,
    Outcome,
    PeakReward,
    RewardConfig,
    TariffReward,
    ThermalSensationReward,
    from_function,
    read_reward,
)
from zenostat.agent_sdk.rewards.thermal_sensation import percentage_dissatisfied
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.messages import Aggregation, Manifest, Meter, Sensor

Array = np.ndarray[Any, np.dtype[np.float64]]
WINTER, SUMMER = datetime(2017, 1, 16, 12), datetime(2017, 7, 17, 12)  # Mondays
POWER, PEOPLE = "Facility Total HVAC Electricity Demand Rate", "Zone People Occupant Count"
HEATING = "Zone Thermostat Heating Setpoint Temperature"
COOLING = "Zone Thermostat Cooling Setpoint Temperature"
PMV, PPD = "Zone Thermal Comfort Fanger Model PMV", "Zone Thermal Comfort Fanger Model PPD"

SENSORS = (
    sensor("outdoor", "Site Outdoor Air Drybulb Temperature"),
    sensor("north", "Zone Air Temperature", "North"),
    sensor("south", "Zone Air Temperature", "South"),
    sensor("power", POWER, "Whole Building", "W"),
    sensor("fans", "Fan Electricity Rate", "Fan", "W"),
    sensor("north_people", PEOPLE, "North", "1"),
    sensor("south_people", PEOPLE, "SOUTH", "1"),
    sensor("north_heating", HEATING, "North"),
    sensor("north_cooling", COOLING, "North"),
    sensor("south_heating", HEATING, "South"),
    sensor("south_cooling", COOLING, "South"),
    sensor("north_radiant", "Zone Mean Radiant Temperature", "North"),
    sensor("south_radiant", "Zone Mean Radiant Temperature", "South"),
    sensor("north_humidity", "Zone Air Relative Humidity", "North", "percent"),
    sensor("south_humidity", "Zone Air Relative Humidity", "South", "percent"),
)
NODE = manifest(sensors=SENSORS, meters=[meter("gas", "NaturalGas:Facility"), meter("electricity")])
NODE_SOUTH = NODE.model_copy(update={"latitude_deg": -33.9})
USUAL = {
    "outdoor": -40.0, "north": 22.0, "south": 22.0, "power": 0.0, "fans": 0.0, "north_people": 0.0,
    "south_people": 0.0, "north_heating": 21.0, "north_cooling": 24.0, "south_heating": 20.0, "south_cooling": 25.0,
    "north_radiant": 22.0, "south_radiant": 22.0, "north_humidity": 60.0, "south_humidity": 60.0, "gas": 0.0,
    "electricity": 0.0,
}  # fmt: skip
KWH = 3.6e6


def values(node: Manifest = NODE, **named: float) -> Array:
    """A sample; what is not said is comfortable and uses nothing."""
    return np.array([(USUAL | named)[name] for name in node.names])


def node_of(*sensors: Sensor, meters: Sequence[Meter] = ()) -> Manifest:
    return manifest(sensors=sensors, meters=meters)


PERIODS = ({"value": 300.0, "hours": (8, 20), "weekdays": ("mon", "tue", "wed", "thu", "fri")},)
MINIMAL_FIELDS: dict[str, dict[str, Any]] = {
    "linear": {},
    "exponential": {},
    "hourly": {"weight_outside": 0.75},
    "normalized": {},
    "multi_zone": {},
    "energy_cost": {"price": {"table": PERIODS, "otherwise": 100.0, "unit": "EUR/MWh"}},
    "tariff": {"periods": PERIODS, "otherwise": 100.0, "unit": "EUR/MWh"},
    "carbon": {"intensity": {"hourly": [float(h) for h in range(8760)], "unit": "g/kWh"}},
    "peak": {"threshold_kw": 10.0},
    "occupied": {},
    "occupied_cost": {"price": {"table": PERIODS, "otherwise": 100.0, "unit": "EUR/MWh"}},
    "thermal_sensation": {},
}
"""What each kind needs."""


def reward_config(kind: str, **more: Any) -> RewardConfig:
    config = read_reward({"kind": kind, **MINIMAL_FIELDS[kind], **more})
    assert isinstance(config, RewardConfig)
    return config


def test_each_kind_is_here() -> None:
    assert set(MINIMAL_FIELDS) == set(REWARDS)
    assert all(REWARDS[kind].model_fields["kind"].default == kind for kind in REWARDS)


# What holds for all of them

degrees, watts = st.floats(-20.0, 50.0), st.floats(0.0, 1e6)
ROW = {
    "degC": degrees, "W": watts, "1": st.sampled_from([0.0, 0.0, 1.0, 2.5]), "percent": st.floats(0.0, 100.0),
    "J": st.floats(0.0, 1e9),
}  # fmt: skip
UNITS = [p.unit for p in (*NODE.sensors, *NODE.meters)]
samples = st.tuples(*(ROW[unit] for unit in UNITS)).map(np.array)
moments = st.datetimes(datetime(2016, 1, 1), datetime(2017, 12, 31)).map(lambda m: m.replace(minute=0, second=0))
HAVE_LIBRARY = importlib.util.find_spec("pythermalcomfort") is not None
KINDS = sorted(kind for kind in MINIMAL_FIELDS if kind != "thermal_sensation" or HAVE_LIBRARY)
"""Those that can be bound to `NODE`, which has no votes of EnergyPlus's own."""
kinds = st.sampled_from(KINDS)


@pytest.mark.slow
@settings(max_examples=examples(200), deadline=None)
@given(kinds, st.lists(st.tuples(samples, moments), min_size=1, max_size=4), st.floats(0.0, 0.5))
def test_the_reward_is_the_sum_of_its_terms_and_none_is_positive(
    kind: str, steps: list[tuple[Array, datetime]], weight: float
) -> None:
    bound = reward_config(kind, weight=weight).bind(NODE)
    for sample, begin in steps:
        got = bound(sample, begin)
        assert got.reward == sum(got.terms.values())
        assert all(term <= 0.0 for term in got.terms.values())
        assert all(np.ndim(number) == 0 and math.isfinite(number) for number in (*got.terms.values(), got.reward))
        assert all(np.ndim(number) == 0 for number in got.metrics.values())


@pytest.mark.slow
@settings(max_examples=examples(100), deadline=None)
@given(kinds, st.lists(st.tuples(samples, moments), min_size=1, max_size=4))
def test_slots_are_what_each_of_them_is_alone(kind: str, slots: list[tuple[Array, datetime]]) -> None:
    """Two timesteps, the second with the samples in reverse: what is remembered is each slot's own."""
    reward = reward_config(kind)
    together, alone = reward.bind(NODE), [reward.bind(NODE) for _ in slots]
    begins = [begin for _, begin in slots]
    for rows in ([row for row, _ in slots], [row for row, _ in reversed(slots)]):
        got = together(np.array(rows), begins)
        assert got.reward.shape == (len(slots),)
        singles = [bound(row, begin) for bound, row, begin in zip(alone, rows, begins, strict=True)]
        assert got.reward == pytest.approx([single.reward for single in singles])
        for name, of in (("terms", got.terms), ("metrics", got.metrics)):
            assert set(of) == set(getattr(singles[0], name))
            for key, column in of.items():
                assert column.shape == (len(slots),)
                assert column == pytest.approx([getattr(single, name)[key] for single in singles])


@settings(max_examples=examples(60), deadline=None)
@given(kinds, moments, arrays(np.float64, (2, 3, len(UNITS)), elements=st.floats(0.0, 50.0)))
def test_one_begin_does_for_any_leading_shape(kind: str, begin: datetime, batch: Array) -> None:
    got = reward_config(kind).bind(NODE)(batch, begin)
    assert got.reward.shape == (2, 3)
    assert all(term.shape == (2, 3) for term in (*got.terms.values(), *got.metrics.values()))
    assert got.reward[1, 2] == pytest.approx(reward_config(kind).bind(NODE)(batch[1, 2], begin).reward)


@settings(max_examples=examples(60), deadline=None)
@given(kinds, st.lists(st.tuples(samples, moments), min_size=2, max_size=6), st.data())
def test_a_reward_goes_on_from_its_state(kind: str, steps: list[tuple[Array, datetime]], data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(steps) - 1))
    straight, first, second = (reward_config(kind).bind(NODE) for _ in range(3))
    for step in steps[:cut]:
        straight(*step)
        first(*step)
    second.restore(json.loads(json.dumps(first.state())))
    for step in steps[cut:]:
        assert second(*step).reward == straight(*step).reward
    assert second.state() == straight.state()


@pytest.mark.parametrize("kind", KINDS)
def test_a_reward_leaves_the_values_alone(kind: str) -> None:
    sample = values(north=30.0, power=1e4, electricity=1e7)
    sample.flags.writeable = False
    before = sample.copy()
    reward_config(kind).bind(NODE)(sample, SUMMER)
    assert sample.tolist() == before.tolist()


# Written out and read back

weights = st.floats(0.0, 0.5)
optional: dict[str, dict[str, st.SearchStrategy[Any]]] = {
    kind: {"weight": weights} | ({} if kind == "multi_zone" else {"summer_begin": st.just((11, 1))})
    for kind in MINIMAL_FIELDS
}
for kind, more in {
    "linear": {"winter": st.just((18.0, 22.0)), "power": st.sampled_from(["power", ("power", "fans")])},
    "exponential": {"temperatures": st.just(("north",)), "lambda_energy": st.floats(0, 1)},
    "hourly": {"hours": st.sampled_from([(7, 8), (22, 6), (0, 24)]), "weight_outside": weights},
    "normalized": {"max_power_w": st.floats(1, 1e6), "forget": st.booleans()},
    "multi_zone": {"zones": st.sampled_from([{"north": "n"}, {"north": ("h", "c")}]), "threshold": st.floats(0, 3)},
    "energy_cost": {"weight_temperature": weights, "lambda_cost": st.floats(0, 9)},
    "tariff": {"energy": st.sampled_from(["electricity", ["a", "b"]]), "otherwise": st.floats(-1, 1)},
    "carbon": {"intensity": st.builds(lambda g: {"value": g, "unit": "kg/MWh"}, st.floats(0, 999))},
    "peak": {"threshold_kw": st.floats(0, 1e3), "lambda_peak": st.floats(0, 9)},
    "occupied": {"by": st.sampled_from(["presence", "people"]), "occupants": st.just({"north": "n"})},
    "occupied_cost": {"demand": st.just("power"), "gas_price": st.just({"value": 50.0, "unit": "EUR/MWh"})},
    "thermal_sensation": {"by": st.sampled_from(["pmv", "ppd"]), "met": st.floats(0.8, 4), "pmv": st.just("p")},
}.items():
    optional[kind] |= more
described = st.sampled_from(sorted(MINIMAL_FIELDS)).flatmap(
    lambda kind: st.fixed_dictionaries({"kind": st.just(kind)}, optional=optional[kind]).map(
        lambda fields: MINIMAL_FIELDS[fields["kind"]] | fields
    )
)


@settings(max_examples=examples(200), deadline=None)
@given(described)
def test_a_reward_that_was_written_is_read_back(fields: dict[str, Any]) -> None:
    reward = read_reward(fields)
    assert isinstance(reward, RewardConfig)
    plain = reward.model_dump(mode="json", exclude_defaults=True)
    assert plain["kind"] == fields["kind"]
    assert read_reward(plain) == reward
    assert read_reward(yaml12.parse(yaml12.dump(plain), "it")) == reward
    assert read_reward(json.loads(reward.model_dump_json())) == reward


def test_only_what_differs_is_written() -> None:
    plain = LinearReward(weight=0.25, power=("fans",)).model_dump(mode="json", exclude_defaults=True)
    assert list(plain.items()) == [("kind", "linear"), ("weight", 0.25), ("power", ["fans"])]
    assert LinearReward().model_dump(mode="json", exclude_defaults=True) == {"kind": "linear"}


@pytest.mark.parametrize("kind", MINIMAL_FIELDS)
def test_no_reward_takes_what_is_no_number_or_not_known(kind: str) -> None:
    with pytest.raises(InvalidConfig) as raised:
        read_reward({"kind": kind, **MINIMAL_FIELDS[kind], "weight": float("nan"), "wieght": 1})
    assert "weight: " in str(raised.value)
    assert "wieght: " in str(raised.value)


# Each by hand


def test_exponential() -> None:
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
def test_hourly(hours: tuple[int, int], hour: int, inside: bool) -> None:
    sample, begin = values(north=18.0, power=1000.0), WINTER.replace(hour=hour, minute=45)
    got = HourlyReward(weight=0.4, hours=hours).bind(NODE)(sample, begin)
    expected = {"energy": -0.04, "comfort": -1.2} if inside else {"energy": -0.1, "comfort": 0.0}
    assert got.terms == pytest.approx(expected)
    half = HourlyReward(weight=0.4, weight_outside=0.5, hours=hours).bind(NODE)(sample, begin)
    assert half.terms["comfort"] == pytest.approx(-1.2 if inside else -1.0)


def test_each_slot_has_its_own_hour() -> None:
    rows, begins = np.array([values(power=1000.0)] * 2), [WINTER, WINTER.replace(hour=3)]
    assert HourlyReward(weight=0.4).bind(NODE)(rows, begins).terms["energy"] == pytest.approx([-0.04, -0.1])
    costs = reward_config("tariff").bind(NODE)(np.array([values(electricity=KWH)] * 2), begins).metrics["cost"]
    assert costs == pytest.approx([0.3, 0.1])
    peaks = PeakReward().bind(NODE)
    peaks(np.array([values(electricity=KWH)] * 2), begins)
    later = peaks(np.array([values(electricity=KWH)] * 2), [WINTER, SUMMER]).terms["peak"]
    assert later == pytest.approx([0.0, -4.0])


def test_normalised_by_what_was_seen() -> None:
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


def test_the_maxima_stay_unless_they_are_to_be_forgotten() -> None:
    for forget, share in ((False, -0.25), (True, -0.5)):
        bound = NormalizedReward(forget=forget).bind(NODE)
        bound(values(power=2000.0), WINTER)
        bound.reset()
        assert bound(values(power=1000.0), WINTER).terms["energy"] == pytest.approx(share)


def test_multi_zone_by_the_thermostats_with_the_zones_keys() -> None:
    bound = MultiZoneReward().bind(NODE)
    assert bound(values(north=20.5, south=25.5), WINTER).reward == 0.0
    got = bound(values(north=19.5, south=26.5, power=1000.0), SUMMER)  # 20.5 and 25.5 are the ends
    assert got.metrics["degrees_outside"] == pytest.approx(1.0 + 1.0)
    assert got.terms == pytest.approx({"energy": -0.05, "comfort": -1.0})


def test_multi_zone_by_names() -> None:
    one = MultiZoneReward(zones={"north": "south_heating"}, threshold=1.0).bind(NODE)  # 19 to 21
    assert one(values(north=22.5), WINTER).metrics["degrees_outside"] == pytest.approx(1.5)
    assert one(values(north=18.0, south=0.0), WINTER).metrics["degrees_outside"] == pytest.approx(1.0)
    two = MultiZoneReward(zones={"north": ("north_heating", "south_cooling")}, threshold=0.0).bind(NODE)
    assert two(values(north=22.5), WINTER).reward == 0.0
    assert two(values(north=0.0), WINTER).metrics["degrees_outside"] == pytest.approx(21.0)


PRICE = {"table": PERIODS, "otherwise": 100.0, "unit": "EUR/MWh"}


@pytest.mark.parametrize(("hour", "price"), [(7, 0.1), (8, 0.3), (19, 0.3), (20, 0.1)])
def test_energy_cost(hour: int, price: float) -> None:
    bound = EnergyCostReward.model_validate({"price": PRICE, "lambda_cost": 2.0}).bind(NODE)
    got = bound(values(electricity=5 * KWH, north=18.0, power=1e9), WINTER.replace(hour=hour))
    assert got.metrics == pytest.approx(
        {"power_w": 20_000.0, "degrees_outside": 2.0, "energy_kwh": 5.0, "cost": 5.0 * price}
    )
    assert got.terms == pytest.approx({"energy": -0.8, "comfort": -0.8, "cost": -0.2 * 2.0 * 5.0 * price})


def test_a_price_below_zero_is_an_income() -> None:
    reward = EnergyCostReward.model_validate(
        {"price": {"value": -0.5, "unit": "EUR/kWh"}, "weight": 0.0, "weight_temperature": 0.0}
    )
    assert reward.bind(NODE)(values(electricity=KWH), WINTER).reward == pytest.approx(0.5)


def test_the_weights_of_energy_cost_fit() -> None:
    with pytest.raises(InvalidConfig, match="above 1"):
        reward_config("energy_cost", weight=0.7, weight_temperature=0.4)
    bound = reward_config("energy_cost", weight=0.7, weight_temperature=0.3).bind(NODE)
    assert bound(values(electricity=KWH), WINTER).terms["cost"] == pytest.approx(0.0, abs=1e-12)


def test_tariff() -> None:
    bound = TariffReward.model_validate({**MINIMAL_FIELDS["tariff"], "weight": 0.25, "lambda_cost": 2.0}).bind(NODE)
    monday = bound(values(electricity=10 * KWH, north=18.0), WINTER)
    assert monday.terms == pytest.approx({"cost": -0.25 * 2.0 * 3.0, "comfort": -1.5})
    assert monday.metrics == pytest.approx({"degrees_outside": 2.0, "energy_kwh": 10.0, "cost": 3.0})
    sunday = bound(values(electricity=10 * KWH), WINTER - timedelta(days=1))
    assert sunday.metrics["cost"] == pytest.approx(1.0)


def test_carbon() -> None:
    bound = reward_config("carbon", weight=0.25, lambda_carbon=2.0).bind(NODE)  # the intensity of hour k is k g/kWh
    got = bound(values(electricity=10 * KWH, north=18.0), datetime(2017, 1, 11, 10, 30))
    assert got.metrics == pytest.approx({"degrees_outside": 2.0, "energy_kwh": 10.0, "co2_kg": 2.5})
    assert got.terms == pytest.approx({"carbon": -0.25 * 2.0 * 2.5, "comfort": -1.5})
    heavy = CarbonReward.model_validate({"intensity": {"value": 0.4, "unit": "t/MWh"}}).bind(NODE)
    assert heavy(values(electricity=KWH), WINTER).metrics["co2_kg"] == pytest.approx(0.4)


def test_peak() -> None:
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


def test_occupied_cost() -> None:
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


def test_occupied_cost_charges_the_peak_of_another_meter() -> None:
    """The bill is on electricity, the peak on 20 kW of a power sensor; without a price gas is not counted."""
    reward = {"kind": "occupied_cost", "price": {"value": 0.2, "unit": "EUR/kWh"}, "demand": "power"}
    got = read_reward(reward).bind(NODE)(values(electricity=KWH, gas=KWH, power=2e4), WINTER)
    assert got.terms == pytest.approx({"cost": -0.5 * 0.2, "peak": -0.5 * 20.0, "comfort": 0.0})
    with pytest.raises(InvalidConfig, match=r"name the meter 'NaturalGas:Facility' in meters=.*`gas`"):
        read_reward({**reward, "gas_price": reward["price"]}).bind(node_of(*SENSORS, meters=[meter("electricity")]))


@given(st.lists(st.floats(0.0, 1e3), min_size=1, max_size=20), st.floats(0.0, 500.0))
def test_a_month_of_peaks_is_a_demand_charge(kilowatts: list[float], threshold_kw: float) -> None:
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
def test_occupied(more: dict[str, Any], people: tuple[float, float], degrees_outside: float) -> None:
    sample = values(north=18.0, south=24.5, power=1000.0, north_people=people[0], south_people=people[1])
    got = OccupiedReward(**more).bind(NODE)(sample, WINTER)
    assert got.metrics["degrees_outside"] == pytest.approx(degrees_outside)
    assert got.terms == pytest.approx({"energy": -0.05, "comfort": -0.5 * degrees_outside})


def test_zones_without_people_are_left_out_unless_they_are_named() -> None:
    node = node_of(*SENSORS[:6])  # the people of the south are not measured
    got = OccupiedReward().bind(node)(values(node, north=19.0, south=0.0, north_people=2.0), WINTER)
    assert got.metrics == pytest.approx({"power_w": 0.0, "degrees_outside": 1.0, "people": 2.0})
    with pytest.raises(InvalidConfig, match=r"at 'south': .*\('Zone People Occupant Count', 'South'\)"):
        OccupiedReward(temperatures=("north", "south")).bind(node)


# Thermal sensation


SENSED = node_of(SENSORS[3], sensor("a", PMV, unit="1"), sensor("b", PMV, unit="1"), sensor("c", PPD, unit="percent"))


def test_energypluss_own_votes() -> None:
    bound = ThermalSensationReward().bind(SENSED)
    assert bound(np.array([0.0, 0.5, -0.5, 99.0]), WINTER).reward == 0.0
    got = bound(np.array([1000.0, 0.75, -1.5, 99.0]), WINTER)
    assert got.terms == pytest.approx({"energy": -0.05, "comfort": -0.5 * (0.25 + 1.0)})
    assert got.metrics == pytest.approx({"power_w": 1000.0, "beyond_limit": 1.25, "pmv_mean": -0.375})


def test_energypluss_own_dissatisfied_and_those_of_the_votes() -> None:
    aggregation = ThermalSensationReward(by="ppd").bind(SENSED)(np.array([0.0, 3.0, 3.0, 30.0]), WINTER)
    assert aggregation.reward == pytest.approx(-0.5 * 0.2)
    assert aggregation.metrics["ppd_mean"] == pytest.approx(30.0)
    voted = ThermalSensationReward(by="ppd", pmv="a", limit=5.0).bind(SENSED)(np.array([0.0, 1.0, 3.0, 30.0]), WINTER)
    assert voted.metrics["ppd_mean"] == pytest.approx(26.12, abs=0.01)  # ISO 7730: 26 % at a vote of 1
    assert voted.reward == pytest.approx(-0.5 * 0.2112, abs=1e-4)


def test_the_dissatisfied_of_the_standard() -> None:
    """ISO 7730, table 1 (PMV to PPD in whole percent)."""
    table = {2.0: 77, 1.5: 51, 1.0: 26, 0.5: 10, 0.0: 5, -0.5: 10, -1.0: 26, -2.0: 77}
    assert np.round(percentage_dissatisfied(np.array(list(table)))).tolist() == list(table.values())


needs_library = pytest.mark.skipif(not HAVE_LIBRARY, reason="pip install -e '.[comfort]'")


@needs_library
@pytest.mark.parametrize(
    ("air", "radiant", "speed", "humidity", "met", "clo", "pmv", "ppd"),
    [
        (22.0, 22.0, 0.10, 60.0, 1.2, 0.5, -0.75, 17),
        (27.0, 27.0, 0.10, 60.0, 1.2, 0.5, 0.77, 17),
        (27.0, 27.0, 0.30, 60.0, 1.2, 0.5, 0.44, 9),
        (23.5, 25.5, 0.10, 60.0, 1.2, 0.5, -0.01, 5),
        (23.5, 25.5, 0.30, 60.0, 1.2, 0.5, -0.55, 11),
        (19.0, 19.0, 0.10, 40.0, 1.2, 1.0, -0.60, 13),
        (23.0, 21.0, 0.10, 40.0, 1.2, 1.0, 0.05, 5),
        (22.0, 22.0, 0.10, 60.0, 1.6, 0.5, 0.05, 5),
        (27.0, 27.0, 0.30, 60.0, 1.6, 0.5, 0.95, 24),
    ],
)
def test_the_votes_of_the_standard(
    air: float, radiant: float, speed: float, humidity: float, met: float, clo: float, pmv: float, ppd: float
) -> None:
    """ISO 7730, annex D, table D.1."""
    people = {"clo_winter": clo, "clo_summer": 2.0, "met": met, "air_speed": speed, "limit": 0.0}
    sample = values(
        north=air, south=air, north_radiant=radiant, south_radiant=radiant, north_humidity=humidity,
        south_humidity=humidity,
    )  # fmt: skip
    voted = ThermalSensationReward(**people).bind(NODE)(sample, WINTER)
    assert voted.metrics["pmv_mean"] == pytest.approx(pmv, abs=0.01)
    assert voted.reward == pytest.approx(-0.5 * 2 * abs(pmv), abs=0.01)
    felt = ThermalSensationReward(by="ppd", **people).bind(NODE)(sample, WINTER)
    assert felt.metrics["ppd_mean"] == pytest.approx(ppd, abs=0.6)


@needs_library
def test_clothing_goes_by_the_season_of_the_building() -> None:
    sample = values(north=22.0, south=22.0)
    voted = {
        (node.latitude_deg, begin.month): float(ThermalSensationReward().bind(node)(sample, begin).metrics["pmv_mean"])
        for node in (NODE, NODE_SOUTH)
        for begin in (WINTER, SUMMER)
    }
    assert voted[(None, 1)] == voted[(-33.9, 7)] > voted[(None, 7)] == voted[(-33.9, 1)]
    assert voted[(None, 7)] == pytest.approx(-0.75, abs=0.01)


@needs_library
def test_named_sensors_are_computed_from_though_there_are_votes() -> None:
    node = node_of(*SENSORS, *SENSED.sensors[1:])
    named = ThermalSensationReward(temperatures="south", radiant="north_radiant", humidities="north_humidity")
    sample = np.append(values(node_of(*SENSORS), south=27.0, north_radiant=27.0), [9.0, 9.0, 99.0])
    assert named.bind(node)(sample, SUMMER).metrics["pmv_mean"] == pytest.approx(0.77, abs=0.01)
    assert ThermalSensationReward().bind(node)(sample, SUMMER).metrics["pmv_mean"] == 9.0


def test_thermal_sensation__names_the_install_command_without_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pythermalcomfort", None)
    monkeypatch.setitem(sys.modules, "pythermalcomfort.models", None)
    with pytest.raises(InvalidConfig, match=r"pip install -e '\S+\[comfort\]'"):
        ThermalSensationReward().bind(NODE)
    assert ThermalSensationReward().bind(SENSED)  # EnergyPlus's own need none


# Energy


def test_a_power_counts_for_the_timestep_and_a_meter_as_it_is() -> None:
    """A quarter of an hour of 8 kW are 2 kWh."""
    node = node_of(*SENSORS, meters=[meter("gas", "NaturalGas:Facility"), meter("electricity")])
    for energy, kwh in ((None, 5.0), ("electricity", 5.0), ("power", 2.0), ("gas", 7.0), (("power", "gas"), 9.0)):
        got = PeakReward(energy=energy).bind(node)(
            values(power=8000.0, electricity=5 * KWH, gas=7 * KWH), WINTER
        )  # fmt: skip
        assert got.metrics["energy_kwh"] == pytest.approx(kwh)
        assert got.metrics["power_w"] == pytest.approx(kwh * 4000.0)


def test_the_energy_that_is_taken_where_none_is_named() -> None:
    hvac, facility = meter("hvac", "ELECTRICITY:HVAC"), meter("all", "Electricity:Facility")
    both = node_of(SENSORS[1], SENSORS[3], meters=[hvac, facility])
    sample = np.array([22.0, 4000.0, 2 * KWH, 3 * KWH])
    assert PeakReward().bind(both)(sample, WINTER).metrics["energy_kwh"] == pytest.approx(3.0)
    uses = meter("uses", "HVAC:Electricity")
    exact = node_of(SENSORS[1], SENSORS[3], meters=[hvac, uses])
    assert PeakReward().bind(exact)(sample, WINTER).metrics["energy_kwh"] == pytest.approx(3.0)
    one = node_of(SENSORS[1], SENSORS[3], meters=[hvac])
    assert PeakReward().bind(one)(sample[:3], WINTER).metrics["energy_kwh"] == pytest.approx(2.0)
    none = node_of(SENSORS[1], SENSORS[3], meters=[meter("gas", "NaturalGas:Facility")])
    assert PeakReward().bind(none)(sample[:3], WINTER).metrics["energy_kwh"] == pytest.approx(1.0)


def test_a_sensor_of_energy_has_to_read_the_sum() -> None:
    fan = {"name": "fan", "variable": "Fan Electricity Energy", "key": "Fan", "unit": "J"}
    summed = node_of(SENSORS[1], Sensor(**fan, aggregation=Aggregation.SUM))
    got = PeakReward(energy="fan").bind(summed)(np.array([22.0, 2 * KWH]), WINTER)
    assert got.metrics["energy_kwh"] == pytest.approx(2.0)
    with pytest.raises(InvalidConfig, match=r"\('Fan Electricity Energy', 'Fan', 'sum'\) in sensors="):
        PeakReward(energy="fan").bind(node_of(SENSORS[1], Sensor(**fan, aggregation=Aggregation.INSTANT)))


# Seasons


@pytest.mark.parametrize(
    ("day", "summer"),
    [((12, 1), True), ((12, 31), True), ((1, 1), True), ((3, 31), True), ((4, 1), False), ((11, 30), False),
     ((7, 1), False)],
)  # fmt: skip
@pytest.mark.parametrize("kind", ["linear", "exponential", "hourly", "normalized", "energy_cost", "peak", "occupied"])
def test_summer_is_in_december_south_of_the_equator(kind: str, day: tuple[int, int], summer: bool) -> None:
    reward: Any = reward_config(kind)
    bound = reward.bind(NODE_SOUTH)
    moment = datetime(2017, *day, 12)
    assert reward.season(NODE_SOUTH).band(moment) == ((23.0, 26.0) if summer else (20.0, 23.5))
    sample = values(NODE_SOUTH, north=26.0, south=26.0, north_people=1.0, south_people=1.0)
    assert (bound(sample, moment).terms["comfort"] == 0.0) == summer


def test_named_summer__holds_in_both_hemispheres() -> None:
    own = LinearReward(summer_begin=(6, 1), summer_end=(9, 30))
    for node in (NODE, NODE_SOUTH):
        assert own.season(node).band(SUMMER) == (23.0, 26.0)
    half = LinearReward(summer_end=(12, 15)).season(NODE_SOUTH)
    assert [half.band(datetime(2017, 12, d)) == (23.0, 26.0) for d in (1, 15, 16)] == [True, True, False]


@pytest.mark.parametrize("latitude_deg", [None, 0.0, 51.0])
def test_summer_is_in_june_elsewhere(latitude_deg: float | None) -> None:
    node = NODE.model_copy(update={"latitude_deg": latitude_deg})
    season = LinearReward().season(node)
    assert season.band(SUMMER) == LinearReward().band(SUMMER) == (23.0, 26.0)
    assert season.band(WINTER) == (20.0, 23.5)


def test_each_slot_has_its_own_season() -> None:
    rows = np.array([values(north=20.0), values(north=20.0), values(north=20.0)])
    got = LinearReward().bind(NODE)(rows, [WINTER, SUMMER, WINTER])
    assert got.metrics["degrees_outside"].tolist() == [0.0, 3.0 + 1.0, 0.0]


@pytest.mark.parametrize("day", [(13, 1), (2, 30), (0, 1), (6, 0)])
def test_a_day_that_is_none(day: tuple[int, int]) -> None:
    with pytest.raises(ValidationError, match="a month and a day expected"):
        LinearReward(summer_begin=day)


# What is remembered


def test_an_episode_of_one_slot_forgets_that_slots_peak() -> None:
    bound = PeakReward().bind(NODE)
    rows = np.array([values(electricity=KWH), values(electricity=2 * KWH)])
    assert bound(rows, WINTER).terms["peak"] == pytest.approx([-4.0, -8.0])
    assert bound(rows, WINTER).terms["peak"] == pytest.approx([0.0, 0.0])
    bound.reset([1])
    assert bound(rows, WINTER).terms["peak"] == pytest.approx([0.0, -8.0])
    bound.reset()
    assert bound(rows, WINTER).terms["peak"] == pytest.approx([-4.0, -8.0])


def test_a_state_is_a_copy_and_an_empty_one_is_the_beginning() -> None:
    bound = NormalizedReward().bind(NODE)
    begin = bound.state()
    bound(values(power=1000.0), WINTER)
    kept = bound.state()
    bound(values(power=4000.0), WINTER)
    bound.restore(kept)
    assert bound(values(power=500.0), WINTER).terms["energy"] == pytest.approx(-0.25)
    bound.restore(begin)
    assert bound(values(power=500.0), WINTER).terms["energy"] == pytest.approx(-0.5)
    assert json.loads(json.dumps(kept)) == kept == {"max_power_w": 1000.0, "max_degrees": 0.0}


def test_the_state_of_another_reward_and_other_slots_are_refused() -> None:
    bound = NormalizedReward().bind(NODE)
    with pytest.raises(InvalidConfig, match="has the state max_power_w, max_degrees, not month, peak_kw"):
        bound.restore({"month": 1, "peak_kw": 2})
    bound(np.array([values(), values()]), WINTER)
    with pytest.raises(InvalidConfig, match=r"leading shape \(2,\) expected, as before, got \(\)"):
        bound(values(), WINTER)


# Points that are missing or of another unit

BARE = node_of(sensor("outdoor", "Site Outdoor Air Drybulb Temperature"))
WARM = node_of(SENSORS[1], SENSORS[3], meters=[meter("water", "Water:Facility").model_copy(update={"unit": "m3"})])
UNBINDABLE: dict[str, tuple[RewardConfig, Manifest, str]] = {
    "no power": (ExponentialReward(), BARE, "the exponential reward needs the HVAC's power: .* 'HVAC:Elec"),
    "no zone": (PeakReward(energy="fans"), node_of(SENSORS[4]), "the peak reward needs .* 'Zone Air Temperature'"),
    "no energy": (PeakReward(), node_of(SENSORS[1]), "the peak reward needs the energy .*'Electricity:Facility' in m"),
    "unknown energy": (PeakReward(energy="elec"), NODE, "'elec', .* not have; did you mean 'electricity'"),
    "no energy's unit": (PeakReward(energy="north"), NODE, r"power in W, which 'north' is not \(degC\); there are"),
    "water": (PeakReward(energy="water"), WARM, r"'water' is not \(m3\); did you mean 'power'"),
    "unknown temperature": (NormalizedReward(temperatures="nort"), NODE, "'nort'.*did you mean 'north'"),
    "power as a temperature": (HourlyReward(temperatures="power"), NODE, "hourly reward needs a sensor in degC"),
    "no setpoints": (MultiZoneReward(), WARM, "the multi_zone reward needs .*'Zone Thermostat Heating Setpoint"),
    "unknown setpoint": (MultiZoneReward(zones={"north": "setpoint"}), NODE, "multi_zone reward names 'setpoint'"),
    "people as a setpoint": (MultiZoneReward(zones={"north": "north_people"}), NODE, "in degC, which 'north_people'"),
    "nobody": (OccupiedReward(), WARM,
               r"at 'north': name a sensor in sensors=, such as \('Zone People Occupant Count', 'N"),
    "unknown people": (OccupiedReward(occupants={"north": "crowd"}), NODE, "occupied reward names 'crowd'"),
    "watts as people": (OccupiedReward(occupants={"north": "power"}), NODE, "in 1 or count or fraction, which 'power'"),
    "nobody named for one": (OccupiedReward(occupants={"north": "north_people"}, temperatures=("north", "south")),
                             NODE, "number of people at 'south'"),
    "no radiant temperature": (ThermalSensationReward(), WARM,
                               r"\('Zone Mean Radiant Temperature', 'North'\) in addition"),
    "two for one": (ThermalSensationReward(temperatures="north", radiant=("north_radiant", "south_radiant")), NODE,
                    "names 2 radiant for 1 temperatures"),
    "degrees as votes": (ThermalSensationReward(pmv="north"), NODE, "thermal_sensation reward needs a sensor in 1"),
}  # fmt: skip


@pytest.mark.parametrize(("reward", "node", "words"), UNBINDABLE.values(), ids=UNBINDABLE)
def test_a_point_that_is_missing_is_named_when_the_reward_is_bound(
    reward: RewardConfig, node: Manifest, words: str
) -> None:
    with pytest.raises(InvalidConfig, match=words):
        reward.bind(node)


def test_a_file_of_prices_is_read_when_the_reward_is_bound(tmp_path: Path) -> None:
    reward = reward_config(
        "energy_cost", price={"csv": str(tmp_path / "none.csv"), "column": "value", "unit": "EUR/MWh"}
    )
    with pytest.raises(InvalidConfig, match=r"there is no file .*none.csv"):
        reward.bind(NODE)
    carbon = reward_config("carbon", intensity={"csv": str(tmp_path / "none.csv"), "column": "value", "unit": "g/kWh"})
    with pytest.raises(InvalidConfig, match=r"there is no file .*none.csv"):
        carbon.bind(NODE)


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        ("energy_cost", {"price": 0.25}), ("energy_cost", {"price": {"value": 1, "unit": "EUR"}}),
        ("carbon", {"intensity": {"value": 1, "unit": "EUR/kWh"}}), ("tariff", {"unit": "EUR"}),
        ("tariff", {"periods": []}), ("hourly", {"hours": [9, 9]}), ("multi_zone", {"zones": {}}),
        ("multi_zone", {"zones": {"a": ["b", "c", "d"]}}), ("multi_zone", {"threshold": -1}),
        ("peak", {"threshold_kw": -1}), ("occupied", {"by": "chance"}), ("thermal_sensation", {"met": 0.1}),
        ("normalized", {"max_power_w": 0}), ("exponential", {"winter": [24, 20]}),
    ],
    ids=str,
)  # fmt: skip
def test_a_reward_that_cannot_be(kind: str, wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidConfig, match=next(iter(wrong))):
        reward_config(kind, **wrong)


# One's own


def saving(values: Mapping[str, Any], begin: datetime) -> dict[str, Any]:
    return {"energy": -values["power"] / 1000.0, "night": -1.0 if begin.hour < 6 else 0.0}


def test_a_function_is_a_reward() -> None:
    bound = read_reward(saving).bind(NODE)
    got = bound(values(power=2000.0), WINTER.replace(hour=3))
    assert got == Outcome(-3.0, {"energy": -2.0, "night": -1.0}, {})
    assert (bound.state(), type(got.terms["energy"])) == ({}, float)


def test_a_function_may_give_one_number() -> None:
    for function in (lambda v, b: -v["power"], lambda v, b: {"reward": -v["power"]}):
        got = from_function(function).bind(NODE)(values(power=2.0), WINTER)
        assert (got.reward, got.terms) == (-2.0, {"reward": -2.0})


def test_a_function_sees_arrays_where_there_are_slots() -> None:
    def warm(values: Mapping[str, Any], begin: Sequence[datetime]) -> dict[str, Any]:
        return {"north": -values["north"], "fixed": -1.0, "month": -np.array([b.month for b in begin])}

    rows = np.array([values(north=20.0), values(north=21.0)])
    got = read_reward(warm).bind(NODE)(rows, [WINTER, SUMMER])
    assert got.reward.tolist() == [-22.0, -29.0]
    assert got.terms["fixed"].tolist() == [-1.0, -1.0]


class Counting:
    """Costs one more in each timestep."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self, values: Mapping[str, Any], begin: datetime) -> float:
        self.count += 1
        return -float(self.count)

    def reset(self, slots: Sequence[int] | None = None) -> None:
        self.count = 0

    def state(self) -> dict[str, Any]:
        return {"count": self.count}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.count = state["count"]


def test_a_class_is_made_for_each_use_and_may_remember() -> None:
    reward = read_reward(Counting)
    first, second = reward.bind(NODE), reward.bind(NODE)
    assert [first(values(), WINTER).reward for _ in range(3)] == [-1.0, -2.0, -3.0]
    assert second(values(), WINTER).reward == -1.0
    second.restore(first.state())
    assert second(values(), WINTER).reward == -4.0
    second.reset()
    assert second(values(), WINTER).reward == -1.0
    assert read_reward(Counting()).bind(NODE)(values(), WINTER).reward == -1.0


def test_what_can_be_bound_is_taken_as_it_is() -> None:
    linear = LinearReward()
    assert read_reward(linear) is linear
    assert read_reward(LinearReward) == linear

    class Own:
        def bind(self, manifest: Manifest) -> BoundReward:
            return linear.bind(manifest)

    assert isinstance(read_reward(Own), Own)


@pytest.mark.parametrize("wrong", [5, None, [1], 2.5], ids=str)
def test_what_is_no_reward(wrong: Any) -> None:
    with pytest.raises(InvalidConfig, match=r"reward: a kind \(linear, .*expected, got"):
        read_reward(wrong)


class Needy:
    def __init__(self, weight: float) -> None:
        self.weight = weight

    def __call__(self, values: Mapping[str, Any], begin: datetime) -> float:
        return -self.weight


def test_a_function_or_class_that_does_not_fit() -> None:
    for function in (lambda: 0.0, lambda v: 0.0, lambda v, b, more: 0.0, type("Silent", (), {}), object):
        with pytest.raises(InvalidConfig, match=r"should take \(values, begin\)"):
            read_reward(function)
    with pytest.raises(InvalidConfig, match=r"Needy cannot be instantiated without arguments .*'weight'"):
        read_reward(Needy).bind(NODE)
    with pytest.raises(InvalidConfig, match="CarbonReward cannot be instantiated without arguments"):
        read_reward(CarbonReward)


@pytest.mark.parametrize("term", [float("nan"), float("inf"), None, "much", [1.0, 2.0]], ids=str)
def test_a_term_that_is_no_number(term: Any) -> None:
    for gives in (term, {"comfort": term}):
        name = "comfort" if isinstance(gives, dict) else "reward"
        with pytest.raises(InvalidConfig, match=f"returned .* for '{name}'; a finite number expected"):
            read_reward(lambda v, b, gives=gives: gives).bind(NODE)(values(), WINTER)


def asks_for_norht(values: Mapping[str, Any], begin: datetime) -> float:
    return -float(values["norht"])


@pytest.mark.parametrize("slots", [None, 2])
def test_a_function_that_asks_for_a_point_that_is_not_there(slots: int | None) -> None:
    observation = values() if slots is None else np.array([values()] * slots)
    with pytest.raises(UnknownName, match=r"asks_for_norht reads 'norht', .*did you mean 'north'") as raised:
        read_reward(asks_for_norht).bind(NODE)(observation, WINTER if slots is None else [WINTER] * slots)
    assert isinstance(raised.value.__cause__, KeyError)


def test_a_function_may_look_whether_a_point_is_there() -> None:
    def careful(values: Mapping[str, Any], begin: datetime) -> float:
        try:
            return float(values["norht"])
        except KeyError:
            return values.get("norht", -1.0) - ("norht" in values)

    assert read_reward(careful).bind(NODE)(values(), WINTER).reward == -1.0


@pytest.mark.parametrize("error", [KeyError("tariff"), ZeroDivisionError("by nothing"), InvalidConfig("mine")], ids=str)
def test_other_exceptions_of_a_function_are_its_own(error: Exception) -> None:
    def broken(values: Mapping[str, Any], begin: datetime) -> float:
        raise error

    with pytest.raises(type(error)) as raised:
        read_reward(broken).bind(NODE)(values(), WINTER)
    assert raised.value is error
    assert error.__notes__ == ["in the reward broken"]


@pytest.mark.slow
def test_the_example() -> None:
    example = Path(__file__).parents[2] / "examples" / "own_reward.py"
    done = subprocess.run([sys.executable, str(example)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    own, steady = done.stdout.splitlines()
    assert own.startswith("cool_and_cheap: energy -")
    assert ", comfort -" in own
    assert steady.startswith("Steady: reward -")


def test_what_is_offered_is_there() -> None:
    assert [name for name in rewards.__all__ if not hasattr(rewards, name)] == []
