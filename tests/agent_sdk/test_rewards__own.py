"""Rewards of a user's own, and points that are missing or of another unit."""

import threading
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import meter, sensor
from support.rewards import NODE, SENSORS, SUMMER, WINTER, node_of, reward_config, values
from support.run_cli import run_python

from zenostat import rewards
from zenostat.agent_sdk.rewards import (
    BoundReward,
    CarbonReward,
    ExponentialReward,
    HourlyReward,
    LinearReward,
    MultiZoneReward,
    NormalizedReward,
    OccupiedReward,
    Outcome,
    PeakReward,
    RewardConfig,
    ThermalSensationReward,
    from_function,
    read_reward,
)
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.messages import Manifest

# Points that are missing or of another unit

BARE = node_of(sensor("outdoor", "Site Outdoor Air Drybulb Temperature"))
WARM = node_of(SENSORS[1], SENSORS[3], meters=[meter("water", "Water:Facility").model_copy(update={"unit": "m3"})])
UNBINDABLE: dict[str, tuple[RewardConfig, Manifest, str]] = {
    "no power": (ExponentialReward(), BARE, "the exponential reward needs the HVAC's power: .* 'HVAC:Elec"),
    "power of district cooling": (
        LinearReward(), node_of(SENSORS[1], meters=[meter("cold", "DistrictCooling:Facility")]),
        "of HVAC that needs no electricity, name other meters .* `power`; there are: 'cold'"),
    "power in two units": (LinearReward(power=("fans", "electricity")), NODE, "`power`, which is in W and J; name one"),
    "no zone": (PeakReward(energy="fans"), node_of(SENSORS[4]), "the peak reward needs .* 'Zone Air Temperature'"),
    "no energy": (PeakReward(), node_of(SENSORS[1]), "the peak reward needs the energy .*'Electricity:Facility' in m"),
    "unknown energy": (PeakReward(energy="elec"), NODE, "'elec', .* not have; did you mean 'electricity'"),
    "no energy's unit": (PeakReward(energy="north"), NODE, r"such as J or W, which 'north' is not \(degC\); there are"),
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
def test_rewards__point_that_is_missing_is_named_when_the_reward_is_bound(
    reward: RewardConfig, node: Manifest, words: str
) -> None:
    with pytest.raises(InvalidConfig, match=words):
        reward.bind(node)


def test_rewards__file_of_prices_is_read_when_the_reward_is_bound(tmp_path: Path) -> None:
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
def test_rewards__reward_that_cannot_be(kind: str, wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidConfig, match=next(iter(wrong))):
        reward_config(kind, **wrong)


# One's own


def saving(values: Mapping[str, Any], begin: datetime) -> dict[str, Any]:
    return {"energy": -values["power"] / 1000.0, "night": -1.0 if begin.hour < 6 else 0.0}


def test_rewards__function_is_a_reward() -> None:
    bound = read_reward(saving).bind(NODE)
    got = bound(values(power=2000.0), WINTER.replace(hour=3))
    assert got == Outcome(-3.0, {"energy": -2.0, "night": -1.0}, {})
    assert (bound.state(), type(got.terms["energy"])) == ({}, float)


def test_rewards__function_may_give_one_number() -> None:
    for function in (lambda v, b: -v["power"], lambda v, b: {"reward": -v["power"]}):
        got = from_function(function).bind(NODE)(values(power=2.0), WINTER)
        assert (got.reward, got.terms) == (-2.0, {"reward": -2.0})


def test_rewards__function_sees_arrays_where_there_are_slots() -> None:
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


def test_rewards__class_is_made_for_each_use_and_may_remember() -> None:
    reward = read_reward(Counting)
    first, second = reward.bind(NODE), reward.bind(NODE)
    assert [first(values(), WINTER).reward for _ in range(3)] == [-1.0, -2.0, -3.0]
    assert second(values(), WINTER).reward == -1.0
    second.restore(first.state())
    assert second(values(), WINTER).reward == -4.0
    second.reset()
    assert second(values(), WINTER).reward == -1.0
    assert read_reward(Counting()).bind(NODE)(values(), WINTER).reward == -1.0


class Change:
    """Reward constant temperatures; without `state()`, its attributes are its state."""

    def __init__(self) -> None:
        self.history: list[float] = []
        self.sensors = object()

    def __call__(self, values: Mapping[str, Any], begin: datetime) -> float:
        self.history.append(values["north"])
        return -float(len(self.history))

    def reward(self, values: Mapping[str, Any], begin: datetime) -> float:
        return self(values, begin)


@pytest.mark.parametrize("make", [lambda: Change, lambda: Change().reward], ids=["class", "method"])
def test_rewards__attributes_of_a_class_without_a_state_are_copied(make: Any) -> None:
    first, second = read_reward(make()).bind(NODE), read_reward(make()).bind(NODE)
    assert [first(values(), WINTER).reward for _ in range(3)] == [-1.0, -2.0, -3.0]
    kept = first.state()
    assert first(values(), WINTER).reward == -4.0
    second.restore(kept)
    first.restore(kept)
    assert [first(values(), WINTER).reward, first(values(), WINTER).reward] == [-4.0, -5.0]
    assert second(values(), WINTER).reward == -4.0


def test_rewards__attributes_that_cannot_be_copied_are_named() -> None:
    class Locked:
        def __init__(self) -> None:
            self.lock = threading.Lock()

        def __call__(self, values: Mapping[str, Any], begin: datetime) -> float:
            return 0.0

    with pytest.raises(InvalidConfig, match=r"attributes of Locked cannot be copied .*state\(\) and restore\(state\)"):
        read_reward(Locked).bind(NODE).state()


def test_rewards__what_can_be_bound_is_taken_as_it_is() -> None:
    linear = LinearReward()
    assert read_reward(linear) is linear
    assert read_reward(LinearReward) == linear

    class Own:
        def bind(self, manifest: Manifest) -> BoundReward:
            return linear.bind(manifest)

    assert isinstance(read_reward(Own), Own)


@pytest.mark.parametrize("wrong", [5, None, [1], 2.5], ids=str)
def test_rewards__what_is_no_reward(wrong: Any) -> None:
    with pytest.raises(InvalidConfig, match=r"reward: a kind \(linear, .*expected, got"):
        read_reward(wrong)


class Needy:
    def __init__(self, weight: float) -> None:
        self.weight = weight

    def __call__(self, values: Mapping[str, Any], begin: datetime) -> float:
        return -self.weight


class Forgetful:
    """A reward whose `reset` does not ask for the slots."""

    def reset(self) -> None: ...

    def __call__(self, values: Mapping[str, Any], begin: datetime) -> float:
        return 1.0


def test_rewards__function_or_class_that_does_not_fit() -> None:
    for function in (lambda: 0.0, lambda v: 0.0, lambda v, b, more: 0.0, type("Silent", (), {}), object):
        with pytest.raises(InvalidConfig, match=r"should take \(values, begin\)"):
            read_reward(function)
    for reward in (Forgetful, Forgetful(), partial(Forgetful)):
        with pytest.raises(InvalidConfig, match=r"Forgetful\.reset should take \(slots\): too many positional"):
            read_reward(reward)
    with pytest.raises(InvalidConfig, match=r"Needy cannot be instantiated without arguments .*'weight'"):
        read_reward(Needy).bind(NODE)
    with pytest.raises(InvalidConfig, match="CarbonReward cannot be instantiated without arguments"):
        read_reward(CarbonReward)


@pytest.mark.parametrize("term", [float("nan"), float("inf"), None, "much", "1.0", [1.0, 2.0]], ids=str)
def test_rewards__term_that_is_no_number(term: Any) -> None:
    for gives in (term, {"comfort": term}):
        name = "comfort" if isinstance(gives, dict) else "reward"
        with pytest.raises(InvalidConfig, match=f"returned .* for '{name}'; a finite number expected"):
            read_reward(lambda v, b, gives=gives: gives).bind(NODE)(values(), WINTER)


def test_rewards__function_that_returns_a_reward_and_its_terms() -> None:
    pair = (-1.0, {"energy": -1.0})
    with pytest.raises(InvalidConfig, match=r"a finite number expected, or a mapping of terms to numbers$"):
        read_reward(lambda v, b: pair).bind(NODE)(values(), WINTER)
    with pytest.raises(InvalidConfig, match=r"for 'comfort'; a finite number expected$"):
        read_reward(lambda v, b: {"comfort": pair}).bind(NODE)(values(), WINTER)


def test_rewards__function_without_terms() -> None:
    with pytest.raises(InvalidConfig, match="returned no terms; a number for each of them expected"):
        read_reward(lambda v, b: {}).bind(NODE)(values(), WINTER)


def asks_for_norht(values: Mapping[str, Any], begin: datetime) -> float:
    return -float(values["norht"])


@pytest.mark.parametrize("slots", [None, 2])
def test_rewards__function_that_asks_for_a_point_that_is_not_there(slots: int | None) -> None:
    observation = values() if slots is None else np.array([values()] * slots)
    with pytest.raises(UnknownName, match=r"asks_for_norht reads 'norht', .*did you mean 'north'") as raised:
        read_reward(asks_for_norht).bind(NODE)(observation, WINTER if slots is None else [WINTER] * slots)
    assert isinstance(raised.value.__cause__, KeyError)


def test_rewards__function_may_look_whether_a_point_is_there() -> None:
    def careful(values: Mapping[str, Any], begin: datetime) -> float:
        try:
            return float(values["norht"])
        except KeyError:
            return values.get("norht", -1.0) - ("norht" in values)

    assert read_reward(careful).bind(NODE)(values(), WINTER).reward == -1.0


@pytest.mark.parametrize("error", [KeyError("tariff"), ZeroDivisionError("by nothing"), InvalidConfig("mine")], ids=str)
def test_rewards__other_exceptions_of_a_function_are_its_own(error: Exception) -> None:
    def broken(values: Mapping[str, Any], begin: datetime) -> float:
        raise error

    with pytest.raises(type(error)) as raised:
        read_reward(broken).bind(NODE)(values(), WINTER)
    assert raised.value is error
    assert error.__notes__ == ["in the reward broken"]


@pytest.mark.slow
def test_rewards__example() -> None:
    example = Path(__file__).parents[2] / "examples" / "own_reward.py"
    done = run_python(str(example), timeout=120)
    assert done.returncode == 0, done.stderr
    own, steady = done.stdout.splitlines()
    assert own.startswith("cool_and_cheap: energy -")
    assert ", comfort -" in own
    assert steady.startswith("Steady: reward -")


def test_rewards__what_is_offered_is_there() -> None:
    assert [name for name in rewards.__all__ if not hasattr(rewards, name)] == []


def test_own_reward__partial_of_a_class_is_instantiated_for_each_environment() -> None:
    class Count:
        def __init__(self, weight: float) -> None:
            self.weight, self.calls = weight, 0

        def __call__(self, values: Mapping[str, float], begin: datetime) -> float:
            self.calls += 1
            return self.weight * self.calls

    reward = read_reward(partial(Count, 0.5))
    for _ in range(2):
        bound = reward.bind(NODE)
        assert [bound(values(), SUMMER)[0] for _ in range(3)] == [0.5, 1.0, 1.5]
    assert isinstance(read_reward(partial(LinearReward, weight=0.25)), LinearReward)
    with pytest.raises(InvalidConfig, match="reward: Count cannot be instantiated without arguments"):
        read_reward(Count).bind(NODE)
