"""The points of a node in Brick's terms: their classes, and the zones and equipment that they belong to; no RDF."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from zenostat.models.building.conflicts import thermostat_setpoints
from zenostat.models.building.locations import LOOPS, locations, texts
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.models.semantic.brick_classes import (
    LEAVING_SETPOINT,
    METERS,
    NODE_VARIABLES,
    OTHER_METER,
    SENSOR_OF_UNIT,
    SETPOINT_OF_UNIT,
    VARIABLES,
)
from zenostat.models.semantic.equipment import Key, Structure
from zenostat.topics import keys
from zenostat.topics.energyplus_names import COOLING_SETPOINT, HEATING_SETPOINT, SCHEDULE_VALUE, THERMOSTAT
from zenostat.topics.messages import Actuator, Meter, Sensor

_ZONE_SETPOINTS = {
    HEATING_SETPOINT.casefold(): "Heating_Zone_Air_Temperature_Setpoint",
    COOLING_SETPOINT.casefold(): "Cooling_Zone_Air_Temperature_Setpoint",
}
_SCHEDULE_FIELD = "schedule_name"


class Points(Protocol):
    """Points of a node, as a manifest has them."""

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors."""

    @property
    def meters(self) -> tuple[Meter, ...]:
        """The meters."""

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """The actuators."""


@dataclass(frozen=True, slots=True)
class SemanticPoint:
    """A point of the bus in Brick's terms.

    Attributes:
        point: its entry in the manifest.
        brick_class: its class.
        owners: the zones or equipment whose point it is; the building if the model shows nothing closer; none for a
            meter's reading, which is the meter's.
        loop: the plant loop that has it as a part; None for all others.
        meter_class: class of the meter whose reading it is; empty if it is none.
        metered: what this meter meters: the building, if it is that of the whole building.
    """

    point: Sensor | Meter | Actuator
    brick_class: str
    owners: tuple[Key, ...]
    loop: Key | None = None
    meter_class: str = ""
    metered: tuple[Key, ...] = ()

    @property
    def is_whole_building(self) -> bool:
        """Whether it is the reading of a meter of the whole building."""
        return bool(self.metered)


class _Node(NamedTuple):
    """A node of a loop with its place: `supply air`, `return air` or `supply water`."""

    loop: Key
    place: str


def semantic_points(objects: ModelObjects, structure: Structure, points: Points) -> list[SemanticPoint]:
    """Return the sensors, meters and actuators of a node with their classes and owners, in the manifest's order."""
    owners = _Owners(objects, structure)
    return [
        *(owners.sensor(sensor) for sensor in points.sensors),
        *(_meter(structure, meter) for meter in points.meters),
        *(owners.actuator(actuator) for actuator in points.actuators),
    ]


class _Owners:
    """Lookup of the entities that the keys of points name; names are case-folded."""

    def __init__(self, objects: ModelObjects, structure: Structure) -> None:
        self._structure = structure
        self._zones = {key.name.casefold(): key for key in structure.classes if key.kind == "Zone"}
        named: dict[str, list[Key]] = defaultdict(list)
        for key in structure.equipment:
            named[key.name.casefold()].append(key)
        self._equipment = {name: keys[0] for name, keys in named.items() if len(keys) == 1}
        self._loops = {key.name.casefold(): key for key in structure.classes if key.kind in LOOPS}
        self._nodes = dict(_loop_nodes(objects))
        self._places = {name.casefold(): place for name, place in locations(objects).items()}
        self._schedules = _schedule_uses(objects)
        self._setpoints: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for zone, control, schedule in thermostat_setpoints(objects):
            self._setpoints[schedule].append((zone, control))

    def sensor(self, sensor: Sensor) -> SemanticPoint:
        """Return a sensor with its class and owners."""
        variable, key = sensor.variable.casefold(), sensor.key.casefold()
        node = self._nodes.get(key)
        brick_class = VARIABLES.get(variable) or (node and NODE_VARIABLES.get((variable, node.place)))
        if variable == SCHEDULE_VALUE.casefold():
            return self._of_schedule(sensor, key, is_command=False)
        if brick_class is None and variable == "system node setpoint temperature":
            return self._node_setpoint(sensor, key)
        return self._at(sensor, brick_class or SENSOR_OF_UNIT.get(sensor.unit, "Sensor"), key)

    def actuator(self, actuator: Actuator) -> SemanticPoint:
        """Return an actuator with its class and owners."""
        component, control, key = (
            text.casefold() for text in (actuator.component_type, actuator.control_type, actuator.key)
        )
        if component == THERMOSTAT.casefold() and control in _ZONE_SETPOINTS:
            return self._at(actuator, _ZONE_SETPOINTS[control], key)
        if control == SCHEDULE_VALUE.casefold():
            return self._of_schedule(actuator, key, is_command=True)
        if component == "system node setpoint" and "temperature" in control:
            return self._node_setpoint(actuator, key)
        return self._at(actuator, SETPOINT_OF_UNIT.get(actuator.unit, "Command"), key)

    def _at(self, point: Sensor | Actuator, brick_class: str, key: str) -> SemanticPoint:
        owner, loop = self._owner(key)
        return SemanticPoint(point, brick_class, (owner,), loop)

    def _owner(self, key: str) -> tuple[Key, Key | None]:
        """Return the owner of a point with this key of EnergyPlus, and its plant loop."""
        node = self._nodes.get(key)
        candidate = self._zones.get(key) or self._equipment.get(key) or self._loops.get(key)
        candidate = candidate or (node.loop if node else None)
        if candidate is None:
            place = self._places.get(key, "").casefold()
            candidate = self._zones.get(place) or self._loops.get(place)
        if candidate is None:
            return self._structure.building, None
        if candidate.kind in ("PlantLoop", "CondenserLoop"):  # Brick's loops have points as parts
            return self._structure.building, candidate
        return candidate, None

    def _node_setpoint(self, point: Sensor | Actuator, node: str) -> SemanticPoint:
        return self._at(point, self._setpoint_class(node), node)

    def _setpoint_class(self, node: str) -> str:
        """Return the class of a temperature setpoint at a node."""
        known = self._nodes.get(node)
        if known is not None and known.place == "supply air":
            return "Supply_Air_Temperature_Setpoint"
        if known is not None and known.place == "supply water":
            loop_class = self._structure.classes.get(known.loop, "")
            return LEAVING_SETPOINT.get(loop_class, "Leaving_Water_Temperature_Setpoint")
        return "Temperature_Setpoint"

    def _of_schedule(self, point: Sensor | Actuator, schedule: str, *, is_command: bool) -> SemanticPoint:
        """Return a schedule: the setpoint of the zones or of the node that use it, or what its fields say."""
        zones = self._setpoints.get(schedule, [])
        controls = {control for _, control in zones}
        if zones:
            owners = tuple(dict.fromkeys(self._zones[zone] for zone, _ in zones if zone in self._zones))
            brick_class = _ZONE_SETPOINTS[controls.pop()] if len(controls) == 1 else "Temperature_Setpoint"
            return SemanticPoint(point, brick_class, owners or (self._structure.building,))
        uses = self._schedules.get(schedule, [])
        if len(uses) == 1 and uses[0].node:
            return self._node_setpoint(point, uses[0].node)
        fields = {use.field for use in uses}
        owner, loop = self._owner(uses[0].name.casefold()) if len(uses) == 1 else (self._structure.building, None)
        if fields and all("availability" in field for field in fields):
            brick_class = "Run_Enable_Command"
        elif uses and all(use.kind.startswith("Lights") for use in uses):
            brick_class = "Lighting_Level_Command"
        else:
            brick_class = "Command" if is_command else "Point"
        return SemanticPoint(point, brick_class, (owner,), loop)


