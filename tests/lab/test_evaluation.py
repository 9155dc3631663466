"""Metrics of an episode, against numbers worked out by hand; and controllers compared on a made-up building."""

import math
import re
import sys
from collections.abc import Callable
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.wrappers import MaxAndSkipObservation, RepeatAction, TimeLimit
from support.builders import actuator, manifest, meter, own_action, sensor
from support.run_cli import run_in_process

from zenostat.agent_sdk.controllers import Agent, Controller, FixedSetpoints, RandomController, RuleBasedController
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.rewards import LinearReward, MultiZoneReward, OccupiedReward, read_reward
from zenostat.agent_sdk.testing import Climate, FakeBuilding, FakeLink
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.runtime.signals import Terminated
from zenostat.lab.evaluate import EpisodeRecord, Evaluation, evaluate, run_episode, without_actuators
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.messages import Aggregation, Manifest, Meter, Sample, Sensor, Task
from zenostat.topics.points import value_index

BEGIN = datetime(2017, 7, 1)
KWH = 3.6e6
NAN = float("nan")


def view(of: Manifest, step: int, values: list[float], *, late: int = 0, rejected: int = 0) -> SampleView:
    """A sample at the end of quarter of an hour number `step`."""
    wire = Sample(
        episode=[0],
        step=[step],
        time=[(BEGIN + step * timedelta(minutes=15)).isoformat()],
        elapsed_s=[900.0 * step],
        flags=[0],
        values=np.array(values, "<f8").tobytes(),
        effective=bytes(8 * len(of.actuators)),
        source_index=bytes(2 * len(of.actuators)),
        sources=[""],
        late=late,
        rejected=rejected,
    )
    return SampleView(wire, of, value_index(of))


def tallied(of: Manifest, *rows: list[float], reward: Any = None, terms: Any = None) -> EpisodeMetrics:
    tally = MetricsAccumulator(of, reward)
    tally.add(view(of, 0, [1e9] * len(of.names)))  # no energy or comfort of a timestep
    for step, row in enumerate(rows, 1):
        tally.add(view(of, step, row), terms)
    return tally.result()


def rewarded(kind: str = "linear", **parameters: Any) -> Task:
    return Task(actions=(own_action(actuator("cool", 22.5, 30.0)),), reward={"kind": kind, **parameters})


OFFICE = manifest(
    sensors=[sensor("core"), sensor("south"), sensor("core_people", "Zone People Occupant Count", "core", "count")],
    meters=[
        meter("electricity"),
        meter("hvac", "HVAC:Electricity"),
        meter("gas", "NaturalGas:Facility"),
        meter("heat", "DistrictHeatingWater:Facility"),
        meter("produced", "ElectricityProduced:Facility"),
    ],
    actuators=[actuator("cool", 22.5, 30.0)],
    task=rewarded(),
)


