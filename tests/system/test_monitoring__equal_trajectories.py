"""`monitoring` on a real building: more points on the bus, and not a bit of difference for the agent."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.nodes import SMALL

import zenostat  # noqa: F401  # registers the ids
from zenostat.metrics.roles import roles

SENSORS = {
    "core_temperature": ("Zone Mean Air Temperature", "Core_ZN"),
    "power": ("Facility Total HVAC Electricity Demand Rate", "Whole Building"),
}
OWN: dict[str, Any] = {**SMALL, "sensors": SENSORS, "meters": {"gas": "NaturalGas:Facility"}, "unobserved": ["power"]}
REWARD = {"kind": "linear", "power": ["power"]}
STEPS = 96


def episode(**options: Any) -> tuple[Any, ...]:
    """Observations, rewards and effective values under random actions; the manifest, and all values."""
    with gym.make("zenostat/Building-v1", **OWN, reward=REWARD, affinity="off", **options) as env:
        building: Any = env.unwrapped
        env.action_space.seed(5)
        observations, rewards, effective, values = [env.reset(seed=5)[0]], [], [], []
        for _ in range(STEPS):
            observation, reward, _, _, info = env.step(env.action_space.sample())
            observations.append(observation)
            rewards.append(reward)
            effective.append(info["effective"])
            values.append(building.sample.values)
        return np.array(observations), np.array(rewards), np.array(effective), building.manifest, np.array(values)


@pytest.mark.slow
@pytest.mark.process
def test_monitoring__agent_sees_the_same_to_the_bit_and_reports_see_more() -> None:
    observed, rewards, effective, manifest, values = episode()
    more_observed, more_rewards, more_effective, monitored, more_values = episode(monitoring=True)
    assert manifest.observed_names == ("core_temperature", "gas")
    assert observed.shape == (STEPS + 1, 2)
    for plain, other in ((observed, more_observed), (rewards, more_rewards), (effective, more_effective)):
        assert plain.tobytes() == other.tobytes()
    assert monitored.observed_names == manifest.observed_names
    columns = [monitored.names.index(name) for name in manifest.names]
    assert values.tobytes() == np.ascontiguousarray(more_values[:, columns]).tobytes()

    assert monitored.floor_area_m2 == pytest.approx(511.2, abs=0.2)  # of the model's documentation: 5,500 ft2
    assert {"attic", "core_zn"} < {zone.casefold() for zone in monitored.zones}
    roles_of = roles(monitored)
    assert [zone.label for zone in roles_of.zones] == [
        "Core",
        "Perimeter 1",
        "Perimeter 2",
        "Perimeter 3",
        "Perimeter 4",
    ]
    assert roles_of.zones[0].temperature == monitored.names.index("core_temperature")
    sets = [(z.heating_setpoint, z.cooling_setpoint, z.occupants, z.heating_actuator) for z in roles_of.zones]
    assert None not in {index for row in sets for index in row}
    assert roles_of.outdoor_temperature is not None

    # What the thermostat uses is what was commanded, and end uses add up to the building's meter.
    last = more_values[-1]
    heating = [zone.heating_setpoint for zone in roles_of.zones]
    names = [actuator.name for actuator in monitored.actuators]
    commanded = [
        more_effective[-1][names.index(monitored.actuators[zone.heating_actuator].name)] for zone in roles_of.zones
    ]
    assert last[heating].tolist() == commanded
    electric = [use.index for use in roles_of.end_uses if use.fuel == "electricity"]
    facility = next(fuel.index for fuel in roles_of.fuels if fuel.fuel == "electricity")
    np.testing.assert_allclose(more_values[:, electric].sum(axis=1), more_values[:, facility], rtol=1e-9)
