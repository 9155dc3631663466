"""Sinergym's configurations of a user as scenarios; they are never run."""

import ast
import textwrap
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.data_packs import sinergym

from zenostat.agent_sdk.rewards import read_reward
from zenostat.models.sinergym import scenarios as reader
from zenostat.models.sinergym.literals import Offsets, Rows, read_table
from zenostat.models.sinergym.scenarios import discrete_tables, scenario_of, scenarios_of
from zenostat.models.weather.noise import ColumnNoise
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.scenario_ids import PACK_IDS


@pytest.fixture(scope="module")
def root() -> Path:
    return sinergym() / "sinergym"


# A user's file

OWN = """
    id_base: hut
    building_file: hut.epJSON
    weather_specification: {weather_files: [here.epw], keys: [here]}
    time_variables: [month, hour]
    variables:
      Zone Air Temperature: {variable_names: air_temperature, keys: [Room 1, 'Attic:North']}
      Site Wind Speed: {variable_names: wind, keys: Environment}
      Facility Total HVAC Electricity Demand Rate: {variable_names: [power], keys: [Whole Building]}
    meters: {'Electricity:HVAC': energy}
    actuators:
      HEAT: {variable_name: heating, element_type: 'Schedule:Compact', value_type: Schedule Value}
      COOL: {variable_name: cooling, element_type: 'Schedule:Compact', value_type: Schedule Value}
    action_space: Box(low=np.array([15, 22.5]), high=np.array([22.5, 30]), shape=(2,), dtype=np.float32)
    reward: sinergym.utils.rewards:LinearReward
    reward_kwargs:
      temperature_variables: [room_1_air_temperature, 'attic:north_air_temperature']
      energy_variables: [power]
      range_comfort_winter: [20, 23.5]
      range_comfort_summer: [23, 26]
    max_ep_store: 3
"""


@pytest.fixture
def own(tmp_path: Path):
    """Writes a user's file: `OWN`, with more lines or with pieces replaced."""
    (tmp_path / "hut.epJSON").write_text("{}")
    (tmp_path / "here.epw").write_text("")

    def write(*more: str, **replaced: str) -> Path:
        fields = yaml.safe_load(textwrap.dedent(OWN))
        for text in more:
            fields |= yaml.safe_load(textwrap.dedent(text))
        fields |= {name: yaml.safe_load(text) for name, text in replaced.items()}
        path = tmp_path / "own.yaml"
        path.write_text(yaml.safe_dump(fields, sort_keys=False))
        return path

    return write


def test_sinergym__files_beside_it_are_found(own, tmp_path):
    scenarios = scenarios_of(own())
    assert list(scenarios) == ["hut-here-continuous-v1"]
    scenario = scenarios["hut-here-continuous-v1"]
    assert scenario.building == str(tmp_path / "hut.epJSON")
    assert scenario.weather == (str(tmp_path / "here.epw"),)
    assert list(scenario.sensors) == ["room_1_air_temperature", "attic_north_air_temperature", "wind", "power"]
    assert scenario.meters == {"energy": "Electricity:HVAC"}
    assert scenario.reward["temperatures"] == ["room_1_air_temperature", "attic_north_air_temperature"]
    assert (scenario.reward["weight"], scenario.reward["lambda_energy"]) == (0.5, 1.0)
    assert {n: (a.low, a.high) for n, a in scenario.actuators.items()} == {"heating": (15, 22.5), "cooling": (22.5, 30)}


def test_sinergym__absolute_paths_and_files_of_the_pack_are_found(own, tmp_path):
    sinergym()
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "far.epw").write_text("")
    path = own(
        building_file="5ZoneAutoDXVAV.epJSON",
        weather_specification=f"{{weather_files: [{tmp_path}/far/far.epw, [here.epw, ESP_Granada.084190_SWEC.epw]], "
        "keys: [far, two]}",
    )
    scenarios = scenarios_of(path)
    assert scenarios["hut-far-continuous-v1"].building == "sinergym/5ZoneAutoDXVAV"
    assert scenarios["hut-far-continuous-v1"].weather == (str(tmp_path / "far" / "far.epw"),)
    assert scenarios["hut-two-continuous-v1"].weather == (str(tmp_path / "here.epw"), "sinergym/ESP_Granada")