def test_evaluation__episode_by_hand() -> None:
    # The band of July is 23 to 26 degC. Each timestep has a quarter of an hour.
    result = tallied(
        OFFICE,
        [27.0, 22.5, 3.0, 1.0 * KWH, 0.5 * KWH, 2.0 * KWH, 0.1 * KWH, 9.0 * KWH],  # 1 K and 0.5 K outside
        [26.0, 23.0, 0.0, 3.0 * KWH, 1.5 * KWH, 0.0 * KWH, 0.1 * KWH, 9.0 * KWH],  # both on the ends: inside
        [28.0, 24.0, 0.0, 2.0 * KWH, 1.0 * KWH, 1.0 * KWH, 0.1 * KWH, 9.0 * KWH],  # 2 K outside, nobody there
        [24.0, 24.0, 0.0, 0.0 * KWH, 0.0 * KWH, 0.0 * KWH, 0.1 * KWH, 9.0 * KWH],
        terms={"energy": -0.5, "comfort": -0.25},
    )
    assert result.steps == 4
    assert result.reward == -3.0
    assert result.terms == {"energy": -2.0, "comfort": -1.0}
    assert result.energy_kwh == pytest.approx({"electricity": 6.0, "natural_gas": 3.0, "district_heating_water": 0.4})
    assert result.hvac_electricity_kwh == pytest.approx(3.0)
    assert result.mean_power_w == pytest.approx(6000.0)  # 6 kWh in an hour
    assert result.peak_kw == pytest.approx(12.0)  # 3 kWh in a quarter of an hour
    assert result.mean_deviation_k == pytest.approx((1.0 + 0.5 + 2.0) / (2 * 4))
    assert result.outside_percent == pytest.approx(50.0)
    assert result.outside_kh == pytest.approx(3.5 * 0.25)
    assert result.occupied_outside_kh == pytest.approx((1.0 + 0.5) * 0.25)  # the south's people are not measured
    metrics = result.metrics()
    assert metrics["mean_reward"] == pytest.approx(-0.75)
    assert metrics["mean_reward.comfort"] == pytest.approx(-0.25)
    assert metrics["natural_gas_kwh"] == pytest.approx(3.0)
    sources = MetricsAccumulator(OFFICE).sources
    assert {name: source for name, source in sources.items() if not name.startswith("kpi.")} == {
        "electricity_kwh": "meter Electricity:Facility",
        "natural_gas_kwh": "meter NaturalGas:Facility",
        "district_heating_water_kwh": "meter DistrictHeatingWater:Facility",
        "hvac_electricity_kwh": "meter HVAC:Electricity",
        "electricity_produced_kwh": "meter ElectricityProduced:Facility",
        "mean_power_w": "meter Electricity:Facility",
        "peak_kw": "meter Electricity:Facility",
        "mean_deviation_k": "2 zones, the band of the linear reward",
    }


def test_evaluation__generation_is_no_energy_that_the_building_uses() -> None:
    """4 kWh are used and 5 produced, of which 2 are sold: 1 is bought."""
    meters = [
        meter("electricity"),
        meter("produced", "ElectricityProduced:Facility"),
        meter("bought", "ElectricityPurchased:Facility"),
        meter("electricity_sold", ""),
    ]
    of = manifest(sensors=[], meters=meters).model_copy(update={"floor_area_m2": 10.0})
    result = tallied(of, [3.0 * KWH, 2.0 * KWH, 1.0 * KWH, 0.0], [1.0 * KWH, 3.0 * KWH, 0.0, 2.0 * KWH])
    generation = {"electricity_produced": 5.0, "electricity_purchased": 1.0, "electricity_sold": 2.0}
    assert result.generation_kwh == pytest.approx(generation)
    assert result.energy_kwh == pytest.approx({"electricity": 4.0})
    assert (result.site_kwh_m2, result.peak_kw) == (pytest.approx(0.4), pytest.approx(12.0))
    assert result.peak_purchased_kw == pytest.approx(4.0)  # 1 kWh in a quarter of an hour
    assert result.metrics()["electricity_sold_kwh"] == pytest.approx(2.0)


@pytest.mark.parametrize("aggregation", [Aggregation.INSTANT, Aggregation.MEAN])
def test_evaluation__without_meters_power_times_the_timestep_counts_and_is_called_so(aggregation: Aggregation) -> None:
    power = sensor("demand", "Facility Total HVAC Electricity Demand Rate", "Whole Building", "W")
    of = manifest(sensors=[sensor("core"), power.model_copy(update={"aggregation": aggregation})])
    result = tallied(of, [24.0, 1000.0], [24.0, 3000.0])
    assert result.hvac_electricity_kwh == pytest.approx(1.0)  # 4000 W for a quarter of an hour
    assert result.energy_kwh == {}
    assert result.metrics()["electricity_kwh"] is None
    assert (result.mean_power_w, result.peak_kw) == (pytest.approx(2000.0), pytest.approx(3.0))
    source = MetricsAccumulator(of).sources["mean_power_w"]
    assert source.startswith("sensor demand, W times the timestep")
    assert ("approximation" in source) == (aggregation is Aggregation.INSTANT)


