"""The linear reward, computed by hand.

With its defaults (weight 0.5, lambda_energy 1e-4 a watt, lambda_temperature 1 a degree) 1000 W cost
0.5 * 1e-4 * 1000 = 0.05 and a degree outside the band costs 0.5.
"""

from datetime import datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from support.builders import manifest, meter, sensor

from zenostat.agent_sdk.rewards import LinearReward, read_reward
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

POWER = "Facility Total HVAC Electricity Demand Rate"
WINTER, SUMMER = datetime(2017, 1, 15, 12), datetime(2017, 7, 15, 12)
NODE = manifest(
    sensors=[
        sensor("outdoor", "Site Outdoor Air Drybulb Temperature"),
        sensor("north", "Zone Air Temperature"),
        sensor("power", POWER, "Whole Building", "W"),
        sensor("south", "Zone Air Temperature"),
    ],
    meters=[meter("electricity")],
)


def values(north: float, south: float, power_w: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """In the order of the manifest, with an outdoor temperature and a meter that do not matter."""
    return np.array([-40.0, north, power_w, south, 1e9])


@pytest.mark.parametrize(
    ("north", "south", "power_w", "begin", "reward"),
    [
        (21.0, 22.0, 0.0, WINTER, 0.0),
        (21.0, 22.0, 1000.0, WINTER, -0.05),
        (19.0, 22.0, 0.0, WINTER, -0.5),  # one degree too cold in one zone
        (19.0, 18.0, 0.0, WINTER, -1.5),  # 1 + 2 degrees
        (25.0, 18.0, 2000.0, WINTER, -0.1 - 0.5 * (1.5 + 2.0)),
        (20.0, 23.5, 0.0, WINTER, 0.0),  # the ends belong to the band
        (23.0, 26.0, 0.0, SUMMER, 0.0),
        (25.0, 24.0, 0.0, SUMMER, 0.0),
        (22.0, 28.0, 1000.0, SUMMER, -0.05 - 0.5 * (1.0 + 2.0)),
    ],
)
def test_rewards__hand_and_the_reward_agree(
    north: float, south: float, power_w: float, begin: datetime, reward: float
) -> None:
    got = LinearReward().bind(NODE)(values(north, south, power_w), begin)
    assert got.reward == pytest.approx(reward, abs=1e-12)


def test_linear_reward__reports_its_terms_and_metrics() -> None:
    got = LinearReward().bind(NODE)(values(25.0, 18.0, 2000.0), WINTER)
    assert got.terms == pytest.approx({"energy": -0.1, "comfort": -1.75})
    assert got.metrics == pytest.approx({"power_w": 2000.0, "degrees_outside": 3.5})


@pytest.mark.parametrize(("weight", "reward"), [(0.0, -3.0), (1.0, -0.1), (0.25, -0.025 - 2.25)])
def test_rewards__weight_is_that_of_energy(weight: float, reward: float) -> None:
    got = LinearReward(weight=weight).bind(NODE)(values(17.0, 22.0, 1000.0), WINTER)
    assert got.reward == pytest.approx(reward)


def test_rewards__factors_scale_their_terms() -> None:
    bound = LinearReward(lambda_energy=2e-4, lambda_temperature=3.0).bind(NODE)
    terms = bound(values(19.0, 22.0, 1000.0), WINTER).terms
    assert (terms["energy"], terms["comfort"]) == pytest.approx((-0.1, -1.5))


def test_rewards__power_of_meters_is_their_energy_over_the_timestep() -> None:
    node = manifest(
        sensors=NODE.sensors,
        meters=[meter("cooling", "DistrictCooling:Facility"), meter("heating", "DistrictHeatingWater:Facility")],
    )
    energy_j = 1000.0 * node.step_s
    got = LinearReward(power=("cooling", "heating")).bind(node)(
        np.array([-40.0, 21.0, 5000.0, 22.0, 0.25 * energy_j, 0.75 * energy_j]), WINTER
    )
    assert got.metrics["power_w"] == pytest.approx(1000.0)
    assert got.terms["energy"] == pytest.approx(-0.05)


# The season


@pytest.mark.parametrize(
    ("day", "band"),
    [
        (datetime(2017, 5, 31, 23, 45), (20.0, 23.5)),
        (datetime(2017, 6, 1, 0, 0), (23.0, 26.0)),
        (datetime(2017, 9, 30, 23, 45), (23.0, 26.0)),
        (datetime(2017, 10, 1, 0, 0), (20.0, 23.5)),
        (datetime(2017, 1, 1), (20.0, 23.5)),
        (datetime(2017, 12, 31, 23, 45), (20.0, 23.5)),
        (datetime(1999, 7, 1), (23.0, 26.0)),
    ],
)
def test_rewards__summer_is_from_june_to_september_both_included(day: datetime, band: tuple[float, float]) -> None:
    assert LinearReward().band(day) == band


@pytest.mark.parametrize(
    ("month", "day", "summer"),
    [
        (12, 1, True), (12, 31, True), (1, 1, True), (2, 28, True), (2, 29, False), (3, 1, False), (7, 1, False),
        (11, 30, False),
    ],
)  # fmt: skip
def test_rewards__summer_may_span_new_year(month: int, day: int, summer: bool) -> None:
    reward = LinearReward(summer_begin=(12, 1), summer_end=(2, 28))
    assert reward.band(datetime(2016, month, day)) == ((23.0, 26.0) if summer else (20.0, 23.5))


def test_rewards__summer_of_one_day() -> None:
    reward = LinearReward(summer_begin=(7, 1), summer_end=(7, 1))
    bands = [reward.band(datetime(2017, 7, day)) == reward.summer for day in (1, 2)]
    assert bands == [True, False]
    assert reward.band(datetime(2017, 6, 30)) == reward.winter


@given(st.datetimes(datetime(2016, 1, 1), datetime(2017, 12, 31)), st.booleans())
def test_rewards__year_and_the_hour_do_not_matter(moment: datetime, spans: bool) -> None:
    reward = LinearReward(summer_begin=(11, 1), summer_end=(3, 31)) if spans else LinearReward()
    summer_months = {11, 12, 1, 2, 3} if spans else {6, 7, 8, 9}
    assert (reward.band(moment) == reward.summer) == (moment.month in summer_months)


# How far outside

finite = st.floats(-1e6, 1e6)


@given(finite, st.floats(0, 10))
def test_rewards__further_out_is_never_better(temperature: float, further: float) -> None:
    bound = LinearReward().bind(NODE)
    away = temperature + (further if temperature >= 22.0 else -further)
    assert bound(values(away, 22.0, 0.0), WINTER)[0] <= bound(values(temperature, 22.0, 0.0), WINTER)[0]


# The points


def test_rewards__points_may_be_named() -> None:
    bound = LinearReward(power="power", temperatures=("south",)).bind(NODE)
    assert bound(values(-30.0, 22.0, 1000.0), WINTER)[0] == pytest.approx(-0.05)


def test_rewards__several_powers_are_added_up() -> None:
    node = manifest(sensors=[sensor("fans", "Fan Electricity Rate", unit="W"), *NODE.sensors])
    sample = np.array([700.0, *values(21.0, 22.0, 1000.0)[:-1]])
    for named, watts in (("fans", 700.0), (["fans"], 700.0), (("power", "fans"), 1700.0)):
        reward, _, measures = LinearReward(power=named).bind(node)(sample, WINTER)
        assert measures["power_w"] == pytest.approx(watts)
        assert reward == pytest.approx(-0.5 * 1e-4 * watts)


def test_rewards__variables_are_found_in_any_case_and_mean_temperatures_serve_where_there_are_no_others() -> None:
    node = manifest(sensors=[sensor("p", POWER.upper(), unit="W"), sensor("t", "ZONE MEAN AIR TEMPERATURE")])
    assert LinearReward().bind(node)(np.array([0.0, 19.0]), WINTER)[0] == pytest.approx(-0.5)
    both = manifest(sensors=[*node.sensors, sensor("u", "Zone Air Temperature")])
    assert LinearReward().bind(both)(np.array([0.0, 19.0, 21.0]), WINTER)[0] == 0.0


def test_linear_reward__power_is_that_of_the_hvac_end_uses_where_they_are_measured() -> None:
    """EnergyPlus's demand rate has electric water heaters and other plant equipment too."""
    sensors = [sensor("power", POWER, "Whole Building", "W"), sensor("north")]
    node = manifest(sensors=sensors, meters=[meter("group", "Electricity:HVAC"), meter("hvac", "HVAC:Electricity")])
    values = np.array([9000.0, 24.0, 5 * 3.6e6, 3.6e6])
    assert LinearReward().bind(node)(values, SUMMER).metrics["power_w"] == pytest.approx(4000.0)  # 1 kWh in 900 s
    assert LinearReward(power="power").bind(node)(values, SUMMER).metrics["power_w"] == 9000.0
    hidden = node.model_copy(update={"meters": tuple(m.model_copy(update={"observed": False}) for m in node.meters)})
    assert LinearReward().bind(hidden)(values, SUMMER).metrics["power_w"] == 9000.0


MISSING: dict[str, tuple[LinearReward, Manifest, str]] = {
    "no power": (LinearReward(), manifest(sensors=[sensor("t")]), "'Facility Total HVAC Electricity Demand Rate'"),
    "no zone": (LinearReward(), manifest(sensors=[sensor("p", POWER)]), "'Zone Air Temperature'"),
    "unknown power": (LinearReward(power="powr"), NODE, "'powr'.*did you mean 'power'"),
    "unknown one of two": (LinearReward(power=("power", "fan")), NODE, "'fan'"),
    "zone named twice": (LinearReward(temperatures=("north", "north")), NODE, "'north' twice"),
    "power named twice": (LinearReward(power=("power", "power")), NODE, "'power' twice"),
    "unknown zone": (LinearReward(temperatures=("north", "sout")), NODE, "'sout'.*did you mean 'south'"),
}


@pytest.mark.parametrize(("reward", "node", "words"), MISSING.values(), ids=MISSING)
def test_rewards__point_that_is_missing_is_named(reward: LinearReward, node: Manifest, words: str) -> None:
    with pytest.raises(InvalidConfig, match=words):
        reward.bind(node)


def test_rewards__joules_are_not_taken_for_watts() -> None:
    joules = np.array([-40.0, 21.0, 0.0, 22.0, 1000.0 * NODE.step_s])
    got = LinearReward(power="electricity").bind(NODE)(joules, WINTER)
    assert got.metrics["power_w"] == pytest.approx(1000.0)
    with pytest.raises(InvalidConfig, match="in W and J"):
        LinearReward(power=("power", "electricity")).bind(NODE)


# As a scenario names it


def test_rewards__kind_alone_is_the_reward_with_its_defaults() -> None:
    assert read_reward("linear") == read_reward({"kind": "linear"}) == LinearReward()


def test_rewards__scenario_names_the_parameters() -> None:
    fields = {"kind": "linear", "weight": 0.3, "winter": [19, 22], "summer_begin": [5, 1], "power": "p"}
    named = LinearReward(weight=0.3, winter=(19.0, 22.0), summer_begin=(5, 1), power=("p",))
    assert read_reward(fields) == named


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ("liner", "no kind 'liner'; did you mean 'linear'"),
        ({"weight": 0.3}, "reward: kind is missing; there are: linear"),
        ({"kind": ["linear"]}, "no kind"),
    ],
    ids=str,
)
def test_rewards__kind_that_is_not_there_is_refused(fields: Any, words: str) -> None:
    with pytest.raises(InvalidConfig, match=words):
        read_reward(fields)


def test_read_reward__reports_all_errors_at_once() -> None:
    with pytest.raises(InvalidConfig) as raised:
        read_reward({"kind": "linear", "weight": 2, "lambda_enrgy": 1, "winter": [20]})
    assert [word for word in ("weight", "lambda_enrgy", "winter") if word not in str(raised.value)] == []


# What cannot be


@pytest.mark.parametrize(
    "wrong",
    [
        {"weight": -0.1}, {"weight": 1.1}, {"weight": float("nan")}, {"lambda_energy": -1.0},
        {"lambda_temperature": -1.0}, {"winter": (24.0, 20.0)}, {"summer": (23.0, 23.0)}, {"lambda_enrgy": 1.0},
    ],
)  # fmt: skip
def test_rewards__reward_that_cannot_be_is_not_made(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        LinearReward(**wrong)


def test_rewards__reward_cannot_be_changed() -> None:
    reward = LinearReward()
    with pytest.raises(ValidationError, match="frozen"):
        reward.weight = 0.1