def test_sinergym__run_period_noise_and_context(own):
    path = own(
        "building_config: {timesteps_per_hour: 2, runperiod: [1, 2, 1991, 3, 4, 1991]}",
        "weather_variability: {Wind Speed: [0.5, [-1, 1], [12, 24]], Dry Bulb Temperature: [1, 0, 24, [-10, 40]]}",
        "context: {OCC: {variable_name: people, element_type: 'Schedule:Compact', value_type: Schedule Value}}",
        "initial_context: [1.0]",
    )
    scenarios = scenarios_of(path)
    assert list(scenarios) == ["hut-here-continuous-v1", "hut-here-continuous-stochastic-v1"]
    calm, noisy = scenarios.values()
    assert (calm.begin, calm.end, calm.steps_per_hour) == ("1991-02-01", "1991-04-03", 2)
    assert calm.weather_noise == {}
    assert noisy.weather_noise == {
        "wind_speed": ColumnNoise(sigma=0.5, mu=(-1, 1), tau_h=(12, 24)),
        "dry_bulb_temperature": ColumnNoise(sigma=1, mu=0, tau_h=24, low=-10, high=40),
    }
    assert {n: (a.low, a.high) for n, a in calm.actuators.items()}["people"] == (None, None)
    assert {n: a.actuators for n, a in calm.actions.items()} == {"heating": ("heating",), "cooling": ("cooling",)}
    assert calm.wrappers == ({"wrapper": "ChangingContext", "schedule": {"00:00": {"people": 1.0}}},)


@pytest.mark.parametrize(
    ("lines", "fault"),
    [
        ("initial_context: [1.0, 2.0]", "initial_context: expected a number for each of 0 actuators of context"),
        ("initial_context: {people: 1.0}", "initial_context: expected a number for each of"),
        ("max_ep_store: none", "max_ep_store: expected an integer of at least 1, got 'none'"),
        ("max_ep_store: 0", "max_ep_store: expected an integer of at least 1, got 0"),
    ],
)
def test_sinergym__no_setting_is_ignored_in_silence(own, lines, fault):
    with pytest.raises(InvalidConfig, match=fault):
        scenarios_of(own(lines))


UNREADABLE = {
    "reward": ("reward: mymod:MyReward", "reward: unknown reward 'mymod:MyReward'"),
    "discrete": ("action_space_discrete: Discrete(0)", "Discrete"),
    "building": ("building_file: nowhere.epJSON", "no file 'nowhere.epJSON'"),
    "weather": ("weather_specification: {weather_files: [no.epw], keys: [here]}", "no file 'no.epw'"),
    "period": ("building_config: {runperiod: [1, 2]}", "building_config.runperiod"),
    "steps_per_hour": ("building_config: {timesteps_per_hour: four}", "timesteps_per_hour: expected an integer"),
    "time": ("time_variables: [hours]", "no field 'hours' of the clock"),
    "meters": ("meters: {'Electricity:HVAC': 3}", "meters.Electricity:HVAC"),
    "weather_noise": ("weather_variability: {Wind Speed: [1]}", "weather_variability.Wind Speed"),
    "actuators": ("action_space: MyBox()", "action_space"),
}


@pytest.mark.parametrize("argument", UNREADABLE)
def test_sinergym__argument_replaces_a_setting_that_cannot_be_read(own, argument):
    line, fault = UNREADABLE[argument]
    path = own(line)
    with pytest.raises(InvalidConfig, match=fault):
        scenario_of(path)
    assert scenario_of(path, overridden={argument}).id == "hut-here-continuous-v1"