def test_evaluation__what_a_scenario_does_not_tell_is_absent() -> None:
    of = manifest(sensors=[sensor("outdoors", "Site Outdoor Air Drybulb Temperature")])
    result = tallied(of, [30.0])
    known = {name: value for name, value in result.metrics().items() if value is not None}
    assert known == {"steps": 1, "late": 0, "rejected": 0, "terminated": 0.0, "kpi.idis_tot": 0.0}
    assert MetricsAccumulator(of).sources == {}


def test_evaluation__without_a_timestep_nothing_is_known() -> None:
    result = tallied(OFFICE)
    assert (result.steps, result.reward, result.energy_kwh) == (0, None, {})
    assert (result.mean_power_w, result.peak_kw, result.mean_deviation_k, result.outside_percent) == (None,) * 4


@pytest.mark.parametrize(
    ("task", "reward", "degrees"),
    [
        (rewarded(summer=[20.0, 25.0]), None, [2.0, 0.0]),
        (rewarded(summer=[20.0, 25.0], temperatures=["south"]), None, [0.0]),
        (rewarded(), LinearReward(summer=(24.0, 30.0)), [0.0, 1.5]),  # one's own goes before the scenario's
        (rewarded(), read_reward(lambda values, begin: 0.0), [1.0, 0.5]),  # it has no band: the scenario's
        (rewarded("occupied"), None, [1.0]),  # zones whose people nobody counts are not in that reward
        (rewarded(), OccupiedReward(), [1.0]),
        (Task(), None, None),
        (rewarded("somebody's"), None, None),
        (rewarded(temperatures=["north"]), None, None),
    ],
)
def test_evaluation__band_is_that_of_the_reward(task: Task, reward: Any, degrees: list[float] | None) -> None:
    of = OFFICE.model_copy(update={"task": task})
    result = tallied(of, [27.0, 22.5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0], reward=reward)
    if degrees is None:
        assert (result.mean_deviation_k, result.outside_percent, result.outside_kh) == (None,) * 3
    else:
        assert result.mean_deviation_k == pytest.approx(math.fsum(degrees) / len(degrees))
        assert result.outside_percent == (100.0 if any(degrees) else 0.0)


OWN_SETPOINTS = manifest(
    sensors=[
        sensor("core"),
        sensor("h", "Zone Thermostat Heating Setpoint Temperature", "core"),
        sensor("c", "Zone Thermostat Cooling Setpoint Temperature", "core"),
    ]
)


def test_evaluation__zones_with_setpoints_of_their_own() -> None:
    result = tallied(OWN_SETPOINTS, [26.0, 21.0, 24.0], [22.0, 21.0, 24.0], reward=MultiZoneReward(threshold=0.5))
    assert result.mean_deviation_k == pytest.approx(1.5 / 2)


def test_evaluation__setpoint_that_is_not_in_use_is_no_limit() -> None:
    """A thermostat for heating only in winter and for cooling only in summer reports 0 for the other setpoint."""
    winter, summer = [18.0, 21.0, 0.0], [25.0, 0.0, 24.0]
    result = tallied(OWN_SETPOINTS, winter, summer, reward=MultiZoneReward(threshold=0.0))
    assert result.mean_deviation_k == pytest.approx((3.0 + 1.0) / 2)
    assert result.kpis["tdis_tot"] == pytest.approx((3.0 / 2 + 1.0 / 2) * 0.25)  # within its limit at the begin of each


