"""Manifests, samples and configurations for tests of rewards."""

from collections.abc import Sequence
from datetime import datetime
from typing import Any

import numpy as np

from support.builders import manifest, meter, sensor
from zenostat.agent_sdk.rewards import RewardConfig, read_reward
from zenostat.topics.messages import Manifest, Meter, Sensor

Array = np.ndarray[Any, np.dtype[np.float64]]
WINTER, SUMMER = datetime(2017, 1, 16, 12), datetime(2017, 7, 17, 12)  # Mondays
POWER, PEOPLE = "Facility Total HVAC Electricity Demand Rate", "Zone People Occupant Count"
HEATING = "Zone Thermostat Heating Setpoint Temperature"
COOLING = "Zone Thermostat Cooling Setpoint Temperature"

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
    "district": {
        "consumption": "electricity",
        "generation": "fans",
        "limits": [{"point": "north_humidity", "high": 80.0}],
        "temperatures": ["north", "south"],
        "feed_in": 0.1,
    },
}
"""Fields that each kind needs."""


def reward_config(kind: str, **more: Any) -> RewardConfig:
    config = read_reward({"kind": kind, **MINIMAL_FIELDS[kind], **more})
    assert isinstance(config, RewardConfig)
    return config