def test_sinergym__own_discrete_choices_need_no_meaning_where_an_argument_replaces_them(own):
    path = own("action_space_discrete: Discrete(7)", only_discrete="true")
    with pytest.raises(InvalidConfig, match="is defined in code"):
        scenario_of(path)
    assert scenario_of(path, overridden={"discrete"}).id == "hut-here-discrete-v1"


def test_sinergym__discrete_choices_that_nobody_knows_leave_the_continuous_scenarios(own):
    path = own(action_space_discrete="gym.spaces.Discrete(10)")
    assert list(scenarios_of(path)) == ["hut-here-continuous-v1"]
    assert scenario_of(path).id == "hut-here-continuous-v1"
    with pytest.raises(
        InvalidConfig, match=r"is defined in code, which is not run; .* scenario file \(its field `discrete`\)"
    ):
        scenario_of(path, "hut-here-discrete-v1")
    path = own(action_space_discrete="Discrete(10)", only_discrete="true")
    with pytest.raises(InvalidConfig, match="is defined in code, which is not run"):
        scenarios_of(path)


def test_sinergym__discrete_choices_of_a_building_of_the_pack_need_the_pack(own, tmp_path, monkeypatch):
    path = own(action_space_discrete="Discrete(10)", id_base="5zone")
    sinergym()
    with pytest.raises(InvalidConfig, match=r"choice 0 sets heating to 12, outside 15 to 22\.5 of"):
        scenarios_of(path)
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "empty"))
    assert list(scenarios_of(path)) == ["5zone-here-continuous-v1"]
    with pytest.raises(InvalidConfig, match="'5zone' is in the data pack 'sinergym': zenostat data-packs add sinergym"):
        scenario_of(path, "discrete")


@pytest.mark.parametrize(
    ("text", "meaning", "values"),
    [
        ("Discrete(2)", Rows(((15.0, 30.0), (22.5, 22.5))), [((15.0, 30.0), (22.5, 22.5))]),
        ("MultiDiscrete([2, 3])", Offsets(((0, 20.0), (1, 25.0))), [((20.0,), (21.0,)), ((25.0,), (26.0,), (27.0,))]),
    ],
)
def test_sinergym__tables_can_be_given(own, text, meaning, values):
    path = own(action_space_discrete=text)
    scenarios = scenarios_of(path, discrete_tables={"hut": meaning})
    assert [choice.values for choice in scenarios["hut-here-discrete-v1"].discrete] == values


@pytest.mark.parametrize(
    ("text", "meaning", "fault"),
    [
        ("Discrete(3)", Rows(((15.0, 30.0),)), r"Discrete\(3\) has 3 choices, but its table has 1"),
        ("Discrete(1)", Rows(((15.0,),)), "rows of 1 values, but there are 2 actuators"),
        ("Discrete(1)", Offsets(()), "needs a table of values"),
        ("MultiDiscrete([2, 2])", Rows(((15.0, 30.0),)), "one for all of them together"),
        ("MultiDiscrete([2])", Offsets(()), "has 1 dimensions, but there are 2 actuators"),
        ("MultiDiscrete([2, 2])", Offsets(((5, 1.0),)), "adds to dimension 5, but there are 2"),
        ("MultiDiscrete([2, 2])", Offsets(((0, 15.0),)), "choice 0 sets cooling to 0, outside 22.5 to 30"),
        ("Box(low=0, high=1, shape=(2,))", Offsets(()), "expected Discrete or MultiDiscrete"),
    ],
)
def test_sinergym__table_that_does_not_fit_is_a_fault(own, text, meaning, fault):
    with pytest.raises(InvalidConfig, match=fault):
        scenarios_of(own(action_space_discrete=text), discrete_tables={"hut": meaning})


