"""The entities of a building in the tags of Project Haystack 4: site, spaces, equipment, plants, meters and points.

They are derived from the classes and relations of the Brick graph. Tags are those of Haystack's definitions
(https://project-haystack.org/doc/appendix/def), which a test reads. `bacnetCur` and `bacnetWrite` are those of Haystack
servers' BACnet connectors; `modbusInputRegister`, `modbusHoldingRegister` (addresses from 0) and `zenostatKey` are own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from zenostat.models.building.model import Building
from zenostat.models.semantic.brick_classes import SUPERCLASSES
from zenostat.models.semantic.equipment import Key, Relation, Structure, read_structure
from zenostat.models.semantic.points import Points, SemanticPoint, bus_key, meter_resource, point_kind, semantic_points
from zenostat.models.semantic.triples import encoded_name
from zenostat.topics.device_addresses import ObjectKind, bacnet_objects, holding_register, input_register
from zenostat.topics.extras import requires_extra
from zenostat.topics.messages import Actuator, Meter

with requires_extra("semantic", "a file of Project Haystack", "rusty-haystack"):
    from rusty_haystack import HCol, HDict, HGrid, Marker, Number, Ref, encode_grid

ENTITY_TAGS: Mapping[str, str] = {
    "AHU": "ahu equip",
    "Active_Chilled_Beam": "chilledBeam equip",
    "Boiler": "boiler equip",
    "Building": "site",
    "Building_Electrical_Meter": "elec meter equip siteMeter",
    "Building_Meter": "meter equip siteMeter",
    "Chilled_Water_Coil": "coolingCoil equip chilledWaterCooling",
    "Chilled_Water_Loop": "chilled water plant equip",
    "Chilled_Water_Pump": "chilled water pump motor equip",
    "Chiller": "chiller equip",
    "Coil": "coil equip",
    "Condenser_Water_Loop": "condenser water plant equip",
    "Condenser_Water_Pump": "condenser water pump motor equip",
    "Constant_Air_Volume_Box": "cav equip",
    "Cooling_Coil": "coolingCoil equip",
    "Cooling_Tower": "coolingTower equip",
    "Direct_Expansion_Cooling_Coil": "coolingCoil equip dxCooling",
    "Direct_Expansion_Heating_Coil": "heatingCoil equip dxHeating",
    "Domestic_Water_Loop": "domestic water plant equip",
    "Electrical_Meter": "elec meter equip",
    "Equipment": "equip",
    "Exhaust_Fan": "exhaust fan motor equip",
    "Fan": "fan motor equip",
    "Fan_Coil_Unit": "fcu equip",
    "HVAC_Zone": "hvac zone space",
    "Heat_Exchanger": "heatExchanger equip",
    "Heating_Coil": "heatingCoil equip",
    "Hot_Water_Coil": "heatingCoil equip hotWaterHeating",
    "Hot_Water_Loop": "hot water plant equip",
    "Hot_Water_Pump": "hot water pump motor equip",
    "Humidifier": "humidifier equip",
    "Loop": "plant equip",
    "Meter": "meter equip",
    "Pump": "pump motor equip",
    "Radiant_Panel": "radiantEquip equip",
    "Radiator": "radiator equip",
    "Space": "space",
    "Supply_Fan": "discharge fan motor equip",
    "Tank": "tank equip",
    "Terminal_Unit": "airTerminalUnit equip",
    "VAV": "vav equip",
    "Water_Loop": "water plant equip",
    "Zone": "zone space",
}
"""Brick class of a location, equipment or loop to tags; classes that are left out have those of a superclass."""

POINT_TAGS: Mapping[str, str] = {
    "Air_Temperature_Sensor": "air temp sensor",
    "Air_Temperature_Setpoint": "air temp sp",
    "CO2_Level_Sensor": "air co2 concentration sensor",
    "Command": "cmd",
    "Cooling_Zone_Air_Temperature_Setpoint": "zone air temp cooling sp",
    "Effective_Cooling_Zone_Air_Temperature_Setpoint": "zone air temp cooling effective sp",
    "Effective_Heating_Zone_Air_Temperature_Setpoint": "zone air temp heating effective sp",
    "Electric_Power_Sensor": "elec power sensor",
    "Electrical_Energy_Usage_Sensor": "elec energy sensor",
    "Enable_Command": "enable cmd",
    "Energy_Sensor": "energy sensor",
    "Flow_Sensor": "flow sensor",
    "Flow_Setpoint": "flow sp",
    "Heating_Zone_Air_Temperature_Setpoint": "zone air temp heating sp",
    "Humidity_Sensor": "air humidity sensor",
    "Humidity_Setpoint": "air humidity sp",
    "Illuminance_Sensor": "illuminance sensor",
    "Leaving_Chilled_Water_Temperature_Setpoint": "leaving chilled water temp sp",
    "Leaving_Condenser_Water_Temperature_Setpoint": "leaving condenser water temp sp",
    "Leaving_Hot_Water_Temperature_Setpoint": "leaving hot water temp sp",
    "Leaving_Water_Temperature_Sensor": "leaving water temp sensor",
    "Lighting_Level_Command": "light level cmd",
    "Occupancy_Count_Sensor": "occupancy sensor",
    "Outside_Air_Dewpoint_Sensor": "outside air dewPoint sensor",
    "Outside_Air_Humidity_Sensor": "outside air humidity sensor",
    "Outside_Air_Temperature_Sensor": "outside air temp sensor",
    "Outside_Air_Wet_Bulb_Temperature_Sensor": "outside air wetBulb sensor",
    "Point": "",
    "Power_Sensor": "power sensor",
    "Pressure_Sensor": "pressure sensor",
    "Pressure_Setpoint": "pressure sp",
    "Return_Air_Temperature_Sensor": "return air temp sensor",
    "Run_Enable_Command": "run enable cmd",
    "Sensor": "sensor",
    "Setpoint": "sp",
    "Solar_Irradiance_Sensor": "solar irradiance sensor",
    "Speed_Sensor": "speed sensor",
    "Supply_Air_Flow_Sensor": "discharge air flow sensor",
    "Supply_Air_Humidity_Sensor": "discharge air humidity sensor",
    "Supply_Air_Temperature_Sensor": "discharge air temp sensor",
    "Supply_Air_Temperature_Setpoint": "discharge air temp sp",
    "Temperature_Sensor": "temp sensor",
    "Temperature_Setpoint": "temp sp",
    "Water_Flow_Sensor": "water flow sensor",
    "Water_Temperature_Sensor": "water temp sensor",
    "Water_Temperature_Setpoint": "water temp sp",
    "Water_Usage_Sensor": "water volume sensor",
    "Wind_Direction_Sensor": "wind direction sensor",
    "Wind_Speed_Sensor": "wind speed sensor",
    "Zone_Air_Humidity_Sensor": "zone air humidity sensor",
    "Zone_Air_Temperature_Sensor": "zone air temp sensor",
}
"""Brick class of a point to tags; classes that are left out have those of a superclass."""

UNITS: Mapping[str, str] = {
    "degC": "°C", "percent": "%", "W": "W", "J": "J", "Pa": "Pa", "kg/s": "kg/s", "m3/s": "m³/s", "m3": "m³",
    "m/s": "m/s", "deg": "deg", "lux": "lx", "W/m2": "W/m²", "ppm": "ppm", "h": "h", "s": "s",
}  # fmt: skip
"""Unit on the bus to the symbol in Haystack's database of units; other units have none."""

