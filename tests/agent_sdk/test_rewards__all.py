"""All kinds of reward: in all shapes, the sum of their terms, what they remember, seasons, files."""

import importlib.util
import json
import math
import sys
from datetime import datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError
from support.builders import manifest, meter, sensor
from support.examples import examples
from support.rewards import KWH, MINIMAL_FIELDS, NODE, SENSORS, SUMMER, WINTER, Array, node_of, reward_config, values

from zenostat.agent_sdk.rewards import (
    REWARDS,
    LinearReward,
    NormalizedReward,
    PeakReward,
    RewardConfig,
    ThermalSensationReward,
    read_reward,
)
from zenostat.agent_sdk.rewards.energy_meter import EnergyMeter
from zenostat.agent_sdk.rewards.thermal_sensation import percentage_dissatisfied
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Aggregation, Meter, Sensor

PMV, PPD = "Zone Thermal Comfort Fanger Model PMV", "Zone Thermal Comfort Fanger Model PPD"

NODE_SOUTH = NODE.model_copy(update={"latitude_deg": -33.9})


def test_rewards__each_kind_is_here() -> None:
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
batches = arrays(
    np.float64,
    st.sampled_from([(2, 3), (0, 3), (3,)]).map(lambda shape: (*shape, len(UNITS))),
    elements=st.floats(0.0, 50.0),
)
moments = st.datetimes(datetime(2016, 1, 1), datetime(2017, 12, 31)).map(lambda m: m.replace(minute=0, second=0))
HAVE_LIBRARY = importlib.util.find_spec("pythermalcomfort") is not None
KINDS = sorted(kind for kind in MINIMAL_FIELDS if kind != "thermal_sensation" or HAVE_LIBRARY)
"""Those that can be bound to `NODE`, which has no votes of EnergyPlus's own."""
kinds = st.sampled_from(KINDS)


@settings(max_examples=examples(200), deadline=None)
@given(kinds, st.lists(st.tuples(samples, moments), min_size=1, max_size=4), st.floats(0.0, 0.5))
def test_rewards__reward_is_the_sum_of_its_terms_and_none_is_positive(
    kind: str, steps: list[tuple[Array, datetime]], weight: float
) -> None:
    bound = reward_config(kind, weight=weight).bind(NODE)
    for sample, begin in steps:
        got = bound(sample, begin)
        assert got.reward == sum(got.terms.values())
        assert all(term <= 0.0 for term in got.terms.values())
        assert all(np.ndim(number) == 0 and math.isfinite(number) for number in (*got.terms.values(), got.reward))
        assert all(np.ndim(number) == 0 for number in got.metrics.values())
        assert got.metrics.get("degrees_outside", 0.0) >= 0.0


@settings(max_examples=examples(100), deadline=None)
@given(kinds, st.lists(st.tuples(samples, moments), min_size=1, max_size=4))
def test_rewards__slots_are_what_each_of_them_is_alone(kind: str, slots: list[tuple[Array, datetime]]) -> None:
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
@given(kinds, moments, batches)
def test_rewards__one_begin_does_for_any_leading_shape(kind: str, begin: datetime, batch: Array) -> None:
    shape = batch.shape[:-1]
    got = reward_config(kind).bind(NODE)(batch, begin)
    assert got.reward.shape == shape
    assert all(term.shape == shape for term in (*got.terms.values(), *got.metrics.values()))
    for index in np.ndindex(shape):
        assert got.reward[index] == pytest.approx(reward_config(kind).bind(NODE)(batch[index], begin).reward)


@settings(max_examples=examples(60), deadline=None)
@given(kinds, st.lists(st.tuples(samples, moments), min_size=2, max_size=6), st.data())
def test_rewards__reward_goes_on_from_its_state(
    kind: str, steps: list[tuple[Array, datetime]], data: st.DataObject
) -> None:
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
def test_rewards__reward_leaves_the_values_alone(kind: str) -> None:
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
    "district": {"price": st.just("tariff"), "ramping": st.floats(0, 9), "generation": st.just(("a", "b"))},
}.items():
    optional[kind] |= more
