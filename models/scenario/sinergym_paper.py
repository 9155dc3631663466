"""Scenarios of the experiments in the Sinergym paper (arXiv 2412.08293): a data center in mixed weather.

`paper-datacenter-*` has the model of the paper's version of Sinergym (3.6.2, data pack `sinergym-paper`), in which the
setpoints do not reach the east zone. `paper-datacenter_dx-*` is the same task on the corrected model of Sinergym
3.12.2 (data pack `sinergym`). Names, order, bounds and units of the points are those of the paper's environment.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from zenostat.models.scenario.schema import ActuatorSpec, Scenario, SensorSpec
from zenostat.models.weather.noise import ColumnNoise
from zenostat.topics.messages import Aggregation, TimeField
from zenostat.topics.scenario_ids import PAPER_IDS

LAMBDA_ENERGY = 5e-5
"""Weight of power in the paper's reward, 1/W."""

_BUILDINGS = {
    "datacenter": ("sinergym-paper/2ZoneDataCenterHVAC_wEconomizer", "sinergym-paper/USA_NY_New.York"),
    "datacenter_dx": ("sinergym/2ZoneDataCenterHVAC_wEconomizer_DX", "sinergym/USA_NY_New.York"),
}

_SITE = {
    "outdoor_temperature": "Site Outdoor Air Drybulb Temperature",
    "outdoor_humidity": "Site Outdoor Air Relative Humidity",
    "wind_speed": "Site Wind Speed",
    "wind_direction": "Site Wind Direction",
    "diffuse_solar_radiation": "Site Diffuse Solar Radiation Rate per Area",
    "direct_solar_radiation": "Site Direct Solar Radiation Rate per Area",
}

_ZONE = {
    "htg_setpoint": ("Zone Thermostat Heating Setpoint Temperature", ""),
    "clg_setpoint": ("Zone Thermostat Cooling Setpoint Temperature", ""),
    "air_temperature": ("Zone Air Temperature", ""),
    "air_humidity": ("Zone Air Relative Humidity", ""),
    "thermal_comfort_mean_radiant_temperature": ("Zone Thermal Comfort Mean Radiant Temperature", " PEOPLE"),
    "thermal_comfort_clothing_value": ("Zone Thermal Comfort Clothing Value", " PEOPLE"),
    "thermal_comfort_fanger_model_ppd": ("Zone Thermal Comfort Fanger Model PPD", " PEOPLE"),
    "people_occupant": ("Zone People Occupant Count", ""),
    "people_air_temperature": ("People Air Temperature", " PEOPLE"),
}
"""Variables of both zones by the end of their names, with the end of their keys."""

_NOISE = {"dry_bulb_temperature": ColumnNoise(sigma=1.0, mu=0.0, tau_h=8.76)}
"""The paper's version of Sinergym has a time constant of 0.001 years."""


@cache
def paper_scenarios() -> dict[str, Scenario]:
    """Return the scenarios by id, in the order of `zenostat.topics.scenario_ids.PAPER_IDS`."""
    return {name: _scenario(name) for name in PAPER_IDS}


def _scenario(name: str) -> Scenario:
    base = name.removeprefix("paper-").partition("-")[0]
    is_stochastic = name.endswith("-stochastic-v1")
    building, weather = _BUILDINGS[base]
    model = "the model of the paper" if base == "datacenter" else "the corrected model of Sinergym 3.12.2"
    return Scenario(
        id=name,
        about=f"the data center of the Sinergym paper, {model}" + (", weather with noise" if is_stochastic else ""),
        building=building,
        weather=(weather,),
        weather_noise=_NOISE if is_stochastic else {},
        sizing="weather",
        steps_per_hour=4,
        time=(TimeField.MONTH, TimeField.DAY_OF_MONTH, TimeField.HOUR),
        sensors=_sensors(),
        meters={},
        aggregation=Aggregation.INSTANT,
        actuators={
            "heating_setpoint": _schedule("Heating Setpoints", 15.0, 22.0),
            "cooling_setpoint": _schedule("Cooling Setpoints", 22.0, 30.0),
        },
        reward=_reward(),
    )


def _sensors() -> dict[str, SensorSpec]:
    sensors = {name: SensorSpec(variable=variable, key="Environment") for name, variable in _SITE.items()}
    for suffix, (variable, key) in _ZONE.items():
        for zone in ("West Zone", "East Zone"):
            name = f"{zone.lower().replace(' ', '_')}_{suffix}"
            sensors[name] = SensorSpec(variable=variable, key=f"{zone}{key}")
    power = SensorSpec(variable="Facility Total HVAC Electricity Demand Rate", key="Whole Building")
    return {**sensors, "HVAC_electricity_demand_rate": power}


def _schedule(key: str, low: float, high: float) -> ActuatorSpec:
    return ActuatorSpec(component_type="Schedule:Compact", control_type="Schedule Value", key=key, low=low, high=high)


def _reward() -> dict[str, Any]:
    """Return the linear reward with the band that ASHRAE TC 9.9 recommends for data centers, 18 to 27 degC."""
    return {
        "kind": "linear",
        "weight": 0.5,
        "lambda_energy": LAMBDA_ENERGY,
        "temperatures": ["west_zone_air_temperature"],
        "power": "HVAC_electricity_demand_rate",
        "winter": [18.0, 27.0],
        "summer": [18.0, 27.0],
    }