class _ScheduleUse(NamedTuple):
    """An object that uses a schedule, the field, and the node whose setpoint it sets with it (empty if none)."""

    kind: str
    name: str
    field: str
    node: str


def _schedule_uses(objects: ModelObjects) -> dict[str, list[_ScheduleUse]]:
    """Return the uses of schedules by case-folded name, except those by other schedules and by outputs."""
    uses: dict[str, list[_ScheduleUse]] = defaultdict(list)
    for kind, items in objects.items():
        if kind.startswith(("Schedule:", "Output", "EnergyManagementSystem", "ThermostatSetpoint:")):
            continue
        for name, fields in items.items():
            for field, text in texts(fields):
                if field.endswith(_SCHEDULE_FIELD):
                    node = _managed_node(kind, fields)
                    uses[text.casefold()].append(_ScheduleUse(kind, name, field, node))
    return uses


def _managed_node(kind: str, fields: Mapping[str, Any]) -> str:
    """Return the node whose temperature a scheduled setpoint manager sets, case-folded; empty for other objects."""
    if kind != "SetpointManager:Scheduled" or "temperature" not in str(fields.get("control_variable", "")).casefold():
        return ""
    return str(fields.get("setpoint_node_or_nodelist_name", "")).casefold()


def _loop_nodes(objects: ModelObjects) -> Iterator[tuple[str, _Node]]:
    """Yield the ends of the loops' supply sides by the case-folded names of their nodes; of node lists, all members."""
    lists = {
        name.casefold(): [str(entry.get("node_name", "")).casefold() for entry in fields.get("nodes", ())]
        for name, fields in objects.get("NodeList", {}).items()
    }
    ends: Sequence[tuple[str, str, str]] = (
        ("AirLoopHVAC", "supply_side_inlet_node_name", "return air"),
        ("AirLoopHVAC", "supply_side_outlet_node_names", "supply air"),
        ("PlantLoop", "plant_side_outlet_node_name", "supply water"),
        ("CondenserLoop", "condenser_side_outlet_node_name", "supply water"),
    )
    for kind, field, place in ends:
        for name, fields in objects.get(kind, {}).items():
            node = str(fields.get(field, "")).casefold()
            for member in (node, *lists.get(node, ())):
                if member:
                    yield member, _Node(Key(kind, name), place)


def _meter(structure: Structure, meter: Meter) -> SemanticPoint:
    """Return a meter's reading; `Electricity:Facility`, `Cooling:Electricity` and the like name their resource."""
    words = meter.meter.casefold().split(":")
    resource = next((word for word in words if word in METERS), "")
    end_use, whole, reading = METERS.get(resource, OTHER_METER)
    is_whole = len(words) == 2 and words[1] == "facility"
    meter_class = whole if is_whole else end_use
    return SemanticPoint(meter, reading, (), None, meter_class, (structure.building,) if is_whole else ())


def bus_key(point: Sensor | Meter | Actuator, node: str) -> str:
    """Return the key of a point on the bus; in that of an actuator `*` stands for the sender."""
    topic = {"sensor": keys.SENSOR, "meter": keys.METER, "actuator": keys.ACTUATOR}[point_kind(point)]
    return topic.at(node, name=point.name, sender="*")


def point_kind(point: Sensor | Meter | Actuator) -> str:
    """Return `sensor`, `meter` or `actuator`."""
    return type(point).__name__.lower()


def meter_resource(meter: Meter) -> str:
    """Return the resource of `Electricity:Facility` and of `Cooling:Electricity`, case-folded."""
    words = meter.meter.casefold().split(":")
    return words[0] if words[-1] == "facility" else words[min(1, len(words) - 1)]
