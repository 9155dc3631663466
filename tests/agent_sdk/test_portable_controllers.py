"""Controllers that ask the semantic model: patterns, setback with optimum start, and demand limiting."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import manifest as build_manifest

from zenostat.agent_sdk.controllers import Agent, PortableDemandLimit, PortableSetback
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.agent_sdk.semantic import PATTERNS, FoundPoint, SemanticGraph, find
from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building
from zenostat.models.semantic.graph import semantic_turtle
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.messages import Actuator, Meter, Sensor

HEAT, COOL = "zone_heating_setpoint", "zone_cooling_setpoint"
NAN = float("nan")


def setpoint(name: str, control: str, zone: str) -> Actuator:
    """A setpoint of a zone's thermostat, with the bounds of EnergyPlus's models."""
    low, high = (15.0, 22.5) if control == "Heating Setpoint" else (22.5, 30.0)
    return Actuator(
        name=name, component_type="Zone Temperature Control", control_type=control, key=zone, unit="degC", low=low,
        high=high,
    )  # fmt: skip


MANIFEST = build_manifest(
    sensors=[
        Sensor(name="zone_air", variable="Zone Air Temperature", key="Zone", unit="degC"),
        Sensor(name="zone_people", variable="Zone People Occupant Count", key="Zone", unit="1"),
    ],
    meters=[Meter(name="electricity", meter="Electricity:Facility", unit="J")],
    actuators=[setpoint(HEAT, "Heating Setpoint", "Zone"), setpoint(COOL, "Cooling Setpoint", "Zone")],
)


@dataclass
class Model:
    """A semantic model of one zone, without the points of some patterns."""

    without: tuple[str, ...] = ()

    def find(self, pattern: str) -> list[FoundPoint]:
        points = {
            "heating_setpoints": HEAT, "cooling_setpoints": COOL, "zone_temperatures": "zone_air",
            "occupants": "zone_people", "electricity_meter": "electricity",
        }  # fmt: skip
        return [] if pattern in self.without else [FoundPoint(points[pattern], "", "Zone")]


@dataclass
class Sample:
    """A sample with an air temperature, a number of people, the power in kW, and the effective setpoints."""

    time: datetime
    air: float = 22.0
    people: float = 0.0
    power_kw: float = 0.0
    own: tuple[float, float] = (21.0, 24.0)
    value_source: dict[str, str] = field(default_factory=dict)

    @property
    def values(self) -> np.ndarray[Any, Any]:
        return np.array([self.air, self.people, self.power_kw * 1000.0 * MANIFEST.step_s])

    @property
    def effective(self) -> np.ndarray[Any, Any]:
        return np.array(self.own)


def controller(kind: type[Any], model: Model | None = None, **parameters: float) -> Any:
    """A controller that has found its points and begun an episode."""
    created = kind(MANIFEST, **parameters)
    created.use_model(model or Model())
    created.begin(Sample(datetime(2017, 7, 3)))
    return created


def day(control: Any, date: datetime, air: float = 22.0) -> dict[datetime, dict[str, float | None]]:
    """The commands of a day on which people are present from 8 to 17 o'clock."""
    times = [date + timedelta(minutes=15 * i) for i in range(96)]
    return {now: control.act(Sample(now, air, people=float(8 <= now.hour < 17))) for now in times}


def test_portable_setback__leaves_occupied_zones_and_the_first_hours_to_the_building() -> None:
    control = controller(PortableSetback)
    commands = day(control, datetime(2017, 7, 3))
    for now, values in commands.items():
        expected = {HEAT: None, COOL: None} if now.hour < 17 else {HEAT: 16.0, COOL: 29.0}
        assert values == expected, now


def test_portable_setback__starts_by_the_distance_to_the_occupied_setpoint() -> None:
    control = controller(PortableSetback, start_rate=2.0, start_learning=0.0)
    day(control, datetime(2017, 7, 3))
    commands = day(control, datetime(2017, 7, 4), air=27.0)  # 3 K above 24: one and a half hours before 7:45
    cooling = {now.time(): values[COOL] for now, values in commands.items() if now.hour < 8}
    # people were first measured at 8:00, so they came in the timestep that began at 7:45
    assert next(str(now)[:5] for now, value in cooling.items() if value == 24.0) == "06:15"
    assert all(values[HEAT] == 16.0 for now, values in commands.items() if now.hour < 8)


def test_portable_setback__stays_within_bounds() -> None:
    control = controller(PortableSetback, setback=10.0)
    assert day(control, datetime(2017, 7, 3))[datetime(2017, 7, 3, 20)] == {HEAT: 15.0, COOL: 30.0}


def test_portable_setback__learns_the_most_demanding_value_while_nobody_commands() -> None:
    control = controller(PortableSetback)
    start = datetime(2017, 7, 3, 8)
    for own, source in (((20.0, 25.0), ""), ((21.0, 24.0), ""), ((22.5, 23.0), "somebody"), ((20.5, 24.5), "")):
        control.act(Sample(start, people=1.0, own=own, value_source={HEAT: source, COOL: source}))
    assert control.act(Sample(start + timedelta(hours=12))) == {HEAT: 16.0, COOL: 29.0}