described = st.sampled_from(sorted(MINIMAL_FIELDS)).flatmap(
    lambda kind: st.fixed_dictionaries({"kind": st.just(kind)}, optional=optional[kind]).map(
        lambda fields: MINIMAL_FIELDS[fields["kind"]] | fields
    )
)


@pytest.mark.slow
@settings(max_examples=examples(200), deadline=None)
@given(described)
def test_rewards__reward_that_was_written_is_read_back(fields: dict[str, Any]) -> None:
    reward = read_reward(fields)
    assert isinstance(reward, RewardConfig)
    plain = reward.model_dump(mode="json", exclude_defaults=True)
    assert plain["kind"] == fields["kind"]
    assert read_reward(plain) == reward
    assert read_reward(yaml12.parse(yaml12.dump(plain), "it")) == reward
    assert read_reward(json.loads(reward.model_dump_json())) == reward


def test_rewards__only_what_differs_is_written() -> None:
    plain = LinearReward(weight=0.25, power=("fans",)).model_dump(mode="json", exclude_defaults=True)
    assert list(plain.items()) == [("kind", "linear"), ("weight", 0.25), ("power", ["fans"])]
    assert LinearReward().model_dump(mode="json", exclude_defaults=True) == {"kind": "linear"}


@pytest.mark.parametrize("kind", MINIMAL_FIELDS)
def test_rewards__no_reward_takes_what_is_no_number_or_not_known(kind: str) -> None:
    with pytest.raises(InvalidConfig) as raised:
        read_reward({"kind": kind, **MINIMAL_FIELDS[kind], "weight": float("nan"), "wieght": 1})
    assert "weight: " in str(raised.value)
    assert "wieght: " in str(raised.value)


# Thermal sensation


SENSED = node_of(SENSORS[3], sensor("a", PMV, unit="1"), sensor("b", PMV, unit="1"), sensor("c", PPD, unit="percent"))


def test_rewards__energypluss_own_votes() -> None:
    bound = ThermalSensationReward().bind(SENSED)
    assert bound(np.array([0.0, 0.5, -0.5, 99.0]), WINTER).reward == 0.0
    got = bound(np.array([1000.0, 0.75, -1.5, 99.0]), WINTER)
    assert got.terms == pytest.approx({"energy": -0.05, "comfort": -0.5 * (0.25 + 1.0)})
    assert got.metrics == pytest.approx({"power_w": 1000.0, "beyond_limit": 1.25, "pmv_mean": -0.375})


def test_rewards__energypluss_own_dissatisfied_and_those_of_the_votes() -> None:
    aggregation = ThermalSensationReward(by="ppd").bind(SENSED)(np.array([0.0, 3.0, 3.0, 30.0]), WINTER)
    assert aggregation.reward == pytest.approx(-0.5 * 0.2)
    assert aggregation.metrics["ppd_mean"] == pytest.approx(30.0)
    voted = ThermalSensationReward(by="ppd", pmv="a", limit=5.0).bind(SENSED)(np.array([0.0, 1.0, 3.0, 30.0]), WINTER)
    assert voted.metrics["ppd_mean"] == pytest.approx(26.12, abs=0.01)  # ISO 7730: 26 % at a vote of 1
    assert voted.reward == pytest.approx(-0.5 * 0.2112, abs=1e-4)