def test_evaluation__discomfort_of_a_timestep_is_by_its_own_setpoints_at_both_ends() -> None:
    """The thermal discomfort of BOPTEST's KPIs, where the setpoints of the next timestep differ."""
    tally = MetricsAccumulator(OWN_SETPOINTS, MultiZoneReward(threshold=0.0))
    for step, row in enumerate(([18.0, 15.0, 30.0], [20.0, 21.0, 24.0])):
        tally.add(view(OWN_SETPOINTS, step, row))
    assert tally.result().kpis["tdis_tot"] == pytest.approx((3.0 + 1.0) / 2 * 0.25)  # below 21 degC


def test_evaluation__messages_that_were_refused_in_this_episode_and_a_second_one() -> None:
    tally = MetricsAccumulator(OFFICE)
    row = [24.0, 24.0, 0.0, KWH, 0.0, 0.0, 0.0, 0.0]
    tally.add(view(OFFICE, 0, row, late=7, rejected=2))
    tally.add(view(OFFICE, 1, row, late=9, rejected=2))
    assert (tally.result().late, tally.result().rejected) == (2, 0)
    tally.add(view(OFFICE, 0, row, late=9, rejected=3))
    tally.add(view(OFFICE, 1, row, late=9, rejected=4))
    result = tally.result(terminated=True)
    assert (result.late, result.rejected, result.steps, result.terminated) == (0, 1, 1, True)
    assert result.energy_kwh["electricity"] == pytest.approx(1.0)


# The spread


def result(reward: float | None) -> EpisodeMetrics:
    return EpisodeMetrics(1, reward, {}, {}, {}, None, None, None, None, None, None, 0, 0, terminated=False)


def test_evaluation__mean_standard_deviation_and_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluation = Evaluation(
        tuple(EpisodeRecord("rbc", k, k, "", result(value)) for k, value in enumerate((1.0, 2.0, 6.0))), {}
    )
    spread = evaluation.summary()["rbc"]["reward"]
    assert (spread.count, spread.mean, spread.deviation) == (3, 3.0, pytest.approx(math.sqrt(7.0)))
    assert "mean_power_w" not in evaluation.summary()["rbc"]
    pytest.importorskip("scipy")
    # Student's t for two degrees of freedom: 4.302653 (any table of it).
    half = 4.302653 * math.sqrt(7.0 / 3.0)
    assert spread.interval == pytest.approx((3.0 - half, 3.0 + half))
    monkeypatch.setitem(sys.modules, "scipy.stats", None)
    assert evaluation.summary()["rbc"]["reward"].interval is None
    alone = Evaluation(evaluation.rows[:1], {}).summary()["rbc"]["reward"]
    assert (alone.deviation, alone.interval) == (None, None)


# Controllers compared


def building(**arguments: Any) -> dict[str, Any]:
    """A made-up building with noise on its weather, as arguments of an environment."""
    fake = FakeBuilding(zones=2, begin="07-03", end="07-03", climate=Climate(noise_k=2.0), **arguments)
    return {"link": FakeLink(fake)}


def test_evaluation__same_call_gives_the_same_tables_and_the_same_seeds_to_all() -> None:
    controllers = {"rbc": "rbc", "warm": partial(FixedSetpoints, zone_1_cooling_setpoint=29.0), "random": "random"}
    evaluation = evaluate(building(), controllers, episodes=2, seed=5)
    assert [(row.controller, row.episode, row.seed) for row in evaluation.rows] == [
        (name, k, 5 + k) for name in controllers for k in range(2)
    ]
    table = evaluation.table()
    assert all(list(row) == list(table[0]) for row in table)
    assert table[0]["reward"] != table[1]["reward"]  # other weather
    assert evaluate(building(), controllers, episodes=2, seed=5).table() == table
    # What a controller comes to does not depend on the others, nor on their order.
    alone = evaluate(building(), ["random"], episodes=2, seed=5).table()
    assert [{name: row[name] for name in alone[0]} for row in table[4:]] == alone
    assert evaluate(building(), ["random"], episodes=2, seed=6).table()[0] != table[4]