_PLANT_REFS = {
    "Chilled_Water_Loop": "chilledWaterRef",
    "Hot_Water_Loop": "hotWaterRef",
    "Condenser_Water_Loop": "condenserWaterRef",
}
"""Class of a loop to the tag with which equipment refers to the plant whose water it uses."""

_SPACES = ("Zone", "Space")
CODECS: Mapping[str, str] = {".zinc": "text/zinc", ".trio": "text/trio", ".json": "application/json"}
"""Suffixes of files to their format: Zinc, Trio or Haystack's JSON (Hayson)."""

Entity = dict[str, Any]


def haystack_text(name: str, entities: Sequence[Entity], suffix: str) -> str:
    """Return entities as one grid in a format of Project Haystack.

    Args:
        name: of the building, the grid's `dis`.
        entities: what `haystack_entities` returned.
        suffix: of the file, one of `CODECS`.
    """
    columns = [HCol(name) for name in dict.fromkeys(tag for entity in entities for tag in entity)]
    grid = HGrid.from_parts(HDict({"dis": _text(name)}), columns, [HDict(entity) for entity in entities])
    return encode_grid(CODECS[suffix], grid)


def haystack_entities(building: Building, node: str, points: Points) -> list[Entity]:
    """Return the entities of a building as tags: the site first, then spaces and equipment, then meters and points.

    The same model gives the same entities. All names are data: `dis` is a text, and `id` has them encoded.

    Args:
        building: the model, in the format of the installed engine.
        node: name of the node.
        points: its sensors, meters and actuators.
    """
    structure = read_structure(building.name, building.objects)
    site = _ref(structure.building)
    entities = {key: _entity(key, brick_class, site) for key, brick_class in _described(structure)}
    for zone, area_m2 in structure.areas.items():
        if area_m2 > 0.0:
            entities[zone]["area"] = Number(round(area_m2, 3), "m²")
    _relate(structure, entities)
    semantic = semantic_points(building.objects, structure, points)
    return [*entities.values(), *_meters(semantic, site), *_points(semantic, entities, node, points, site)]


def tags_of(brick_class: str, table: Mapping[str, str]) -> list[str]:
    """Return the tags of a class, or of its first superclass that has any in the table."""
    pending = [brick_class]
    for name in pending:
        if name in table:
            return table[name].split()
        pending += SUPERCLASSES.get(name, ())
    return []


def _described(structure: Structure) -> Iterator[tuple[Key, str]]:
    """Yield all entities but the loops of air handlers, which are the air handlers themselves."""
    for key, brick_class in structure.classes.items():
        if brick_class != "Air_Loop":
            yield key, brick_class


