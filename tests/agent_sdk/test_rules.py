"""The optional rules of `rbc`: margins, optimum start, demand limiting and price peaks."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.builders import actuator, manifest, meter, sensor, view
from support.controller_nodes import PEOPLE, ROOM, node

from zenostat.agent_sdk.controllers import Agent, RuleBasedController, load_controller, make_controller
from zenostat.agent_sdk.controllers.optimum_start import OptimumStart
from zenostat.agent_sdk.controllers.price_peaks import PricePeaks
from zenostat.agent_sdk.testing.fake_env import FakeEnv
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Manifest

MONDAY = datetime(2017, 1, 16)
QUARTER = timedelta(minutes=15)
WIDE = (actuator("heating_setpoint", 5.0, 30.0), actuator("cooling_setpoint", 10.0, 40.0))
OUTDOOR = sensor("outdoor", "Site Outdoor Air Drybulb Temperature", "Environment")
TARIFF: dict[str, Any] = {
    "kind": "occupied_cost", "gas_price": None, "threshold_kw": 0.0,
    "price": {
        "table": [{"value": 0.3, "hours": [12, 20], "weekdays": ["mon", "tue", "wed", "thu", "fri"]}],
        "otherwise": 0.1, "unit": "EUR/kWh",
    },
    "winter": (20.0, 24.0), "summer": (22.0, 26.0),
}  # fmt: skip


def office(reward: dict[str, Any] | None = None, meters: bool = True) -> Manifest:
    of = manifest(sensors=(ROOM, PEOPLE, OUTDOOR), actuators=WIDE, meters=[meter("electricity")] if meters else ())
    return of.model_copy(update={"task": of.task.model_copy(update={"reward": reward})})


def setpoints(rules: Any, of: Manifest, at: datetime, **values: float) -> tuple[float, float]:
    result = rules.act(view(of, at, **values))
    return result["heating_setpoint"], result["cooling_setpoint"]


# Fixed preconditioning


def test_rules__zones_are_comfortable_while_people_are_present_or_expected() -> None:
    of = office()
    rules = RuleBasedController(of, margin=0.5, setback=2.0, preconditioning=2.0)
    for day, hour, people, is_comfortable in (
        (0, 5.75, 0, False), (0, 6.0, 0, True), (0, 9.0, 3, True), (0, 12.0, 0, False), (0, 13.0, 1, True),
        (0, 20.0, 0, False), (1, 6.5, 0, False), (1, 6.75, 0, True), (1, 8.75, 0, True), (1, 9.0, 0, False),
        (2, 6.75, 0, True), (2, 10.0, 1, True), (3, 7.5, 0, False), (3, 7.75, 0, True), (4, 1.0, 2, True),
        (4, 22.5, 0, False), (4, 22.75, 0, True), (5, 0.75, 0, True), (5, 1.0, 0, False),
    ):  # fmt: skip
        expected = (20.5, 23.0) if is_comfortable else (18.0, 25.5)  # of 20 to 23.5 degC
        assert setpoints(rules, of, MONDAY + timedelta(days=day, hours=hour), people=people) == expected, (day, hour)


# Margins and setbacks


def test_rules__margins_and_setbacks_are_separate_and_margins_may_be_outside() -> None:
    of = office(TARIFF)  # 20 to 24 degC
    rules = RuleBasedController(of, heating_margin=-1.5, cooling_margin=0.5, heating_setback=4.0, cooling_setback=2.0)
    assert setpoints(rules, of, MONDAY.replace(hour=9), people=1.0) == (18.5, 23.5)
    assert setpoints(rules, of, MONDAY.replace(hour=23), people=0.0) == (16.0, 26.0)
    one = RuleBasedController(of, margin=0.25, heating_margin=-1.0)
    assert setpoints(one, of, MONDAY.replace(hour=9), people=1.0) == (19.0, 23.75)


def test_rules__margins_that_cross_meet_in_the_middle() -> None:
    of = office(TARIFF)
    rules = RuleBasedController(of, heating_margin=3.0, cooling_margin=2.0)  # 23 and 22
    assert setpoints(rules, of, MONDAY.replace(hour=9), people=1.0) == (22.5, 22.5)


def test_rules__empty_zones_are_not_kept_tighter_than_occupied_ones() -> None:
    of = office(TARIFF)
    rules = RuleBasedController(of, heating_margin=-3.0, cooling_margin=-3.0, setback=1.0)
    assert setpoints(rules, of, MONDAY.replace(hour=23), people=0.0) == (17.0, 27.0)


@given(
    margins=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
    amounts=st.lists(st.floats(0.0, 5.0), min_size=8, max_size=8),
    people=st.floats(0.0, 3.0),
    kwh=st.lists(st.floats(0.0, 100.0), min_size=3, max_size=3),
    hour=st.integers(0, 23),
)
def test_rules__heating_setpoint_is_never_above_the_cooling_setpoint(
    margins: tuple[float, float], amounts: list[float], people: float, kwh: list[float], hour: int
) -> None:
    of = office(TARIFF)
    names = ("heating_setback", "cooling_setback", "limit_cooling", "limit_heating")
    names += ("precooling", "preheating", "shed_cooling", "shed_heating")
    rules = RuleBasedController(
        of,
        heating_margin=margins[0],
        cooling_margin=margins[1],
        start_rate=1.0,
        **dict(zip(names, amounts, strict=True)),
    )
    for step, energy in enumerate(kwh):
        at = MONDAY + timedelta(hours=hour + 24 * step)
        heating, cooling = setpoints(rules, of, at, people=people, electricity=energy * 3.6e6, air=15.0 + 5 * step)
        assert heating <= cooling


# Occupancy


def test_rules__threshold_leaves_a_few_people_out() -> None:
    of = office(TARIFF)
    rules = RuleBasedController(of, occupancy_threshold=0.25, margin=0.0)
    day = MONDAY.replace(hour=12)
    assert setpoints(rules, of, day, people=8.0) == (20.0, 24.0)
    assert setpoints(rules, of, day + QUARTER, people=2.1) == (20.0, 24.0)
    assert setpoints(rules, of, day + 2 * QUARTER, people=2.0) == (14.0, 30.0)  # a quarter of 8


def test_rules__threshold_of_one_leaves_everybody_out() -> None:
    of = office(TARIFF)
    rules = RuleBasedController(of, occupancy_threshold=1.0, margin=0.0)
    assert setpoints(rules, of, MONDAY.replace(hour=7), people=0.0) == (20.0, 24.0)  # nobody has been seen yet
    for hour in (8, 12, 24 + 7, 24 + 12):
        assert setpoints(rules, of, MONDAY + timedelta(hours=hour), people=8.0) == (14.0, 30.0)
    assert setpoints(rules, of, MONDAY + timedelta(hours=36), people=0.0) == (14.0, 30.0)


# Optimum start


def arrived(rules: Any, of: Manifest) -> None:
    """Let people arrive on Monday in the timestep that begins at 8:00, and leave."""
    rules.act(view(of, MONDAY.replace(hour=8) + QUARTER, people=1.0, air=20.0))


def start_of_tuesday(
    rules: Any, of: Manifest, air: float, outdoor: float = 20.0, heating: bool = True
) -> datetime | None:
    """Return the time at which a setpoint of empty zones leaves its setback."""
    at = MONDAY + timedelta(hours=18)
    while at < MONDAY + timedelta(days=1, hours=8):
        low, high = setpoints(rules, of, at, people=0.0, air=air, outdoor=outdoor)
        if (low >= 20.0) if heating else (high <= 24.0):
            return at
        at += QUARTER
    return None


@pytest.mark.parametrize(("air", "hours"), [(19.0, 0.5), (18.0, 1.0), (16.0, 2.0), (10.0, 3.0)])
def test_rules__optimum_start_is_earlier_the_colder_the_zone_up_to_its_limit(air: float, hours: float) -> None:
    of = office(TARIFF)
    rules = RuleBasedController(of, margin=0.0, start_rate=2.0)
    arrived(rules, of)
    assert start_of_tuesday(rules, of, air) == MONDAY + timedelta(days=1, hours=8 - hours)


def test_rules__optimum_start_of_heating_is_earlier_when_it_is_cold_outdoors() -> None:
    of = office(TARIFF)
    rules = RuleBasedController(of, margin=0.0, start_rate=2.0, start_outdoor=0.05)
    arrived(rules, of)  # 2 K / 2 K/h + 0.05 h/K * 20 K
    assert start_of_tuesday(rules, of, 18.0, outdoor=0.0) == MONDAY + timedelta(days=1, hours=6)
    cooled = RuleBasedController(of, margin=0.0, start_rate=2.0, start_outdoor=0.05)
    arrived(cooled, of)
    assert start_of_tuesday(cooled, of, 26.0, outdoor=0.0, heating=False) == MONDAY + timedelta(days=1, hours=7)


def test_rules__zone_that_is_within_its_setpoints_is_not_started() -> None:
    of = office(TARIFF)
    rules = RuleBasedController(of, margin=0.0, start_rate=0.1)
    arrived(rules, of)
    assert start_of_tuesday(rules, of, 22.0) is None


def test_rules__start_holds_until_people_are_expected_and_ends_if_nobody_comes() -> None:
    of = office(TARIFF)
    rules = RuleBasedController(of, margin=0.0, start_rate=2.0)
    arrived(rules, of)
    begin = MONDAY + timedelta(days=1, hours=7)
    assert setpoints(rules, of, begin, people=0.0, air=18.0)[0] == 20.0
    assert setpoints(rules, of, begin + QUARTER, people=0.0, air=19.9)[0] == 20.0  # the lead is 3 minutes now
    assert setpoints(rules, of, begin + 4 * QUARTER, people=0.0, air=20.0)[0] == 20.0
    assert setpoints(rules, of, begin + 5 * QUARTER, people=0.0, air=20.0)[0] == 14.0


def test_rules__rate_is_learned_from_the_recovery() -> None:
    start = OptimumStart(rate=2.0, learning=0.5)
    expected = MONDAY.replace(hour=8)
    assert not start.is_started("heat", 4.0, 0.0, expected, MONDAY.replace(hour=5, minute=45))
    assert start.is_started("heat", 4.0, 0.0, expected, MONDAY.replace(hour=6))
    start.observe("heat", 1.0, MONDAY.replace(hour=7))
    assert start.rate_of("heat") == 2.0  # neither at its setpoint nor expected yet
    start.observe("heat", 0.0, MONDAY.replace(hour=7))  # 4 K in one hour
    assert start.rate_of("heat") == 3.0
    start.observe("heat", 0.0, MONDAY.replace(hour=8))
    assert start.rate_of("heat") == 3.0  # once for each recovery
    tuesday = expected + timedelta(days=1)
    assert start.is_started("heat", 6.0, 0.0, tuesday, tuesday - timedelta(hours=2))
    start.observe("heat", 4.0, tuesday)  # 2 K in two hours
    assert start.rate_of("heat") == 2.0
    start.begin()
    assert start.rate_of("heat") == 2.0


def test_rules__learned_start_of_the_fake_building_is_at_its_setpoint_when_people_come() -> None:
    """Its zones are one capacity each, so after some days the recovery ends close to 8 o'clock, and not before 6:30."""
    reward = {"kind": "occupied", "winter": (20.0, 24.0), "summer": (20.0, 24.0)}
    env = FakeEnv(zones=1, begin="2017-01-09", end="2017-01-13", steps_per_hour=12, reward=reward, control="building")
    rules = RuleBasedController(env.manifest, margin=0.0, setback=6.0, start_rate=20.0, start_learning=1.0)
    agent, late = Agent(rules, env), {}
    env.reset(seed=0)
    over = False
    while not over:
        *_, over, _ = env.step(agent.action(env.sample))
        now = env.sample.time
        if (now.hour, now.minute) == (8, 0):
            name = next(s.name for s in env.manifest.sensors if s.variable == "Zone Air Temperature")
            late[now.day] = 20.0 - env.sample[name]
    assert late[13] < 0.5