def test_sinergym__one_of_several_by_the_end_of_its_id(root):
    config = root / "data" / "default_configuration" / "5ZoneAutoDXVAV.yaml"
    assert scenario_of(config).id == "5zone-hot-continuous-v1"
    for text in ("cool-discrete", "cool-discrete-v1", "5zone-cool-discrete-v1", "Eplus-5zone-cool-discrete-v1"):
        assert scenario_of(config, text).id == "5zone-cool-discrete-v1"
    with pytest.raises(UnknownName, match="'discrete' matches several: 5zone-hot-discrete-v1, 5zone-mixed-discrete-v1"):
        scenario_of(config, "discrete")
    with pytest.raises(UnknownName, match="has no scenario 'hot-discret'; did you mean '5zone-hot-discrete-v1'"):
        scenario_of(config, "hot-discret")


def test_scenarios_of__numbers_and_names_that_no_system_accepts_are_errors(own):
    path = own(building_file="x" * 3000, building_config=f"{{runperiod: [1, 1, {10**30}, 3, 4, 1991]}}")
    with pytest.raises(InvalidConfig, match=r"building_file: no file 'xxx[\s\S]*building_config\.runperiod: expected"):
        scenarios_of(path)


def test_scenarios_of__reports_all_errors_of_a_file_at_once(own, tmp_path, monkeypatch):
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "empty"))
    path = own(
        "wether_variability: {}",
        id_base="my hut",
        building_file="5ZoneAutoDXVAV.epJSON",
        weather_specification="{weather_files: [there.epw], keys: [here, there]}",
        building_config="{timesteps_per_hour: four, runperiod: [31, 2, 1991, 3, 4, 1991], horizon: 3}",
        weather_variability="{Dry Bulb Temprature: [1, 0, 24], Wind Speed: [1, 0], Relative Humidity: [-1, 0, 24]}",
        time_variables="[month, hours]",
        variables="""
          Zone Air Temperature: {variable_names: [a, b], keys: [Room]}
          Site Wind Speed: {variable_names: wind, keys: Environment, unit: m}
          Site Wind Direction: {variable_names: wind, keys: Environment}
          Other: text
        """,
        meters="{'Electricity:HVAC': wind}",
        actuators="{HEAT: {variable_name: heating, element_type: 'Schedule:Compact'}}",
        action_space="Box(low=np.array([15]), high=np.array([10]))",
        action_space_discrete="Discrete(0)",
        only_discrete="perhaps",
        reward="sinergym.utils.rewards:BestReward",
    )
    with pytest.raises(InvalidConfig) as raised:
        scenarios_of(path)
    faults = str(raised.value).splitlines()
    assert all(fault.startswith(f"{path}: ") for fault in faults)
    for expected in (
        "unknown setting 'wether_variability'; did you mean 'weather_variability'",
        "id_base: the base of the ids 'my hut' is not valid in a topic",
        "building_file: '5ZoneAutoDXVAV.epJSON' is in the data pack 'sinergym': zenostat data-packs add sinergym",
        "weather_specification: 1 weather_files but 2 keys",
        "weather_specification.weather_files.0: no file 'there.epw' next to own.yaml or in the data pack",
        "building_config.timesteps_per_hour: expected an integer, got 'four'",
        "building_config.runperiod: expected [day, month, year, day, month, year], got [31, 2, 1991, 3, 4, 1991]",
        "building_config: unknown setting 'horizon'",
        "weather_variability.Dry Bulb Temprature: no weather column",
        "weather_variability.Wind Speed: expected [sigma, mu, tau] or [sigma, mu, tau, [low, high]], got [1, 0]",
        "weather_variability.Relative Humidity: sigma: ",
        "time_variables: no field 'hours' of the clock; did you mean 'hour'",
        "variables.Zone Air Temperature: 2 variable_names but 1 keys",
        "variables.Site Wind Speed: unknown setting 'unit'",
        "variables.Site Wind Direction: two observations are called 'wind'",
        "variables.Other: expected variable_names and keys, got 'text'",
        "meters.Electricity:HVAC: two observations are called 'wind'",
        "actuators.HEAT: expected variable_name, element_type, value_type, got ",
        "action_space: expected a Box whose low is below its high, not 15 to 10, got ",
        "action_space_discrete: expected Discrete(n) with an integer number of choices, got 'Discrete(0)'",
        "only_discrete: expected true or false, got 'perhaps'",
        "reward: unknown reward 'sinergym.utils.rewards:BestReward'; known are "
        "'sinergym.utils.rewards:LinearReward', 'sinergym.utils.rewards:ExpReward', ",
    ):
        assert any(expected in fault for fault in faults), (expected, faults)


