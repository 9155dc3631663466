"""The paper's scenarios are what its version of Sinergym defines, with the weight of power that the paper states."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from support.data_packs import sinergym

from zenostat.models import catalog, data_packs
from zenostat.models.scenario.registry import find_scenario
from zenostat.models.scenario.schema import Scenario
from zenostat.models.scenario.sinergym_paper import paper_scenarios
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.scenario_ids import PAPER_IDS, all_ids

STOCHASTIC = "paper-datacenter-mixed-continuous-stochastic-v1"


@pytest.fixture(scope="module")
def config() -> dict[str, Any]:
    """The data center's configuration in the wheel of the paper's version."""
    folder = data_packs.add("sinergym-paper") / "sinergym" / "data" / "default_configuration"
    read: dict[str, Any] = json.loads((folder / "2ZoneDataCenterHVAC_wEconomizer.json").read_text())
    return read


def test_paper_scenarios__observations_and_actions_have_the_order_and_bounds_of_the_papers_environment(
    config: dict[str, Any],
) -> None:
    scenario = find_scenario(STOCHASTIC)
    expected = []
    for variable, spec in config["variables"].items():
        keys = spec["keys"] if isinstance(spec["keys"], list) else [spec["keys"]]
        for key in keys:
            name = spec["variable_names"]
            zone = key.removesuffix(" PEOPLE").lower().replace(" ", "_") + "_"
            expected.append((name if len(keys) == 1 else zone + name, variable, key))
    assert scenario.sensors is not None
    assert [(name, spec.variable, spec.key) for name, spec in scenario.sensors.items()] == expected
    assert list(map(str, scenario.time)) == config["time_variables"]
    low, high = (
        [float(n) for n in text.split(",")] for text in re.findall(r"array\(\[([^]]+)", config["action_space"])
    )
    assert scenario.actuators is not None
    assert [(a.key, a.low, a.high) for a in scenario.actuators.values()] == list(
        zip(config["actuators"], low, high, strict=True)
    )
    for actuator in scenario.actuators.values():
        spec = config["actuators"][actuator.key]
        assert (actuator.component_type, actuator.control_type) == (spec["element_type"], spec["value_type"])


def test_paper_scenarios__reward_differs_only_in_the_papers_weight_of_power(config: dict[str, Any]) -> None:
    reward = find_scenario(STOCHASTIC).reward
    settings = config["reward_kwargs"]
    assert reward["temperatures"] == settings["temperature_variables"]
    assert [reward["power"]] == settings["energy_variables"]
    assert (reward["winter"], reward["summer"]) == (settings["range_comfort_winter"], settings["range_comfort_summer"])
    assert reward["weight"] == settings["energy_weight"]
    assert reward["lambda_energy"] == 5e-5
    assert settings["lambda_energy"] == 1e-4


def test_paper_scenarios__building_weather_and_noise_are_those_of_the_papers_version(config: dict[str, Any]) -> None:
    scenario = find_scenario(f"zenostat/{STOCHASTIC}")
    building, weather = catalog.find_building(scenario.building), catalog.find_weather(scenario.weather[0])
    assert (building.path.name, building.pack) == (config["building_file"], "sinergym-paper")
    mixed = config["weather_specification"]["keys"].index("mixed")
    assert weather.path.name == config["weather_specification"]["weather_files"][mixed]
    (noise,) = scenario.weather_noise.values()
    sigma, mu, tau_years = config["weather_variability"]["Dry Bulb Temperature"]
    assert (noise.sigma, noise.mu, noise.tau_h) == (sigma, mu, pytest.approx(tau_years * 8760))
    model = json.loads(building.path.read_bytes())
    assert model["Timestep"]["Timestep 1"]["number_of_timesteps_per_hour"] == scenario.steps_per_hour == 4
    flows = {name: e["air_flow_calculation_method"] for name, e in model["ElectricEquipment:ITE:AirCooled"].items()}
    assert flows == {
        "EastDataCenter_Equip": "FlowControlWithApproachTemperatures",
        "WestDataCenter_Equip": "FlowFromSystem",
    }


def test_paper_scenarios__corrected_model_is_the_same_task_in_the_same_weather() -> None:
    scenarios = paper_scenarios()
    assert tuple(scenarios) == PAPER_IDS
    root, paper = sinergym() / "sinergym", data_packs.add("sinergym-paper") / "sinergym"
    name = "weather/USA_NY_New.York-J.F.Kennedy.Intl.AP.744860_TMY3.epw"
    assert (root / "data" / name).read_bytes() == (paper / "data" / name).read_bytes()
    own, corrected = (task(scenarios[f"paper-{base}-mixed-continuous-v1"]) for base in ("datacenter", "datacenter_dx"))
    assert own == corrected


def task(scenario: Scenario) -> dict[str, Any]:
    """All of a scenario but its name and files."""
    return {name: value for name, value in scenario if name not in ("id", "about", "building", "weather")}


def test_paper_scenarios__only_the_stochastic_ids_have_noise() -> None:
    for name, scenario in paper_scenarios().items():
        assert bool(scenario.weather_noise) == ("stochastic" in name)
        assert name in all_ids()


def test_paper_scenarios__pack_lists_the_papers_files_only_and_hides_no_other_pack() -> None:
    sinergym(), data_packs.add("sinergym-paper")
    assert [e.name for e in catalog.buildings() if e.pack == "sinergym-paper"] == [
        "sinergym-paper/2ZoneDataCenterHVAC_wEconomizer"
    ]
    assert [e.name for e in catalog.weathers() if e.pack == "sinergym-paper"] == ["sinergym-paper/USA_NY_New.York"]
    assert catalog.find_weather("USA_NY_New.York").pack == "sinergym"
    assert catalog.find_building("LrgOff").pack == "sinergym"
    with pytest.raises(UnknownName, match="no building 'sinergym-paper/5ZoneAutoDXVAV'"):
        catalog.find_building("sinergym-paper/5ZoneAutoDXVAV")


def test_paper_scenarios__missing_pack_is_reported_with_its_command(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path))
    scenario = find_scenario(STOCHASTIC)
    with pytest.raises((UnknownName, InvalidConfig), match="zenostat data-packs add sinergym-paper"):
        catalog.find_building(scenario.building)


def test_paper_scenarios__rows_on_the_page_satisfy_the_identity_of_the_reward() -> None:
    page = (Path(__file__).parents[2] / "docs" / "paper.md").read_text(encoding="utf-8").replace("\N{MINUS SIGN}", "-")
    cells = r"\| ([-\d.]+) \| ([\d,]+) \| ([\d.]+) \| ([-\d.]+) \|"
    rows = [[float(text.replace(",", "")) for text in row] for row in re.findall(cells, page)]
    published = ([-0.4310, 17221.0, 0.0009], [-0.4377, 17423.0, 0.0043])
    assert all(row in [shown[:3] for shown in rows] for row in published)
    assert len(rows) >= 10
    for reward, power_w, deviation_k, printed in rows:
        identity = -(0.5 * 5e-5 * power_w + 0.5 * deviation_k)
        rounding = 0.5e-4 + 0.5 * 5e-5 * 0.5 + 0.5 * 0.5e-4
        assert abs(reward - identity) <= rounding
        assert abs(printed - identity) <= 0.5e-4 + 1e-9
