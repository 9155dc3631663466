"""Scenarios of Sinergym's data pack: compared with a reading of their own, and never run."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.data_packs import sinergym

from zenostat.models.catalog import find_building, find_weather
from zenostat.models.scenario.schema import DiscreteActionSpec, Scenario, dump, load_scenario
from zenostat.models.sinergym import scenarios as reader
from zenostat.models.sinergym.scenarios import pack_scenarios
from zenostat.models.weather.noise import ColumnNoise
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.scenario_ids import DEMO, PACK_IDS

FORMS = ("continuous", "discrete", "continuous-stochastic", "discrete-stochastic")


@pytest.fixture(scope="module")
def root() -> Path:
    return sinergym() / "sinergym"


@pytest.fixture(scope="module")
def scenarios_by_name(root: Path) -> dict[str, Scenario]:
    return pack_scenarios()


def plain_reading(root: Path, base: str) -> dict[str, Any]:
    """The YAML of an id base, read by nothing of ours."""
    for path in (root / "data" / "default_configuration").glob("*.yaml"):
        fields = yaml.safe_load(path.read_text())
        if fields["id_base"] == base:
            return fields
    raise AssertionError(base)


def numbers(text: str, name: str) -> list[float]:
    """The numbers of `name=np.array([...])` in a space's text."""
    listed = re.search(rf"{name}=np\.array\(\[([^\]]*)\]", text)[1]
    return [float(number) for number in listed.split(",")]


@pytest.mark.parametrize("base", PACK_IDS)
def test_sinergym__scenario_states_what_its_file_states(base, root, scenarios_by_name):
    fields = plain_reading(root, base)
    weathers = dict(
        zip(fields["weather_specification"]["keys"], fields["weather_specification"]["weather_files"], strict=True)
    )
    mine = [name for name in scenarios_by_name if re.match(rf"{base}-({'|'.join(weathers)})-", name)]
    order = [f for f in FORMS if ("continuous" not in f or not fields.get("only_discrete"))
             and ("discrete" not in f or "action_space_discrete" in fields)]  # fmt: skip
    assert mine == [f"{base}-{key}-{form}-v1" for key in weathers for form in order]
    for name in mine:
        scenario = scenarios_by_name[name]
        key = name.removeprefix(f"{base}-").split("-")[0]
        assert scenario.id == name
        assert find_building(scenario.building).path == root / "data" / "buildings" / fields["building_file"]
        assert [find_weather(w).path for w in scenario.weather] == [root / "data" / "weather" / weathers[key]]
        assert (scenario.sizing, scenario.aggregation, scenario.control) == ("weather", "instant", "point")
        assert list(scenario.time) == fields["time_variables"] == ["month", "day_of_month", "hour"]
        assert scenario.steps_per_hour == (fields["building_config"] or {}).get("timesteps_per_hour")
        assert (scenario.begin, scenario.end) == (None, None)
        assert (scenario.edits, scenario.actions, scenario.weather_order) == ({}, None, "random")


@pytest.mark.parametrize("base", PACK_IDS)
def test_sinergym__what_is_observed_is_in_the_files_order(base, root, scenarios_by_name):
    fields = plain_reading(root, base)
    expected = []
    for variable, spec in fields["variables"].items():
        names, keys = spec["variable_names"], spec["keys"]
        for index, key in enumerate([keys] if isinstance(keys, str) else keys):
            prefix = "" if isinstance(keys, str) or isinstance(names, list) else key.lower().replace(" ", "_") + "_"
            name = prefix + (names if isinstance(names, str) else names[index])
            expected.append((re.sub("[^A-Za-z0-9_.-]", "_", name), variable, key))
    for scenario in (s for n, s in scenarios_by_name.items() if s.id.startswith(f"{base}-")):
        assert [(name, s.variable, s.key) for name, s in scenario.sensors.items()] == expected
        assert all(s.aggregation is None for s in scenario.sensors.values())
        assert scenario.meters == {name: meter for meter, name in fields["meters"].items()}