# Demand limiting


def test_rules__demand_limiting_raises_cooling_in_proportion_near_the_limit_and_releases_it_slowly() -> None:
    of = office(TARIFF)
    rules = RuleBasedController(of, margin=0.0, limit_kw=10.0, limit_start=0.8, limit_cooling=2.0, limit_heating=1.0)

    def after(kilowatts: float) -> tuple[float, float]:
        at = MONDAY.replace(hour=10)
        return setpoints(rules, of, at, people=1.0, electricity=kilowatts * 0.25 * 3.6e6)

    assert after(8.0) == (20.0, 24.0)
    assert after(9.0) == pytest.approx((19.5, 25.0))
    assert after(10.0) == pytest.approx((19.0, 26.0))
    assert after(0.0) == pytest.approx((19.125, 25.75))  # 1 K/h of the greater one
    for _ in range(7):
        last = after(0.0)
    assert last == pytest.approx((20.0, 24.0))


def test_rules__peak_so_far_is_the_limit_until_the_month_ends() -> None:
    of = office({**TARIFF, "threshold_kw": 4.0})
    rules = RuleBasedController(of, margin=0.0, limit_start=1.0, limit_cooling=2.0)

    def cooling(at: datetime, kilowatts: float) -> float:
        return setpoints(rules, of, at, people=1.0, electricity=kilowatts * 0.25 * 3.6e6)[1]

    begin = datetime(2017, 1, 31, 20)
    assert cooling(begin, 3.9) == 24.0  # below what is free of charge
    assert cooling(begin + QUARTER, 12.0) == 26.0
    for _ in range(8):
        cooling(begin + 2 * QUARTER, 0.0)
    assert cooling(begin + 3 * QUARTER, 11.0) == 24.0
    assert cooling(datetime(2017, 2, 1, 10), 11.0) == 26.0  # another month