def test_evaluation__sum_of_an_episode_is_that_of_the_environment() -> None:
    (row,) = evaluate(building(), ["rbc"], seed=3).rows
    with BuildingEnv(**building()) as env:
        agent, rewards, ended = Agent(RuleBasedController(env.manifest)), [], False
        env.reset(seed=3)
        while not ended:
            _, reward, _, ended, _ = env.step(agent.action(env.sample))
            rewards.append(reward)
    assert row.result.reward == pytest.approx(math.fsum(rewards), rel=1e-12)
    assert row.result.steps == len(rewards)


@pytest.mark.parametrize("wrap", [lambda env: RepeatAction(env, 4), lambda env: MaxAndSkipObservation(env, 5)])
def test_run_episode__repeated_actions_count_in_each_timestep(wrap: Callable[[Any], Any]) -> None:
    """A constant action leads to the same episode, whether a wrapper repeats it or not."""
    results, steps = [], []
    for kind in (lambda env: env, wrap, lambda env: TimeLimit(wrap(TimeLimit(env, 1000)), 1000)):
        with BuildingEnv(**building()) as bare:
            env = kind(bare)
            results.append(run_episode(env, lambda _: [20.0, 25.0] * 2, seed=3, progress=steps.append)[0])
            observation, _ = env.reset(seed=3)
            assert observation.shape == bare.observation_space.shape
    assert results[0].reward is not None
    assert results[0].steps == 96
    assert results == results[:1] * 3
    assert steps == [*range(1, 97)] * 3


class Exits(Controller):
    """A controller that ends the program, as argparse does, in `__init__` or in `act`."""

    def __init__(self, manifest: Manifest, *, at_once: bool = False, end: type[SystemExit] = SystemExit) -> None:
        super().__init__(manifest)
        self._end = end
        if at_once:
            raise SystemExit(0)

    def act(self, sample: SampleView) -> dict[str, float]:
        raise self._end(0)


@pytest.mark.parametrize("at_once", [True, False])
def test_evaluation__controller_that_ends_the_program_is_an_error(*, at_once: bool) -> None:
    with pytest.raises(InvalidConfig, match=r"ended the program: test_evaluation\.py, line \d+: SystemExit: 0"):
        evaluate(building(), {"exits": partial(Exits, at_once=at_once)})


class Broken(Controller):
    """A controller whose code raises an error in its first step."""

    def act(self, sample: SampleView) -> dict[str, float]:
        return {"zone_1_cooling_setpoint": 24.0 / sample.step}


class Answers(Controller):
    """A controller that commands a prescribed value from its third step on."""

    def __init__(self, manifest: Manifest, *, value: Any) -> None:
        super().__init__(manifest)
        self._value = value

    def act(self, sample: SampleView) -> dict[str, Any]:
        values = dict.fromkeys((actuator.name for actuator in self.manifest.actuators), 22.5)
        return values | {"zone_1_cooling_setpoint": 22.5 if sample.step < 2 else self._value}


@pytest.mark.parametrize("value", [math.inf, math.nan, "24"])
def test_evaluation__value_that_is_no_finite_number_is_a_failure_of_the_controller(value: object) -> None:
    evaluation = evaluate(building(), {"answers": partial(Answers, value=value), "rbc": "rbc"})
    assert evaluation.unfit == {}
    shown = value if isinstance(value, float) else repr(value)
    text = f"Answers, step 2: zone_1_cooling_setpoint = {shown}; a finite number or None (relinquish) expected"
    assert evaluation.failures == {"answers": text}


def test_evaluation__commands_that_no_action_can_express_do_not_fit_the_scenario() -> None:
    evaluation = evaluate(building(), {"answers": partial(Answers, value=None), "rbc": "rbc"})
    assert evaluation.failures == {}
    assert evaluation.unfit["answers"].startswith("the controller leaves 'zone_1_cooling_setpoint' to baseline control")


