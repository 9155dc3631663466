"""Registry of scenarios by id: those of the data packs, and one for each bundled building in each bundled weather."""

from __future__ import annotations

import os
import re
from pathlib import Path

from zenostat.models.building.model import Building
from zenostat.models.points.selection import Points
from zenostat.models.scenario.schema import ActionSpec, ActuatorSpec, DiscreteActionSpec, Scenario, SensorSpec
from zenostat.models.weather.noise import ColumnNoise, Variability
from zenostat.topics.errors import UnknownName, did_you_mean
from zenostat.topics.messages import Actuator, Sensor, Task
from zenostat.topics.scenario_ids import BUILDINGS, PAPER_IDS, WEATHERS, all_ids, pack_ids

STEPS = 10
"""Number of choices of the discrete scenarios, the same as in Sinergym's."""

_ID = re.compile(
    rf"({'|'.join(map(re.escape, sorted(BUILDINGS, key=len, reverse=True)))})-({'|'.join(map(re.escape, WEATHERS))})"
    r"-(continuous|discrete)(-stochastic)?-v1"
)


def default_weather_noise() -> Variability:
    """Return the weather noise of the paper's stochastic scenarios: temperature in K, humidity in percent."""
    return {
        "dry_bulb_temperature": ColumnNoise(sigma=1.0, mu=0.0, tau_h=24.0),
        "relative_humidity": ColumnNoise(sigma=(2.0, 5.0), mu=0.0, tau_h=24.0),
    }


def find_scenario(text: str) -> Scenario:
    """Return the scenario with an id, with or without `zenostat/`.

    Raises:
        UnknownName: there is none; the text lists similar ids.
        InvalidConfig: it needs a data pack that has not been added.
    """
    name = text.removeprefix("zenostat/")
    if name in pack_ids():
        from zenostat.models.sinergym.scenarios import pack_scenarios

        return pack_scenarios()[name]
    if name in PAPER_IDS:
        from zenostat.models.scenario.sinergym_paper import paper_scenarios

        return paper_scenarios()[name]
    match = _ID.fullmatch(name)
    if not match and os.path.isfile(f"{os.path.expanduser(text)}/scenario.yaml"):  # noqa: PTH111  # any text
        raise UnknownName(f"no scenario {text!r}; that folder has one: {Path(text) / 'scenario.yaml'}")
    if not match:
        raise UnknownName(f"no scenario {text!r}; {did_you_mean(name, all_ids())}")
    building, weather, form, stochastic = match.groups()
    return Scenario(
        id=name,
        about=f"{building} in {weather}: one pair of setpoints for all its zones"
        + (", ten steps" if form == "discrete" else "")
        + (", weather with noise" if stochastic else ""),
        building=building,
        weather=(weather,),
        weather_noise=default_weather_noise() if stochastic else {},
        control="building",
        discrete=STEPS if form == "discrete" else None,
    )


def expanded(scenario: Scenario, building: Building, points: Points, task: Task) -> Scenario:
    """Return the scenario with the defaults that were chosen from the model filled in, for reading and editing."""
    period = building.period(scenario.begin, scenario.end, scenario.steps_per_hour)
    defaults: dict[str, object] = {
        "begin": period.begin.isoformat(),
        "end": period.end.isoformat(),
        "steps_per_hour": period.steps_per_hour,
        "sensors": {
            s.name: _sensor(s, scenario) for s in points.sensors if s.observed or s.name in scenario.unobserved
        },
        "meters": {m.name: m.meter for m in points.meters if m.observed or m.name in scenario.unobserved},
        "actuators": {a.name: _actuator(a) for a in points.actuators},
    }
    update = {name: value for name, value in defaults.items() if getattr(scenario, name) is None}
    if scenario.actions is None and scenario.control != "point":
        update["actions"] = {
            a.name: ActionSpec(actuators=a.actuators)
            if a.relative
            else ActionSpec(actuators=a.actuators, low=a.low, high=a.high)
            for a in task.actions
        }
    if isinstance(scenario.discrete, int):
        update["discrete"] = tuple(
            DiscreteActionSpec(actions=c.actions, values=c.values) for c in task.discrete_actions
        )
    return scenario.model_copy(update={**update, "control": "point"})


def _sensor(sensor: Sensor, scenario: Scenario) -> SensorSpec:
    aggregation = sensor.aggregation if scenario.aggregation is None else None
    lead_h = sensor.lead_s / 3600.0 or None
    return SensorSpec(variable=sensor.variable, key=sensor.key, aggregation=aggregation, lead_h=lead_h)


def _actuator(actuator: Actuator) -> ActuatorSpec:
    return ActuatorSpec(
        component_type=actuator.component_type,
        control_type=actuator.control_type,
        key=actuator.key,
        low=actuator.low,
        high=actuator.high,
    )