def test_rules__demand_limiting_needs_a_meter() -> None:
    with pytest.raises(InvalidConfig, match=r"demand limiting needs the building's electricity: add the meter"):
        RuleBasedController(office(meters=False), limit_cooling=1.0)


# Prices


def test_rules__zones_are_precooled_before_high_prices_and_shed_during_them() -> None:
    of = office(TARIFF)
    rules = RuleBasedController(
        of, margin=0.0, precooling=2.0, preheating=1.0, price_lead=2.0, shed_cooling=1.5, shed_heating=0.5
    )

    def at(hour: float, people: float = 1.0) -> tuple[float, float]:
        return setpoints(rules, of, MONDAY + timedelta(hours=hour), people=people)

    assert at(9.75) == (20.0, 24.0)
    assert at(10.0) == (21.0, 22.0)
    assert at(11.75) == (21.0, 22.0)
    assert at(12.0) == (19.5, 25.5)
    assert at(19.75) == (19.5, 25.5)
    assert at(20.0) == (20.0, 24.0)
    assert at(22.0, people=0.0) == (14.0, 30.0)
    assert at(24 * 5 + 12.0) == (20.0, 24.0)  # Saturday


def test_rules__peak_of_the_next_day_is_seen_before_midnight() -> None:
    reward = {"kind": "tariff", "periods": [{"value": 2.0, "hours": [0, 3]}], "otherwise": 1.0, "unit": "EUR/kWh"}
    peaks = PricePeaks(office(reward), 1.5)
    assert [peaks.is_before_peak(MONDAY + timedelta(hours=h)) for h in (22.25, 22.5, 23.75, 0.5)] == [
        False, True, True, False,
    ]  # fmt: skip
    constant = {"kind": "energy_cost", "price": {"value": 1.0, "unit": "EUR/kWh"}}
    assert not any(PricePeaks(office(constant), 12.0).is_peak(MONDAY + timedelta(hours=h)) for h in range(24))