def test_sinergym__observations_have_the_sizes_that_sinergym_has(scenarios_by_name):
    sizes = {
        base: {
            len(s.time) + len(s.sensors) + len(s.meters)
            for n, s in scenarios_by_name.items()
            if re.match(rf"{base}-[a-z]+-", n)
        }
        for base in PACK_IDS
    }
    assert sizes == {
        "5zone": {17}, "datacenter_dx": {37}, "datacenter_cw": {41}, "smalldatacenter": {22}, "office": {48},
        "warehouse": {22}, "officegrid": {67}, "shop": {34}, "radiant": {83},
    }  # fmt: skip


@pytest.mark.parametrize("base", PACK_IDS)
def test_sinergym__actuators_have_the_bounds_of_the_action_space(base, root, scenarios_by_name):
    fields = plain_reading(root, base)
    lows, highs = numbers(fields["action_space"], "low"), numbers(fields["action_space"], "high")
    expected = [
        (spec["variable_name"], spec["element_type"], spec["value_type"], key, low, high)
        for (key, spec), low, high in zip(fields["actuators"].items(), lows, highs, strict=True)
    ]
    for scenario in (s for s in scenarios_by_name.values() if s.id.startswith(f"{base}-")):
        actuators = scenario.actuators.items()
        assert [(n, a.component_type, a.control_type, a.key, a.low, a.high) for n, a in actuators] == expected


@pytest.mark.parametrize("base", PACK_IDS)
def test_sinergym__only_the_stochastic_ones_have_noise(base, scenarios_by_name):
    for scenario in (s for s in scenarios_by_name.values() if s.id.startswith(f"{base}-")):
        assert scenario.weather_noise == (
            {
                "dry_bulb_temperature": ColumnNoise(sigma=1.0, mu=0.0, tau_h=24.0),
                "relative_humidity": ColumnNoise(sigma=(2.0, 5.0), mu=0.0, tau_h=24.0, low=0.0, high=100.0),
            }
            if "-stochastic-" in scenario.id
            else {}
        )


@pytest.mark.parametrize("base", PACK_IDS)
def test_sinergym__reward_has_the_files_numbers_and_names_of_what_is_observed(base, root, scenarios_by_name):
    fields = plain_reading(root, base)["reward_kwargs"]
    for scenario in (s for s in scenarios_by_name.values() if s.id.startswith(f"{base}-")):
        assert scenario.reward == {
            "kind": "linear",
            "weight": fields["energy_weight"],
            "lambda_energy": fields["lambda_energy"],
            "lambda_temperature": fields["lambda_temperature"],
            "winter": fields["range_comfort_winter"],
            "summer": fields["range_comfort_summer"],
            "summer_begin": fields["summer_start"],
            "summer_end": fields["summer_final"],
            "temperatures": [re.sub("[^A-Za-z0-9_.-]", "_", name) for name in fields["temperature_variables"]],
            "power": fields["energy_variables"],
        }
        assert set(scenario.reward["temperatures"] + scenario.reward["power"]) <= set(scenario.sensors)
        assert all(scenario.sensors[n].variable == "Zone Air Temperature" for n in scenario.reward["temperatures"])


def test_sinergym__discrete_ones_have_ten_rows_over_all_actions(scenarios_by_name):
    tables = {
        "5zone": [(12, 30), (13, 29), (14, 28), (15, 27), (16, 26), (17, 25), (18, 24), (19, 23.25), (20, 23.25),
                  (21, 23.25)],
        "datacenter_dx": [(t,) for t in range(20, 30)],
        "datacenter_cw": [(20, 10), (21, 9), (22, 8), (23, 7), (24, 6), (25, 5), (26, 5), (27, 6), (28, 7), (29, 8)],
    }  # fmt: skip
    for base in ("office", "warehouse", "shop"):
        tables[base] = [(15, 30), (16, 29), (17, 28), (18, 27), (19, 26), (20, 25), (21, 24), (22, 23), (22, 22.5),
                        (21, 22.5)]  # fmt: skip
    tables["officegrid"] = [(*row, 0, 0) for row in tables["office"]]
    for name, scenario in scenarios_by_name.items():
        base = name.split("-")[0]
        if "-discrete-" not in name:
            assert scenario.discrete is None
        elif base != "radiant":
            assert scenario.discrete == (
                DiscreteActionSpec(actions=tuple(scenario.actuators), values=tuple(tables[base])),
            )