def test_evaluation__other_controllers_run_after_one_that_fails() -> None:
    evaluation = evaluate(building(), {"exits": Exits, "rbc": "rbc", "broken": Broken}, trace=True)
    assert evaluation.rows == evaluate(building(), ["rbc"]).rows
    assert list(evaluation.failures) == ["exits", "broken"]
    assert re.search(r"ended the program: test_evaluation\.py, line \d+: SystemExit: 0", evaluation.failures["exits"])
    assert re.match(r"test_evaluation\.py, line \d+: ZeroDivisionError: ", evaluation.failures["broken"])
    assert list(evaluation.traces) == ["rbc"]
    assert list(evaluation.comparison().unfit) == ["exits", "broken"]
    with pytest.raises(ZeroDivisionError):
        evaluate(building(), {"broken": Broken})


def test_evaluate_command__names_what_failed_and_ends_with_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluation = evaluate(building(), {"rbc": "rbc", "broken": Broken})
    monkeypatch.setattr("zenostat.lab.evaluate.evaluate", lambda *_, **__: evaluation)
    done = run_in_process("evaluate", "some-id", "--controller", "rbc", "--controller", "broken")
    assert done.returncode == 1
    assert "failed: broken: test_evaluation.py, line" in done.stderr
    assert "rbc" in done.stdout


def test_evaluation__signal_ends_the_program_also_within_a_controller() -> None:
    with pytest.raises(Terminated):
        evaluate(building(), {"exits": partial(Exits, end=Terminated)})


def test_evaluation__limit_that_is_broken_ends_the_episode() -> None:
    limit = {"points": ["zone_1_air_temperature"], "high": 26.5}
    (row,) = evaluate(building(terminate=[limit]), {"hot": partial(FixedSetpoints, zone_1_cooling_setpoint=30.0)}).rows
    assert row.result.terminated
    assert 0 < row.result.steps < 96


def test_evaluation__progress_tells_each_timestep() -> None:
    progress: list[tuple[str, int, int, int]] = []
    evaluate(building(steps_per_hour=1), ["rbc"], episodes=2, progress=lambda *now: progress.append(now))
    assert progress == [("rbc", k, step, 24) for k in range(2) for step in range(1, 25)]


def test_evaluation__parameters_go_to_those_that_take_them() -> None:
    parameters: dict[str, dict[str, Any]] = {}

    def maker(name: str) -> Any:
        class Recording(FixedSetpoints):
            def __init__(self, manifest: Manifest, *, margin: float = 0.0, seed: int = -1, **values: float) -> None:
                parameters[name] = {"margin": margin, "seed": seed, **values}
                super().__init__(manifest, **values)

        return Recording

    evaluate(
        building(),
        {"mine": maker("mine"), "bound": partial(maker("bound"), seed=9), "noise_parameters": RandomController},
        seed=4,
        parameters={"margin": 0.5, "zone_2_cooling_setpoint": 27.0},
    )
    same = {"margin": 0.5, "zone_2_cooling_setpoint": 27.0}
    assert parameters == {"mine": {**same, "seed": 4}, "bound": {**same, "seed": 9}}


@pytest.mark.parametrize(
    ("controllers", "arguments", "error", "message"),
    [
        ([], {}, InvalidConfig, "expected a list of names"),
        ("rbc", {}, InvalidConfig, "expected a list of names, such as"),
        (["rbc", "rbc"], {}, InvalidConfig, "rbc is listed twice"),
        ({"": "rbc"}, {}, InvalidConfig, "controllers: '' is no name"),
        ({"a\nb\x07": "rbc"}, {}, InvalidConfig, "is no name: a text without control characters"),
        (["rbc", "rcb"], {}, UnknownName, "no controller 'rcb'"),
        (["rbc"], {"parameters": {"mergin": 1}}, InvalidConfig, "did you mean 'margin'"),
        (["rbc", "setback"], {"parameters": {"margin": -1}}, InvalidConfig, "margin = -1"),
        (["rbc"], {"episodes": 0}, InvalidConfig, "at least one episode"),
        (["rbc"], {"seed": -1}, InvalidConfig, "a seed of at least 0"),
        (["nothing.zip"], {}, InvalidConfig, "the algorithm of nothing.zip is missing"),
    ],
)
def test_evaluate__reports_errors_before_anything_runs(
    controllers: Any, arguments: dict[str, Any], error: type[Exception], message: str
) -> None:
    if "nothing.zip" in controllers:
        pytest.importorskip("stable_baselines3")
    progress: list[Any] = []
    with pytest.raises(error, match=message):
        evaluate(building(), controllers, progress=lambda *now: progress.append(now), **arguments)
    assert progress == []