def test_rewards__dissatisfied_of_the_standard() -> None:
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
def test_rewards__votes_of_the_standard(
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
def test_rewards__clothing_goes_by_the_season_of_the_building() -> None:
    sample = values(north=22.0, south=22.0)
    voted = {
        (node.latitude_deg, begin.month): float(ThermalSensationReward().bind(node)(sample, begin).metrics["pmv_mean"])
        for node in (NODE, NODE_SOUTH)
        for begin in (WINTER, SUMMER)
    }
    assert voted[(None, 1)] == voted[(-33.9, 7)] > voted[(None, 7)] == voted[(-33.9, 1)]
    assert voted[(None, 7)] == pytest.approx(-0.75, abs=0.01)


@needs_library
def test_rewards__named_sensors_are_computed_from_though_there_are_votes() -> None:
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


def test_rewards__power_counts_for_the_timestep_and_a_meter_as_it_is() -> None:
    """A quarter of an hour of 8 kW are 2 kWh."""
    node = node_of(*SENSORS, meters=[meter("gas", "NaturalGas:Facility"), meter("electricity")])
    for energy, kwh in ((None, 5.0), ("electricity", 5.0), ("power", 2.0), ("gas", 7.0), (("power", "gas"), 9.0)):
        got = PeakReward(energy=energy).bind(node)(
            values(power=8000.0, electricity=5 * KWH, gas=7 * KWH), WINTER
        )  # fmt: skip
        assert got.metrics["energy_kwh"] == pytest.approx(kwh)
        assert got.metrics["power_w"] == pytest.approx(kwh * 4000.0)


def test_rewards__energy_that_is_taken_where_none_is_named() -> None:
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


def test_rewards__energy_and_power_in_other_units() -> None:
    of = manifest(meters=[Meter(name="bill", unit="kWh")], sensors=[Sensor(name="power", unit="kW")])
    meter = EnergyMeter("peak", ["bill", "power"], of)
    assert meter.kwh(np.array([8.0, 3.0])) == pytest.approx(8.0 * 0.25 + 3.0)  # 8 kW in a quarter of an hour


def test_rewards__meter_that_is_named_twice_is_refused() -> None:
    with pytest.raises(InvalidConfig, match="the peak reward names 'bill' twice, which would count it twice"):
        EnergyMeter("peak", ["bill", "bill"], manifest(meters=[Meter(name="bill", unit="kWh")]))


def test_rewards__sensor_of_energy_has_to_read_the_sum() -> None:
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
def test_rewards__summer_is_in_december_south_of_the_equator(kind: str, day: tuple[int, int], summer: bool) -> None:
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
def test_rewards__summer_is_in_june_elsewhere(latitude_deg: float | None) -> None:
    node = NODE.model_copy(update={"latitude_deg": latitude_deg})
    season = LinearReward().season(node)
    assert season.band(SUMMER) == LinearReward().band(SUMMER) == (23.0, 26.0)
    assert season.band(WINTER) == (20.0, 23.5)


def test_rewards__each_slot_has_its_own_season() -> None:
    rows = np.array([values(north=20.0), values(north=20.0), values(north=20.0)])
    got = LinearReward().bind(NODE)(rows, [WINTER, SUMMER, WINTER])
    assert got.metrics["degrees_outside"].tolist() == [0.0, 3.0 + 1.0, 0.0]


@pytest.mark.parametrize("day", [(13, 1), (2, 30), (0, 1), (6, 0)])
def test_rewards__day_that_is_none(day: tuple[int, int]) -> None:
    with pytest.raises(ValidationError, match="a month and a day expected"):
        LinearReward(summer_begin=day)


# What is remembered


def test_rewards__episode_of_one_slot_forgets_that_slots_peak() -> None:
    bound = PeakReward().bind(NODE)
    rows = np.array([values(electricity=KWH), values(electricity=2 * KWH)])
    assert bound(rows, WINTER).terms["peak"] == pytest.approx([-4.0, -8.0])
    assert bound(rows, WINTER).terms["peak"] == pytest.approx([0.0, 0.0])
    bound.reset([1])
    assert bound(rows, WINTER).terms["peak"] == pytest.approx([0.0, -8.0])
    bound.reset()
    assert bound(rows, WINTER).terms["peak"] == pytest.approx([-4.0, -8.0])


def test_rewards__state_is_a_copy_and_an_empty_one_is_the_beginning() -> None:
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


def test_rewards__state_of_another_reward_and_other_slots_are_refused() -> None:
    bound = NormalizedReward().bind(NODE)
    with pytest.raises(InvalidConfig, match="has the state max_power_w, max_degrees, not month, peak_kw"):
        bound.restore({"month": 1, "peak_kw": 2})
    bound(np.array([values(), values()]), WINTER)
    with pytest.raises(InvalidConfig, match=r"leading shape \(2,\) expected, as before, got \(\)"):
        bound(values(), WINTER)