def test_scenarios_of__reports_all_errors_of_the_reward_at_once(own):
    path = own(
        reward_kwargs="""
          temperature_variables: [rom_1_air_temperature]
          energy_variables: power
          range_comfort_winter: [23.5, 20]
          summer_start: [13, 1]
          energy_weight: 2
          lambda_energy: much
          lambda_temprature: 1.0
        """
    )
    with pytest.raises(InvalidConfig) as raised:
        scenarios_of(path)
    for expected in (
        "no variable or meter is called 'rom_1_air_temperature'; did you mean 'room_1_air_temperature'",
        "reward_kwargs.energy_variables: expected a list of strings, got 'power'",
        "reward_kwargs.range_comfort_winter: expected [low, high], got [23.5, 20]",
        "reward_kwargs.range_comfort_summer: expected two numbers, got None",
        "reward_kwargs.summer_start: expected [month, day], got [13, 1]",
        "reward_kwargs.energy_weight: expected a number from 0 to 1, got 2",
        "reward_kwargs.lambda_energy: expected a number, got 'much'",
        "reward_kwargs: unknown setting 'lambda_temprature'; did you mean 'lambda_temperature'",
    ):
        assert expected in str(raised.value)


# Rewards

ZONES = {
    "temperature_variables": ["room_1_air_temperature", "attic:north_air_temperature"],
    "range_comfort_winter": [20, 23.5],
    "range_comfort_summer": [23, 26],
}
ENERGY = {"energy_variables": ["power"]}
WEIGHTS = {"weight": 0.5, "lambda_energy": 1.0, "lambda_temperature": 1.0}
SEASONS = {"winter": [20.0, 23.5], "summer": [23.0, 26.0], "summer_begin": [6, 1], "summer_end": [9, 30]}
ROOMS = ["room_1_air_temperature", "attic_north_air_temperature"]
BANDED = {**SEASONS, "temperatures": ROOMS, "power": ["power"]}
REWARDS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "linear": ("LinearReward", ZONES | ENERGY, {"kind": "linear", **WEIGHTS, **BANDED}),
    "exponential": (
        "ExpReward", ZONES | ENERGY | {"energy_weight": 0.25, "lambda_energy": 1e-4, "summer_start": [5, 1]},
        {"kind": "exponential", **WEIGHTS, "weight": 0.25, "lambda_energy": 1e-4, **BANDED, "summer_begin": [5, 1]},
    ),
    "hourly": (
        "HourlyLinearReward", ZONES | ENERGY,
        {"kind": "hourly", **WEIGHTS, "weight_outside": 1.0, "hours": [9, 20], **BANDED},
    ),
    "hourly to midnight": (
        "HourlyLinearReward", ZONES | ENERGY | {"default_energy_weight": 0.75, "range_comfort_hours": [7, 23]},
        {"kind": "hourly", **WEIGHTS, "weight": 0.75, "weight_outside": 1.0, "hours": [7, 24], **BANDED},
    ),
    "normalized": (
        "NormalizedLinearReward", ZONES | ENERGY,
        {"kind": "normalized", "weight": 0.5, "max_power_w": 8.0, "max_degrees": 12.0, **BANDED},
    ),
    "normalised from nothing": (
        "NormalizedLinearReward", ZONES | ENERGY | {"max_energy_penalty": 0, "max_comfort_penalty": 3},
        {"kind": "normalized", "weight": 0.5, "max_power_w": None, "max_degrees": 3.0, **BANDED},
    ),
    "multi-zone": (
        "MultiZoneReward",
        ENERGY | {"temperature_and_setpoints_conf": dict.fromkeys(ZONES["temperature_variables"], "setpoint:1"),
                  "comfort_threshold": 1},
        {"kind": "multi_zone", **WEIGHTS, "threshold": 1.0, "zones": dict.fromkeys(ROOMS, "setpoint_1"),
         "power": ["power"]},
    ),
}  # fmt: skip
SETPOINT = "variables: {Zone Thermostat Heating Setpoint Temperature: {variable_names: ['setpoint:1'], keys: [Room 1]}}"


