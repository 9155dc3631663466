"""What a building is, for listing: from the model's objects alone, no run."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from math import sqrt
from pathlib import Path
from typing import Any

from models import energyplus
from models.building.model import Building, Objects, read_building
from models.cache import cached_bytes, digest
from models.catalog import Entry
from models.points.discovery import Kinds, locations, own_zones, texts, zone_names

_FORMAT = "1"  # raised when what the facts say of the same file changes


@dataclass(frozen=True, slots=True)
class BuildingSummary:
    """A building in numbers and words.

    Areas count zones that are part of the total floor area, times their multipliers; `zones` and
    `conditioned_zones` count each zone once. A zone is conditioned by a thermostat or HVAC equipment, so a
    plenum is not. `ems_programs`: programs of the model's own energy
    management system, which can override a controller.
    """

    floor_area_m2: float
    conditioned_area_m2: float
    zones: int
    conditioned_zones: int
    hvac: str
    fuels: tuple[str, ...]
    ems_programs: int
    steps_per_hour: int


def building_summary(building: Building) -> BuildingSummary:
    """The facts of a model, from its objects; milliseconds."""
    objects = building.objects
    zones = objects.get("Zone", {})
    conditioned = {zone.casefold() for zone in zones} & _conditioned(objects)
    areas = {zone.casefold(): area for zone, area in _counted_areas(objects).items()}
    return BuildingSummary(
        floor_area_m2=sum(areas.values()),
        conditioned_area_m2=sum(area for zone, area in areas.items() if zone in conditioned),
        zones=len(zones),
        conditioned_zones=len(conditioned),
        hvac=_hvac(objects),
        fuels=_fuels(objects),
        ems_programs=len(objects.get("EnergyManagementSystem:Program", {})),
        steps_per_hour=building.steps_per_hour,
    )


def listed_summaries(entry: Entry) -> BuildingSummary:
    """The facts of a catalogue entry, kept under the file's content: the model is read once.

    Raises:
        InvalidConfig: an epJSON that is no JSON object of objects.
        ModelError: an IDF that EnergyPlus cannot read.
    """

    def make(target: Path) -> None:
        target.write_text(json.dumps(asdict(building_summary(read_building(entry)))))

    key = digest(entry.path.read_bytes(), energyplus.version(), _FORMAT)
    found: dict[str, Any] = json.loads(cached_bytes(f"facts/{key}.json", make))
    return BuildingSummary(**found | {"fuels": tuple(found["fuels"])})


# Floor area


def zone_areas(objects: Kinds) -> dict[str, float]:
    """Floor area of each zone in m2, without multipliers: the zone's own field, else its spaces' and floors'."""
    spaces = _folded(objects.get("Space", {}))
    of_zone: dict[str, float] = defaultdict(float)
    of_space: dict[str, float] = defaultdict(float)
    for zone, space, area in _floors(objects):
        if space in spaces:
            of_space[space] += area
        else:
            of_zone[zone] += area
    for space, fields in spaces.items():
        of_zone[str(fields["zone_name"]).casefold()] += _number(fields.get("floor_area")) or of_space[space]
    return {
        zone: _number(fields.get("floor_area")) or of_zone[zone.casefold()]
        for zone, fields in objects.get("Zone", {}).items()
    }


def _counted_areas(objects: Kinds) -> dict[str, float]:
    """Zones that are part of the total floor area, with their areas times their multipliers (m2)."""
    lists = _folded(objects.get("ZoneList", {}))
    group: dict[str, float] = defaultdict(lambda: 1.0)
    for fields in objects.get("ZoneGroup", {}).values():
        for _, zone in texts(lists.get(str(fields["zone_list_name"]).casefold(), {})):
            group[zone.casefold()] *= float(fields.get("zone_list_multiplier", 1))
    zones = objects.get("Zone", {})
    return {
        zone: area * float(zones[zone].get("multiplier", 1)) * group[zone.casefold()]
        for zone, area in zone_areas(objects).items()
        if str(zones[zone].get("part_of_total_floor_area", "Yes")).casefold() != "no"
    }


def _floors(objects: Kinds) -> Iterator[tuple[str, str, float]]:
    """(zone, space, area in m2) of each floor.

    A ceiling that names a zone as its other side is that zone's floor: EnergyPlus makes the surface that
    was not entered (Input Output Reference, Outside Boundary Condition "Zone").
    """
    zones = {zone.casefold() for zone in objects.get("Zone", {})}
    for kind, items in objects.items():
        if not kind.startswith(("BuildingSurface:", "Floor:", "Ceiling:", "Roof", "RoofCeiling:")):
            continue
        for fields in items.values():
            what = str(fields.get("surface_type") or kind).casefold()
            beyond = str(fields.get("outside_boundary_condition_object", "")).casefold()
            if what.startswith("floor"):
                yield _text(fields, "zone_name"), _text(fields, "space_name"), _area(fields)
            elif what.startswith(("ceiling", "roof")) and beyond in zones:
                yield beyond, "", _area(fields)