@pytest.mark.parametrize(
    ("arguments", "of", "message"),
    [
        ({"precooling": 1.0}, office(), "needs the price of electricity, which the reward of node 'office' does not"),
        ({"start_rate": 1.0, "start_outdoor": 0.1}, node(), "start_outdoor needs the outdoor temperature: add"),
        ({"start_rate": 0.0}, office(), "start_rate = 0.0; expected a number of at least 0.01"),
        ({"limit_cooling": -1.0}, office(), "limit_cooling = -1.0; expected a number of at least 0"),
        ({"limit_start": 1.5}, office(), "limit_start = 1.5; expected a number from 0 to 1"),
        ({"start_learning": 2}, office(), "start_learning = 2; expected a number from 0 to 1"),
        ({"heating_margin": "much"}, office(), "heating_margin = 'much'; expected a number"),
    ],
)
def test_rules__parameters_that_cannot_be(arguments: dict[str, Any], of: Manifest, message: str) -> None:
    with pytest.raises(InvalidConfig, match=message):
        make_controller(RuleBasedController, of, arguments)


# Controller files


def test_controller_file__is_a_bundled_controller_with_other_defaults(tmp_path: Any) -> None:
    path = tmp_path / "best.yaml"
    path.write_text("controller: rbc\nparameters: {margin: 0.25, setback: 4}\n")
    of = office(TARIFF)
    factory = load_controller(str(path))
    assert factory.__name__ == "RuleBasedController"
    night = MONDAY.replace(hour=23)
    assert setpoints(make_controller(factory, of, {}), of, night, people=0.0) == (16.0, 28.0)
    assert setpoints(make_controller(factory, of, {"setback": 1.0}), of, night, people=0.0) == (19.0, 25.0)
    with pytest.raises(InvalidConfig, match="RuleBasedController has no parameter 'marign'"):
        make_controller(factory, of, {"marign": 1.0})


MINE = "class Mine:\n    def __init__(self, manifest, *, a=1.0):\n        self.a = a\n    def act(self, sample): ...\n"


def test_controller_file__chooses_no_code(tmp_path: Any) -> None:
    (tmp_path / "mine.py").write_text("raise SystemExit('it ran')")
    path = tmp_path / "best.yaml"
    path.write_text(f"controller: {tmp_path}/mine.py:Mine\nparameters: {{a: 2.0}}\n")
    with pytest.raises(InvalidConfig, match=r"not a bundled one .*a file does not choose code: name it yourself, as"):
        load_controller(str(path))
    (tmp_path / "mine.py").write_text(MINE)
    factory: Any = load_controller(f"{tmp_path}/mine.py:Mine@{path}")
    assert make_controller(factory, office(), {}).a == 2.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("controller: rbc\nparameters: {marign: 1}\n", "no parameter 'marign'; did you mean 'margin'"),
        ("controller: rbc\nparamters: {}\n", "did you mean 'parameters'"),
        ("controller: rcb\n", r"names the controller 'rcb', which is not a bundled one"),
        ("study: s\ntrials: 3\n", "is a tuning file, not a controller file: use zenostat tune"),
    ],
)
def test_controller_file__bad_input_is_one_sentence(text: str, message: str, tmp_path: Any) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(InvalidConfig, match=message):
        load_controller(str(tmp_path / "c.yaml"))