def test_portable_setback__without_occupant_counts_leaves_all_to_the_building_and_says_so() -> None:
    control = controller(PortableSetback, Model(("occupants", "zone_temperatures")))
    assert all(values == {HEAT: None, COOL: None} for values in day(control, datetime(2017, 7, 3)).values())
    assert control.lacks == ["occupant count in 1 of 1 zones", "air temperature in 1 of 1 zones"]


def test_portable_limit__relaxes_setpoints_near_the_limit_and_returns_slowly() -> None:
    control = controller(PortableDemandLimit, limit_kw=100.0, start=0.8, amount=2.0)
    start = datetime(2017, 7, 3, 12)
    powers = (50.0, 90.0, 100.0, 50.0)
    commands = [control.act(Sample(start + timedelta(minutes=15 * i), power_kw=p)) for i, p in enumerate(powers)]
    assert commands[0] == {HEAT: None, COOL: None}
    assert commands[1] == pytest.approx({HEAT: 20.0, COOL: 25.0})  # half of the way from 80 to 100 kW: 1 K
    assert commands[2] == pytest.approx({HEAT: 19.0, COOL: 26.0})
    assert commands[3] == pytest.approx({HEAT: 19.25, COOL: 25.75})  # back by 1 K per hour


def test_portable_limit__without_a_meter_limits_nothing_and_says_so() -> None:
    control = controller(PortableDemandLimit, Model(("electricity_meter",)))
    assert control.act(Sample(datetime(2017, 7, 3), power_kw=1e6)) == {HEAT: None, COOL: None}
    assert control.lacks == ["electricity meter"]


@pytest.mark.parametrize("kind", [PortableSetback, PortableDemandLimit])
def test_portable__building_without_setpoints_is_refused(kind: type[Any]) -> None:
    with pytest.raises(ControllerMismatch, match="has no zone with a setpoint"):
        controller(kind, Model(("heating_setpoints", "cooling_setpoints")))


def test_agent__without_a_semantic_model_names_the_command_that_has_one() -> None:
    with pytest.raises(InvalidConfig, match="use it in zenostat run"):
        Agent(PortableSetback(MANIFEST))


@dataclass(frozen=True)
class Points:
    """Points of a node."""

    sensors: tuple[Sensor, ...]
    meters: tuple[Meter, ...]
    actuators: tuple[Actuator, ...]


@pytest.fixture(scope="module")
def hotel() -> SemanticGraph:
    """The large hotel with its setpoints."""
    building = read_building(find_building("hotel-large"))
    zones = list(building.objects["Zone"])
    actuators = [
        setpoint(f"{word}_{i}", f"{word} Setpoint", zone)
        for i, zone in enumerate(zones)
        for word in ("Heating", "Cooling")
    ]
    meters = (Meter(name="gas", meter="NaturalGas:Facility", unit="J"), *MANIFEST.meters)
    outdoor = Sensor(name="out", variable="Site Outdoor Air Drybulb Temperature", key="Environment", unit="degC")
    sensors = (
        outdoor,
        *(Sensor(name=f"t{i}", variable="Zone Air Temperature", key=z, unit="degC") for i, z in enumerate(zones)),
    )
    return SemanticGraph.parse(semantic_turtle(building, "office", Points(sensors, meters, tuple(actuators))))


def test_find__patterns_find_what_the_model_has(hotel: SemanticGraph) -> None:
    objects = read_building(find_building("hotel-large")).objects
    zones = len(objects["Zone"])
    counts = {pattern: len(find(hotel, pattern)) for pattern in PATTERNS}
    reheated = len(objects["AirTerminal:SingleDuct:VAV:Reheat"])
    assert counts == dict.fromkeys(PATTERNS, 0) | {
        "cooling_setpoints": zones,
        "heating_setpoints": zones,
        "zone_temperatures": zones,
        "reheat_heating_setpoints": reheated,
        "boiler_heating_setpoints": zones,  # terminal units of the one air loop, fan coils of the other zones
        "economizer_cooling_setpoints": zones,
        "outdoor_temperature": 1,
        "electricity_meter": 1,
        "gas_meter": 1,
    }
    assert {point.kind for point in hotel.find("cooling_setpoints")} == {"actuator"}
    assert {point.place for point in hotel.find("zone_temperatures")} == set(objects["Zone"])


def test_find__unknown_pattern_is_named_with_similar_ones(hotel: SemanticGraph) -> None:
    with pytest.raises(UnknownName, match=r"no pattern 'cooling_setpoint'.*cooling_setpoints"):
        hotel.find("cooling_setpoint")


def test_find__page_lists_all_patterns() -> None:
    page = (Path(__file__).parents[2] / "docs" / "semantic.md").read_text(encoding="utf-8")
    assert all(f"| `{name}` | {pattern.description} |" in page for name, pattern in PATTERNS.items())