def _ref(key: Key) -> Ref:
    """Return the reference to an entity: letters, digits, `_`, `-`, `.` and `~`, which stands for `%` of a URI."""
    return Ref(f"{encoded_name(key.kind)}.{encoded_name(key.name)}".replace("%", "~"))


def _entity(key: Key, brick_class: str, site: Ref) -> Entity:
    entity: Entity = {"id": _ref(key), "dis": _text(key.name)}
    entity |= dict.fromkeys(tags_of(brick_class, ENTITY_TAGS) or ["equip"], Marker())
    return entity if "site" in entity else {**entity, "siteRef": site}


def _text(name: str) -> str:
    """Return a name without halves of surrogate pairs, which no file can have."""
    return name.encode(errors="surrogatepass").decode(errors="replace")


def _relate(structure: Structure, entities: Mapping[Key, Entity]) -> None:
    """Add the references between entities."""
    plants: dict[Key, list[Key]] = {}
    served: list[tuple[Key, Key]] = []
    for link in structure.links:
        if link.relation is Relation.INCLUDES:
            if link.subject in entities:  # loops of air handlers are none
                plants.setdefault(link.subject, []).append(link.object)
        elif link.relation is Relation.HAS_PART:
            _refer(entities, link.object, "spaceRef" if link.object.kind in _SPACES else "equipRef", link.subject)
        elif link.object.kind in _SPACES:  # it feeds a zone, or exhausts its air
            _refer(entities, link.subject, "spaceRef", link.object)
        elif structure.classes[link.subject] == "AHU":
            _refer(entities, link.object, "airRef", link.subject)
        else:
            served.append((link.subject, link.object))
    # A chiller belongs to the plant of its chilled water, and uses that of its condenser's.
    for plant in sorted(plants, key=lambda loop: structure.classes[loop] == "Condenser_Water_Loop"):
        members = set(plants[plant])
        uses = {target for source, target in served if source in members and target in members}
        for key in plants[plant]:
            _refer(entities, key, _PLANT_REFS.get(structure.classes[plant], "") if key in uses else "equipRef", plant)


def _refer(entities: Mapping[Key, Entity], key: Key, tag: str, target: Key) -> None:
    """Add a reference, unless the entity has one of that tag; the site is not equipment and no space."""
    if tag and "site" not in entities[target]:
        entities[key].setdefault(tag, entities[target]["id"])


def _meter_key(meter: Meter) -> Key:
    return Key("Meter", meter.meter or meter.name)


def _meters(semantic: list[SemanticPoint], site: Ref) -> Iterator[Entity]:
    """Yield the meters; those of an end use are submeters of that of the building."""
    readings = [(each, each.point) for each in semantic if isinstance(each.point, Meter)]
    main = {meter_resource(meter): _ref(_meter_key(meter)) for each, meter in readings if each.is_whole_building}
    for each, meter in readings:
        entity = _entity(_meter_key(meter), each.meter_class, site)
        if not each.is_whole_building and meter_resource(meter) in main:
            entity |= {"submeter": Marker(), "submeterOf": main[meter_resource(meter)]}
        yield entity


def _points(
    semantic: list[SemanticPoint], entities: Mapping[Key, Entity], node: str, points: Points, site: Ref
) -> Iterator[Entity]:
    """Yield the points with their places, units and addresses."""
    inputs = [*(sensor.name for sensor in points.sensors), *(meter.name for meter in points.meters)]
    readings, outputs = bacnet_objects(node, inputs, [actuator.name for actuator in points.actuators])
    for position, (each, named) in enumerate(zip(semantic, (*readings, *outputs), strict=True)):
        point = each.point
        entity = {
            "id": _ref(Key(point_kind(point), point.name)),
            "dis": point.name,
            "point": Marker(),
            **dict.fromkeys(tags_of(each.brick_class, POINT_TAGS), Marker()),
            "kind": "Number",
            "siteRef": site,
            **_place(each, entities),
        }
        if (unit := UNITS.get(point.unit)) is not None:
            entity["unit"] = unit
        letters = "AI" if named.kind is ObjectKind.INPUT else "AO"
        entity["bacnetCur"] = f"{letters}{named.instance}"
        entity["modbusInputRegister"] = Number(input_register(position))
        entity["zenostatKey"] = bus_key(point, node)
        if isinstance(point, Actuator):
            entity["writable"] = Marker()
            entity["bacnetWrite"] = entity["bacnetCur"]
            entity["modbusHoldingRegister"] = Number(holding_register(position - len(inputs)))
        yield entity


def _place(each: SemanticPoint, entities: Mapping[Key, Entity]) -> Entity:
    """Return the reference of a point to its equipment or space; none if these are several, or the site."""
    if isinstance(each.point, Meter):
        return {"equipRef": _ref(_meter_key(each.point))}
    owners = [each.loop] if each.loop is not None else [owner for owner in each.owners if owner.kind != "Building"]
    if len(owners) != 1 or owners[0] not in entities:
        return {}
    return {"spaceRef" if owners[0].kind in _SPACES else "equipRef": _ref(owners[0])}