def rewarded(own: Any, kind: str, kwargs: dict[str, Any]) -> Path:
    """A user's file with this reward, and a setpoint to observe."""
    variables = yaml.safe_load(textwrap.dedent(OWN))["variables"] | yaml.safe_load(SETPOINT)["variables"]
    return own(
        yaml.safe_dump({"variables": variables}), reward=f"sinergym.utils.rewards:{kind}",
        reward_kwargs=yaml.safe_dump(kwargs),
    )  # fmt: skip


@pytest.mark.parametrize(("kind", "kwargs", "ours"), REWARDS.values(), ids=REWARDS)
def test_sinergym__reward_of_sinergym_is_one_of_ours(own, kind, kwargs, ours):
    (scenario,) = scenarios_of(rewarded(own, kind, kwargs)).values()
    assert scenario.reward == ours
    read = read_reward(scenario.reward)
    assert read.kind == ours["kind"]


def test_sinergym__cost_of_energy_has_a_file_of_prices(own, tmp_path):
    (tmp_path / "prices.csv").write_text("value\n")
    kwargs = ZONES | ENERGY | {"energy_cost_variables": ["energy_cost"], "energy_cost_data_path": "prices.csv"}
    (scenario,) = scenarios_of(rewarded(own, "EnergyCostLinearReward", kwargs | {"energy_weight": 0.3})).values()
    price = {"csv": str(tmp_path / "prices.csv"), "column": "value", "unit": "EUR/MWh", "delimiter": ";"}
    assert scenario.reward == {
        "kind": "energy_cost", **WEIGHTS, "weight": 0.3, "weight_temperature": 0.4, "lambda_cost": 1.0, "price": price,
        **SEASONS, "temperatures": ROOMS, "energy": ["power"],
    }  # fmt: skip
    assert read_reward(scenario.reward).kind == "energy_cost"


def test_sinergym__packs_prices_go_by_their_name(own):
    name = "PVPC_active_energy_billing_Iberian_Peninsula_2023.csv"
    path = sinergym() / "sinergym" / "data" / "energy_cost" / name
    kwargs = ZONES | ENERGY
    # Sinergym's class has no argument for the file; its own one is meant.
    for arguments in (kwargs, kwargs | {"energy_cost_data_path": name}):
        (scenario,) = scenarios_of(rewarded(own, "EnergyCostLinearReward", arguments)).values()
        assert scenario.reward["price"]["csv"] == str(path)
    assert read_reward(scenario.reward).price.at(datetime(2017, 1, 1)) == 41.45