def _area(fields: Mapping[str, Any]) -> float:
    """Area of a surface in m2: length times width, or that of its polygon (Newell's sum of cross products)."""
    if "vertices" not in fields:
        return float(fields.get("length", 0)) * float(fields.get("width", 0))
    corners = [tuple(float(c[f"vertex_{axis}_coordinate"]) for axis in "xyz") for c in fields["vertices"]]
    total = [0.0, 0.0, 0.0]
    for (ax, ay, az), (bx, by, bz) in zip(corners, corners[1:] + corners[:1], strict=True):
        total[0] += ay * bz - az * by
        total[1] += az * bx - ax * bz
        total[2] += ax * by - ay * bx
    return sqrt(sum(part * part for part in total)) / 2


def _conditioned(objects: Kinds) -> set[str]:
    """Names of the zones with HVAC equipment or a thermostat."""
    zones = zone_names(objects)
    kinds = ("ZoneHVAC:EquipmentConnections", "ZoneControl:Thermostat", "HVACTemplate:Zone:")
    return {
        zone.casefold()
        for kind, items in objects.items()
        if kind.startswith(kinds)
        for fields in items.values()
        for zone in own_zones(fields, zones)
    }


# HVAC and fuels in words

# Beginnings of object types, in the order of the text.
_SYSTEMS = (
    ("ZoneHVAC:IdealLoadsAirSystem", "ideal loads"),
    ("HVACTemplate:Zone:IdealLoadsAirSystem", "ideal loads"),
    ("AirConditioner:VariableRefrigerantFlow", "variable refrigerant flow"),
    ("ZoneHVAC:PackagedTerminalAirConditioner", "PTAC"),
    ("ZoneHVAC:PackagedTerminalHeatPump", "PTHP"),
    ("ZoneHVAC:WindowAirConditioner", "window air conditioners"),
    ("ZoneHVAC:FourPipeFanCoil", "fan coils"),
    ("ZoneHVAC:UnitVentilator", "unit ventilators"),
    ("ZoneHVAC:UnitHeater", "unit heaters"),
    ("ZoneHVAC:Baseboard", "baseboards"),
    ("ZoneHVAC:HighTemperatureRadiant", "radiant heaters"),
    ("ZoneHVAC:CoolingPanel", "cooling panels"),
    ("Coil:Cooling:WaterToAirHeatPump", "water-source heat pumps"),
    ("Coil:Cooling:DX", "DX cooling"),
    ("EvaporativeCooler", "evaporative cooler"),
    ("Chiller", "chiller"),
    ("DistrictCooling", "district cooling"),
    ("Coil:Heating:DX", "heat pump heating"),
    ("HeatPump:", "plant heat pump"),
    ("Boiler", "boiler"),
    ("DistrictHeating", "district heating"),
)


def _hvac(objects: Kinds) -> str:
    """A short text: air loops, zone equipment, cooling, heating, what stands in the ducts and surfaces."""
    holders = _coil_holders(objects)

    def held(name: str) -> str:
        return holders.get(name.casefold(), "")

    central = [
        kind
        for kind, items in objects.items()
        if not kind.startswith("Coil:")
        or any(not held(name).startswith(("ZoneHVAC:", "AirTerminal:")) for name in items)
    ]
    said = [*_air_loops(objects), *_radiant(objects)]
    said += [words for start, words in _SYSTEMS if any(kind.startswith(start) for kind in central)]
    said += [
        f"{_fuel_words(fields.get('fuel_type', 'NaturalGas')).removeprefix('natural ')} furnace"
        for name, fields in objects.get("Coil:Heating:Fuel", {}).items()
        if not held(name).startswith(("ZoneHVAC:", "AirTerminal:"))
    ]
    said += [
        "electric reheat" if held(name).startswith("AirTerminal:") else "electric heating"
        for name in objects.get("Coil:Heating:Electric", {})
        if not held(name).startswith("ZoneHVAC:")
    ]
    return ", ".join(dict.fromkeys(said)) or "none"