def test_sinergym__radiant_building_has_a_choice_for_each_action_and_names_without_colons(scenarios_by_name):
    scenario = scenarios_by_name["radiant-stockholm-discrete-v1"]
    assert [choice.actions for choice in scenario.discrete] == [(name,) for name in scenario.actuators]
    assert [len(choice.values) for choice in scenario.discrete] == [2, 2, 2, 2, 2, 21]
    assert all(choice.values == ((0.0,), (1.0,)) for choice in scenario.discrete[:5])
    assert scenario.discrete[5].values == tuple((float(t),) for t in range(25, 46))
    assert scenario.actuators["water_temperature"].key == "HEATING HIGH WATER TEMPERATURE SCHEDULE: ALWAYS 65.00"
    assert scenario.sensors["firstfloor_livingroom_air_temperature"].key == "FirstFloor:LivingRoom"
    assert scenario.sensors["people_firstfloor_kitchen_people_air_temperature"].key == "People FirstFloor:Kitchen"
    assert scenario.reward["temperatures"][0] == "firstfloor_livingroom_air_temperature"


def test_sinergym__office_with_a_battery_observes_zones_by_their_keys(scenarios_by_name):
    scenario = scenarios_by_name["officegrid-hot-continuous-v1"]
    assert list(scenario.actuators) == [
        "heating_setpoint", "cooling_setpoint", "battery_charge_rate", "battery_discharge_rate",
    ]  # fmt: skip
    assert scenario.sensors["core_bottom_air_temperature"].key == "core_bottom"
    assert scenario.sensors["perimeter_top_zn_4_people_count"].key == "Perimeter_top_ZN_4"
    assert len(scenario.reward["temperatures"]) == 19


def test_sinergym__demo_is_read_from_the_code(scenarios_by_name, root):
    scenario = scenarios_by_name[DEMO]
    assert scenario.id == DEMO
    assert scenario.weather == ("sinergym/USA_PA_Pittsburgh",)
    assert (scenario.begin, scenario.end, scenario.steps_per_hour) == ("1991-01-01", "1991-03-01", 1)
    assert {n: (a.key, a.low, a.high) for n, a in scenario.actuators.items()} == {
        "Heating_Setpoint_RL": ("HTG-SETP-SCH", 15.0, 22.5),
        "Cooling_Setpoint_RL": ("CLG-SETP-SCH", 22.5, 30.0),
    }
    assert list(scenario.sensors) == [
        "outdoor_temperature", "htg_setpoint", "clg_setpoint", "air_temperature", "air_humidity",
        "HVAC_electricity_demand_rate",
    ]  # fmt: skip
    assert scenario.reward["lambda_energy"] == 1.0
    assert (scenario.reward["summer_begin"], scenario.reward["summer_end"]) == ([6, 1], [9, 30])
    assert scenario.discrete is None


def test_sinergym__scenario_of_the_pack_is_a_file(scenarios_by_name, tmp_path):
    for name in (DEMO, "radiant-hot-discrete-stochastic-v1", "officegrid-cool-discrete-v1"):
        path = tmp_path / f"{name}.yaml"
        path.write_text(dump(scenarios_by_name[name]))
        assert load_scenario(path) == scenarios_by_name[name]


def test_sinergym__all_are_read_once(root):
    reader._scenarios_in.cache_clear()
    reader._tables_in.cache_clear()
    assert len(pack_scenarios()) == 109
    assert pack_scenarios() is not pack_scenarios()
    assert reader._scenarios_in.cache_info().misses == 1
    assert reader._tables_in.cache_info().misses == 1


def test_sinergym__without_the_pack_its_scenarios_state_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path))
    with pytest.raises(InvalidConfig, match="zenostat data-packs add sinergym"):
        pack_scenarios()