def test_evaluate__reports_the_last_controllers_error_before_the_first_one_runs() -> None:
    class Picky(Controller):
        def __init__(self, manifest: Manifest) -> None:
            raise InvalidConfig("not here")

        def act(self, sample: SampleView) -> dict[str, float | None]:
            return {}

    progress: list[Any] = []
    with pytest.raises(InvalidConfig, match="not here"):
        evaluate(building(), {"rbc": "rbc", "picky": Picky}, progress=lambda *now: progress.append(now))
    assert progress == []


def test_evaluation__what_faults_do_to_points_does_not_count() -> None:
    """Metrics are of the building, as rewards are: a point that was dropped has the value that EnergyPlus gave."""
    values = [22.0, 30.0, 1.0, KWH, KWH, 0.0, 0.0, 0.0]
    disturbed = view(OFFICE, 1, [NAN] * len(values))
    disturbed.message = disturbed.message.model_copy(update={"fault_free_values": np.array(values, "<f8").tobytes()})
    tally, plain = MetricsAccumulator(OFFICE, None), MetricsAccumulator(OFFICE, None)
    for accumulator, last in ((tally, disturbed), (plain, view(OFFICE, 1, values))):
        accumulator.add(view(OFFICE, 0, values))
        accumulator.add(last)
    assert tally.result() == plain.result()


def test_evaluation__peak_of_a_building_that_always_exports_is_its_smallest_export() -> None:
    exported = [[24.0, 24.0, 0.0, -kwh * KWH, 0.0, 0.0, 0.0, 0.0] for kwh in (3.0, 2.0, 5.0)]
    assert tallied(OFFICE, *exported).peak_kw == pytest.approx(-8.0)  # 2 kWh in a quarter of an hour


def test_evaluation__unknown_values_make_what_depends_on_them_unknown() -> None:
    known = [27.0, 24.0, 0.0, KWH, KWH, 0.0, 0.0, 0.0]
    result = tallied(OFFICE, known, [NAN, 24.0, 0.0, NAN, KWH, 0.0, 0.0, 0.0], known)
    assert np.isnan([result.energy_kwh["electricity"], result.peak_kw, result.outside_percent]).all()
    assert result.hvac_electricity_kwh == pytest.approx(3.0)
    one_is_outside = tallied(OFFICE, known, [NAN, 30.0, 0.0, KWH, KWH, 0.0, 0.0, 0.0])
    assert one_is_outside.outside_percent == 100.0


def test_evaluation__occupants_of_a_plant_are_found_by_name() -> None:
    points = [Sensor(name="hall_air_temperature", unit="degC"), Sensor(name="hall_occupants", unit="count")]
    task = rewarded(temperatures=["hall_air_temperature"], power=["power"])
    of = manifest(sensors=[*points, Sensor(name="power", unit="W")], task=task)
    result = tallied(of, [28.0, 0.0, 0.0], [29.0, 2.0, 0.0])  # 2 and 3 K outside, people in the second
    assert (result.outside_kh, result.occupied_outside_kh) == pytest.approx((5.0 * 0.25, 3.0 * 0.25))