def _coil_holders(objects: Kinds) -> dict[str, str]:
    """Coil to the type of the object that it is a part of, coil systems passed over."""
    direct = {
        coil.casefold(): (kind, name.casefold())
        for kind, items in objects.items()
        for name, fields in items.items()
        for field, coil in texts(fields)
        if field.endswith("coil_name")
    }
    held: dict[str, str] = {}
    for coil, holder in direct.items():
        kind, name = holder
        for _ in range(3):
            if not kind.startswith("CoilSystem:") or name not in direct:
                break
            kind, name = direct[name]
        held[coil] = kind
    return held


def _air_loops(objects: Kinds) -> list[str]:
    """`3 air loops VAV`: how many, and whether their fans' flow varies."""
    loops = objects.get("AirLoopHVAC", {})
    if not loops:
        return []
    where = locations(objects)
    varying = {
        where.get(name.upper())
        for kind, items in objects.items()
        if kind.startswith("Fan:")
        for name, fields in items.items()
        if kind == "Fan:VariableVolume" or fields.get("speed_control_method") == "Continuous"
    } & set(loops)
    text = f"{len(loops)} air loop" + ("s" if len(loops) > 1 else "")
    if len(varying) == len(loops):
        return [f"{text} VAV"]
    return [f"{text} ({len(varying)} VAV)" if varying else text]


def _radiant(objects: Kinds) -> list[str]:
    """`radiant floor`, by the surfaces that the radiant systems are in."""
    surfaces = _folded(objects.get("BuildingSurface:Detailed", {}))
    groups = _folded(objects.get("ZoneHVAC:LowTemperatureRadiant:SurfaceGroup", {}))
    said = []
    for kind, items in objects.items():
        if kind.startswith("ZoneHVAC:LowTemperatureRadiant:"):
            for fields in [f for f in items.values() if "surface_name_or_radiant_surface_group_name" in f]:
                named = str(fields["surface_name_or_radiant_surface_group_name"]).casefold()
                names = [text.casefold() for _, text in texts(groups.get(named, {}))] or [named]
                said += [f"radiant {surfaces[n]['surface_type']}".lower() for n in names if n in surfaces]
        elif kind.startswith("ZoneHVAC:VentilatedSlab"):
            said.append("ventilated slab")
    return list(dict.fromkeys(said))


_FUEL_FIELD = re.compile(r"(\w+_)?fuel(_use)?_type")

# Object types whose fuel stands in their name, or is what EnergyPlus takes where the field is left out.
_FUEL_OF = {
    "Coil:Heating:Fuel": "NaturalGas",
    "Coil:Heating:Gas:MultiStage": "NaturalGas",
    "GasEquipment": "NaturalGas",
    "Humidifier:Steam:Gas": "NaturalGas",
    "DistrictCooling": "DistrictCooling",
    "DistrictHeating:Water": "DistrictHeatingWater",
    "DistrictHeating:Steam": "DistrictHeatingSteam",
    "HotWaterEquipment": "DistrictHeatingWater",
    "SteamEquipment": "DistrictHeatingSteam",
}
_ELECTRIC = ("Lights", "Electric", "Exterior:Lights", "Fan:", "Pump:", "Chiller:Electric", "Coil:Cooling:DX")
_IDEAL_LOADS = {"cooling_fuel_type": "DistrictCooling", "heating_fuel_type": "DistrictHeatingWater"}


def _fuels(objects: Kinds) -> tuple[str, ...]:
    """What the building uses, electricity first: `natural gas`, `district heating water`, and so on."""
    found = {"electricity"} if any(kind.startswith(_ELECTRIC) for kind in objects) else set()
    for kind, items in objects.items():
        for fields in items.values():
            own = {field: text for field, text in fields.items() if _FUEL_FIELD.fullmatch(field)}
            if kind == "ZoneHVAC:IdealLoadsAirSystem":
                own = _IDEAL_LOADS | own
            elif not own and kind in _FUEL_OF:
                own = {"": _FUEL_OF[kind]}
            found |= {_fuel_words(text) for text in own.values()}
    return tuple(sorted(found - {"none"}, key=lambda fuel: (fuel != "electricity", fuel)))


def _fuel_words(fuel: str) -> str:
    """`NaturalGas` is `natural gas`."""
    return re.sub(r"(?<=[a-z])(?=[A-Z0-9])", " ", fuel).lower()


def _folded(items: Objects) -> dict[str, dict[str, Any]]:
    return {name.casefold(): fields for name, fields in items.items()}


def _text(fields: Mapping[str, Any], field: str) -> str:
    return str(fields.get(field, "")).casefold()


def _number(value: object) -> float:
    """A number field's value; 0 where it is left out or `Autocalculate`."""
    return float(value) if isinstance(value, (int, float)) else 0.0