WRONG: dict[str, tuple[str, dict[str, Any], str]] = {
    "no hours": ("HourlyLinearReward", {"range_comfort_hours": [19, 9]}, r"expected \[first, last\] of"),
    "half hours": ("HourlyLinearReward", {"range_comfort_hours": [9.5, 19]}, "range_comfort_hours: "),
    "a weight of linear": ("HourlyLinearReward", {"energy_weight": 0.5}, "did you mean 'default_energy_weight'"),
    "a factor": ("NormalizedLinearReward", {"lambda_energy": 1}, "unknown setting 'lambda_energy'"),
    "a maximum below 0": ("NormalizedLinearReward", {"max_energy_penalty": -8}, "expected at least 0, got -8"),
    "weights above 1": ("EnergyCostLinearReward", {"energy_weight": 0.7}, "temperature_weight is above 1"),
    "no name of prices": ("EnergyCostLinearReward", {"energy_cost_data_path": ""}, "the file of prices .* got ''"),
    "prices that are not there": ("EnergyCostLinearReward", {"energy_cost_data_path": "p.csv"}, "no file 'p.csv' next"),
    "no such variable": ("ExpReward", {"energy_variables": ["powr"]}, "called 'powr'; did you mean 'power'"),
    "a band upside down": ("ExpReward", {"range_comfort_winter": [24, 20]}, r"expected \[low, high\], got"),
    "no zones": ("MultiZoneReward", {}, "temperature_and_setpoints_conf: expected temperatures and their setpoints"),
    "no such setpoint": ("MultiZoneReward", {"temperature_and_setpoints_conf": {"room_1_air_temperature": "setpont"}},
                         "called 'setpont'; did you mean 'setpoint:1'"),
    "a threshold below 0": ("MultiZoneReward", {"comfort_threshold": -1}, "comfort_threshold: expected at least 0"),
}  # fmt: skip


@pytest.mark.parametrize(("kind", "wrong", "words"), WRONG.values(), ids=WRONG)
def test_sinergym__reward_of_sinergym_that_cannot_be(own, kind, wrong, words):
    kwargs = (ENERGY if kind == "MultiZoneReward" else ZONES | ENERGY) | wrong
    with pytest.raises(InvalidConfig, match=words):
        scenarios_of(rewarded(own, kind, kwargs))


def test_sinergym__empty_file_lacks_all_that_is_needed(tmp_path):
    path = tmp_path / "empty.yaml"
    path.write_text("{}")
    with pytest.raises(InvalidConfig) as raised:
        scenarios_of(path)
    assert [line.split(": ")[1].split(" ")[0] for line in str(raised.value).splitlines()] == [
        "id_base", "building_file", "weather_specification", "variables", "action_space", "reward", "reward_kwargs",
    ]  # fmt: skip


def test_sinergym__number_of_actuators_is_that_of_the_action_space(own):
    with pytest.raises(InvalidConfig, match="action_space has 1 dimensions, but there are 2 actuators"):
        scenarios_of(own(action_space="Box(low=0, high=1, shape=(1,))"))


def test_sinergym__without_actuators_the_building_controls_itself(own):
    scenarios = scenarios_of(
        own(actuators="{}", action_space="gym.spaces.Box(low=0, high=0, shape=(0,), dtype=np.float32)")
    )
    assert next(iter(scenarios.values())).actuators == {}


# Python text


CODE = "__import__('os').mkdir({!r})"


@pytest.mark.parametrize(
    "text",
    [
        "{}", "Discrete({})", "Box(low=np.array([{}]), high=np.array([1]))",
        "Box(low=np.array([0], dtype={}), high=np.array([1]))", "(lambda: {})()", "Discrete(n=[{} for _ in [1]][0])",
    ],
)  # fmt: skip
def test_sinergym__no_code_of_a_configuration_is_run(text, own, tmp_path):
    code = CODE.format(str(tmp_path / "ran"))
    with pytest.raises(InvalidConfig, match=r"action_space: expected .*, got"):
        scenarios_of(own(action_space=repr(text.format(code))))
    assert not (tmp_path / "ran").exists()


def test_sinergym__no_object_of_a_yaml_is_made(own, tmp_path):
    path = own()
    path.write_text(path.read_text() + f"initial_context: !!python/object/apply:os.mkdir ['{tmp_path}/ran']\n")
    with pytest.raises(InvalidConfig, match="is not valid YAML"):
        scenarios_of(path)
    assert not (tmp_path / "ran").exists()