def test_evaluation__meters_of_a_plant_are_named_as_the_metrics() -> None:
    of = manifest(
        sensors=[sensor("core")],
        meters=[
            Meter(name="electricity", unit="J"),
            Meter(name="natural_gas", unit="kWh"),
            Meter(name="heat", unit="J"),
        ],
    )
    result = tallied(of, [24.0, 0.0, 0.0, 0.0], [24.0, KWH, 5.0, KWH])
    assert result.energy_kwh == pytest.approx({"electricity": 1.0, "natural_gas": 5.0})
    assert MetricsAccumulator(of).sources["electricity_kwh"] == "meter electricity"


def test_without_actuators__no_field_names_an_action_or_its_sensors(tmp_path: Path) -> None:
    own = {"scenario": "office", "relative": {"heating": 3.0}, "discrete": 10, "unobserved": ["schedule_next", "core"]}
    assert without_actuators(own) == {
        "scenario": "office", "actuators": {}, "relative": {}, "unobserved": ["core"],
    }  # fmt: skip
    file = tmp_path / "own.yaml"
    file.write_text("relative: {heating: 3}\nsensors: {out_next: [a, b]}\nunobserved: [out_next, heat_next_2]\n")
    assert without_actuators({"file": file}) == {
        "file": file, "actuators": {}, "relative": {}, "unobserved": ["out_next"],
    }  # fmt: skip
    assert without_actuators({"scenario": "office", "relative": 3.0}) == {
        "scenario": "office", "relative": 3.0, "actuators": {},
    }  # fmt: skip


@pytest.mark.slow
def test_evaluate__baseline_of_a_scenario_with_relative_actions() -> None:
    office = {"scenario": "ref-small-office-USA_AZ_Phoenix-continuous-v1", "begin": "07-05", "end": "07-05"}
    relative = {"relative": {"heating_setpoint": 3.0}, "unobserved": ["htgsetp_sch_next"]}
    rows = evaluate({**office, **relative}, ["fixed", "baseline"]).rows
    assert [row.controller for row in rows] == ["fixed", "baseline"]
    assert rows[1].result == evaluate(office, ["baseline"]).rows[0].result


@pytest.mark.slow
def test_evaluate__all_controllers_act_within_the_context_of_the_scenario(tmp_path: Path) -> None:
    from zenostat.lab.tuning.controller_episodes import ControllerEpisodes

    thermostat = "Zone Temperature Control"
    file = tmp_path / "own.yaml"
    fields = {
        "building": "ref-small-office", "weather": "USA_AZ_Phoenix", "begin": "07-05", "end": "07-05",
        "actuators": {
            "core_cooling": [thermostat, "Cooling Setpoint", "CORE_ZN", 22.5, 30.0],
            "side_cooling": [thermostat, "Cooling Setpoint", "PERIMETER_ZN_1", 22.5, 30.0],
        },
        "actions": {"core": ["core_cooling"]},
        "wrappers": [{"wrapper": "ChangingContext", "schedule": {"00:00": {"side_cooling": 29.0}}}],
    }  # fmt: skip
    file.write_text(yaml12.dump(fields))
    result = evaluate(file, ["fixed", "baseline"], trace=True)
    for name in ("fixed", "baseline"):
        run = result.traces[name].trajectory
        assert set(run.effective[1:, list(run.actuators).index("side_cooling")]) == {29.0}
    episodes = ControllerEpisodes({"file": str(file)})
    assert episodes.value(FixedSetpoints, {}, "reward") == result.rows[0].result.reward
    episodes.close()
    further = [{"wrapper": "ChangingContext", "schedule": {"00:00": {"side_cooling": 23.0}}}, {"wrapper": "CyclicTime"}]
    (row,) = evaluate(
        {k: v for k, v in fields.items() if k != "wrappers"}, ["baseline"], wrappers=further, trace=True
    ).rows
    assert row.result.reward != result.rows[1].result.reward