def test_sinergym__setting_that_is_repeated_is_refused(own):
    path = own()
    path.write_text(path.read_text() + "id_base: other\n")
    with pytest.raises(InvalidConfig, match="repeated name 'id_base'"):
        scenarios_of(path)


FUNCTION = """
def DEFAULT_HUT_DISCRETE_FUNCTION(action):
    'What it means.'
    if isinstance(action, np.ndarray):
        action = int(action.item())
    mapping = {0: np.array([1, 2.5], dtype=np.float32), 1: [3, -4]}
    return mapping[action]
"""


def function(text: str) -> ast.FunctionDef:
    return ast.parse(text).body[0]


def test_sinergym__table_is_read():
    assert read_table(function(FUNCTION)) == Rows(((1.0, 2.5), (3.0, -4.0)))
    added = "def f(action):\n    action[5] += 25\n    action[0] += -1.5\n    return action.astype(np.float32)"
    assert read_table(function(added)) == Offsets(((0, -1.5), (5, 25.0)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0: np.array([1, 2.5], dtype=np.float32)", "0: {code}"),
        ("0: np.array([1, 2.5], dtype=np.float32)", "0: [{code}]"),
        ("0: np.array([1, 2.5], dtype=np.float32)", "{code}: [1]"),
        ("int(action.item())", "{code}"),
        ("isinstance(action, np.ndarray)", "{code}"),
        ("return mapping[action]", "return {code}"),
        ("return mapping[action]", "{code}\n    return mapping[action]"),
        ("'What it means.'", "{code}"),
        ("'What it means.'", "import os"),
        ("'What it means.'", "for i in range(3): action[i] += 1"),
        ("0: np", "2: np"),
        ("1: [3, -4]", "**other"),
        ("    mapping = ", "    other = "),
        ("return mapping[action]", "return mapping[0]"),
        ("return mapping[action]", "return action"),
        ("'What it means.'", "action[0] += 1"),
        ("'What it means.'", "action[-1] += 1"),
        ("'What it means.'", "action[0] *= 2"),
    ],
)
def test_sinergym__table_that_does_more_is_refused_and_not_run(old, new, tmp_path):
    assert old in FUNCTION
    constants = tmp_path / "constants.py"
    constants.write_text(FUNCTION.replace(old, new.format(code=CODE.format(str(tmp_path / "ran")))))
    with pytest.raises(InvalidConfig):
        discrete_tables(constants)
    assert not (tmp_path / "ran").exists()


def test_sinergym__rest_of_the_code_is_not_run(tmp_path):
    constants = tmp_path / "constants.py"
    constants.write_text(CODE.format(str(tmp_path / "ran")) + FUNCTION)
    assert list(discrete_tables(constants)) == ["hut"]
    assert not (tmp_path / "ran").exists()


def test_sinergym__demo_that_is_no_literal_is_refused(tmp_path, root):
    init = tmp_path / "__init__.py"
    text = (root / "__init__.py").read_text()
    code = CODE.format(str(tmp_path / "ran"))
    init.write_text(text.replace("'5ZoneAutoDXVAV.epJSON'", code))
    with pytest.raises(InvalidConfig, match="expected plain numbers, strings and lists, got"):
        reader.demo(init)
    init.write_text(text.replace("Eplus-demo-v1", "Eplus-other-v1"))
    with pytest.raises(InvalidConfig, match="registers no Eplus-demo-v1"):
        reader.demo(init)
    assert not (tmp_path / "ran").exists()


def test_sinergym__every_table_of_the_pack_is_used(root):
    known = discrete_tables(root / "utils" / "constants.py")
    assert set(known) == {base for base, (_, forms) in PACK_IDS.items() if "discrete" in forms}


def test_sinergym__file_that_is_not_there_is_unknown(tmp_path):
    with pytest.raises(UnknownName):
        scenarios_of(tmp_path / "nowhere.yaml")
    with pytest.raises(UnknownName):
        discrete_tables(tmp_path / "nowhere.py")
