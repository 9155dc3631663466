"""Summarize a building for lists, from the model's objects alone, without a simulation."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from math import sqrt
from pathlib import Path
from typing import Any

from zenostat.models import energyplus
from zenostat.models.building.locations import locations, texts, zones_of
from zenostat.models.building.model import Building, read_building
from zenostat.models.building.polygons import doubled_area
from zenostat.models.catalog import Entry
from zenostat.models.input_format.source_model import ModelObjects, ObjectsOfType
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.plurals import counted

_FORMAT = "2"  # raise it when the summary of the same file changes


@dataclass(frozen=True, slots=True)
class BuildingSummary:
    """Key figures of a building.

    Areas count zones that are part of the total floor area, times their multipliers; `zones` and
    `conditioned_zones` count each zone once. A zone is conditioned if it has a thermostat or HVAC equipment, so a
    plenum is not. `ems_programs` counts programs of the model's own energy management system, which can override a
    controller.
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
    """Summarize a model from its objects; takes milliseconds."""
    objects = building.objects
    zones = objects.get("Zone", {})
    conditioned = {zone.casefold() for zone in zones} & conditioned_zones(objects)
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
    """Summarize a catalog entry; the result is cached under the file's content, so the model is read once.

    Raises:
        InvalidConfig: an epJSON is not a JSON object of objects.
        ModelError: EnergyPlus cannot read the IDF.
    """

    def make(target: Path) -> None:
        target.write_text(json.dumps(asdict(building_summary(read_building(entry)))))

    key = digest(entry.path.read_bytes(), energyplus.version(), _FORMAT)
    summary: dict[str, Any] = json.loads(cached_bytes(f"facts/{key}.json", make))
    return BuildingSummary(**summary | {"fuels": tuple(summary["fuels"])})


# Floor area


def floor_area_m2(building: Building) -> float | None:
    """Return the floor area of the zones that are part of the total, times their multipliers; None if unknown."""
    try:
        return sum(_counted_areas(building.objects).values()) or None
    except (KeyError, TypeError, ValueError):  # a surface without corners, which EnergyPlus reports itself
        return None


def zone_areas(objects: ModelObjects) -> dict[str, float]:
    """Return each zone's floor area in m2 without multipliers: its own field, else the sum of its spaces and floors."""
    spaces = _folded(objects.get("Space", {}))
    of_zone: dict[str, float] = defaultdict(float)
    of_space: dict[str, float] = defaultdict(float)
    for zone, space, area in _floors(objects):
        if space in spaces:
            of_space[space] += area
        else:
            of_zone[zone] += area
    for space, fields in spaces.items():
        of_zone[str(fields.get("zone_name", "")).casefold()] += _number(fields.get("floor_area")) or of_space[space]
    return {
        zone: _number(fields.get("floor_area")) or of_zone[zone.casefold()]
        for zone, fields in objects.get("Zone", {}).items()
    }


def zone_multipliers(objects: ModelObjects) -> dict[str, float]:
    """Return the number of identical zones that each zone stands for: its multiplier times that of its zone groups."""
    lists = _folded(objects.get("ZoneList", {}))
    group: dict[str, float] = defaultdict(lambda: 1.0)
    for fields in objects.get("ZoneGroup", {}).values():
        for _, zone in texts(lists.get(str(fields["zone_list_name"]).casefold(), {})):
            group[zone.casefold()] *= float(fields.get("zone_list_multiplier", 1))
    return {
        zone: float(fields.get("multiplier", 1)) * group[zone.casefold()]
        for zone, fields in objects.get("Zone", {}).items()
    }


def _counted_areas(objects: ModelObjects) -> dict[str, float]:
    """Return the zones that are part of the total floor area, with their areas times their multipliers (m2)."""
    zones, multipliers = objects.get("Zone", {}), zone_multipliers(objects)
    return {
        zone: area * multipliers[zone]
        for zone, area in zone_areas(objects).items()
        if str(zones[zone].get("part_of_total_floor_area", "Yes")).casefold() != "no"
    }


def _floors(objects: ModelObjects) -> Iterator[tuple[str, str, float]]:
    """Yield (zone, space, area in m2) of each floor.

    A ceiling whose outside boundary is a zone is that zone's floor: EnergyPlus creates the missing surface (Input
    Output Reference, Outside Boundary Condition "Zone").
    """
    zones = {zone.casefold() for zone in objects.get("Zone", {})}
    for kind, items in objects.items():
        if not kind.startswith(("BuildingSurface:", "Floor:", "Ceiling:", "Roof", "RoofCeiling:")):
            continue
        for fields in items.values():
            surface_type = str(fields.get("surface_type") or kind).casefold()
            boundary = str(fields.get("outside_boundary_condition_object", "")).casefold()
            if surface_type.startswith("floor"):
                yield _text(fields, "zone_name"), _text(fields, "space_name"), _area(fields)
            elif surface_type.startswith(("ceiling", "roof")) and boundary in zones:
                yield boundary, "", _area(fields)


def _area(fields: Mapping[str, Any]) -> float:
    """Return a surface's area in m2: length times width, or its polygon's area."""
    if "vertices" not in fields:
        return float(fields.get("length", 0)) * float(fields.get("width", 0))
    x, y, z = ([float(c[f"vertex_{axis}_coordinate"]) for c in fields["vertices"]] for axis in "xyz")
    return sqrt(sum(part * part for part in doubled_area([*zip(x, y, z, strict=True)]))) / 2


def conditioned_zones(objects: ModelObjects) -> set[str]:
    """Return the case-folded names of the zones with HVAC equipment or a thermostat."""
    return zones_of(objects, ("ZoneHVAC:EquipmentConnections", "ZoneControl:Thermostat", "HVACTemplate:Zone:"))


def used_zones(objects: ModelObjects) -> set[str]:
    """Return the case-folded names of the zones with HVAC, people, lights or equipment; not plena and attics."""
    return conditioned_zones(objects) | zones_of(objects, ("People", "Lights", "ElectricEquipment", "GasEquipment"))


# HVAC and fuels in words

# Prefixes of object types, in the order in which they are listed.
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
    ("GroundHeatExchanger:", "ground heat exchanger"),
    ("ThermalStorage:Ice:", "ice storage"),
    ("ThermalStorage:ChilledWater:", "chilled water tank"),
    ("Dehumidifier:Desiccant:", "desiccant dehumidifier"),
)


def _hvac(objects: ModelObjects) -> str:
    """Describe the HVAC briefly: air loops, zone equipment, cooling, heating, coils in ducts and surfaces."""
    parents = _coil_parents(objects)

    def parent(name: str) -> str:
        return parents.get(name.casefold(), "")

    central = [
        kind
        for kind, items in objects.items()
        if not kind.startswith("Coil:")
        or any(not parent(name).startswith(("ZoneHVAC:", "AirTerminal:")) for name in items)
    ]
    parts = [*_air_loops(objects), *_radiant(objects)]
    parts += [words for start, words in _SYSTEMS if any(kind.startswith(start) for kind in central)]
    parts += [
        f"{_fuel_words(fields.get('fuel_type', 'NaturalGas')).removeprefix('natural ')} furnace"
        for name, fields in objects.get("Coil:Heating:Fuel", {}).items()
        if not parent(name).startswith(("ZoneHVAC:", "AirTerminal:"))
    ]
    parts += [
        "electric reheat" if parent(name).startswith("AirTerminal:") else "electric heating"
        for name in objects.get("Coil:Heating:Electric", {})
        if not parent(name).startswith("ZoneHVAC:")
    ]
    return ", ".join(dict.fromkeys(parts)) or "none"


def _coil_parents(objects: ModelObjects) -> dict[str, str]:
    """Return the type of the object that each coil belongs to, looking through coil systems."""
    direct = {
        coil.casefold(): (kind, name.casefold())
        for kind, items in objects.items()
        for name, fields in items.items()
        for field, coil in texts(fields)
        if field.endswith("coil_name")
    }
    parents: dict[str, str] = {}
    for coil, (kind, name) in direct.items():
        for _ in range(3):
            if not kind.startswith("CoilSystem:") or name not in direct:
                break
            kind, name = direct[name]  # noqa: PLW2901 (up one level)
        parents[coil] = kind
    return parents


def _air_loops(objects: ModelObjects) -> list[str]:
    """Describe the air loops, as `3 air loops VAV`: their number, and whether their fans' flow varies."""
    loops = objects.get("AirLoopHVAC", {})
    if not loops:
        return []
    location = locations(objects)
    varying = {
        location.get(name.upper())
        for kind, items in objects.items()
        if kind.startswith("Fan:")
        for name, fields in items.items()
        if kind == "Fan:VariableVolume" or fields.get("speed_control_method") == "Continuous"
    } & set(loops)
    text = counted(len(loops), "air loop")
    if len(varying) == len(loops):
        return [f"{text} VAV"]
    return [f"{text} ({len(varying)} VAV)" if varying else text]


def _radiant(objects: ModelObjects) -> list[str]:
    """Describe radiant systems by the surfaces that they are in, as `radiant floor`."""
    surfaces = _folded(objects.get("BuildingSurface:Detailed", {}))
    groups = _folded(objects.get("ZoneHVAC:LowTemperatureRadiant:SurfaceGroup", {}))
    parts = []
    for kind, items in objects.items():
        if kind.startswith("ZoneHVAC:LowTemperatureRadiant:"):
            for fields in [f for f in items.values() if "surface_name_or_radiant_surface_group_name" in f]:
                name = str(fields["surface_name_or_radiant_surface_group_name"]).casefold()
                names = [text.casefold() for _, text in texts(groups.get(name, {}))] or [name]
                parts += [f"radiant {surfaces[n]['surface_type']}".lower() for n in names if n in surfaces]
        elif kind.startswith("ZoneHVAC:VentilatedSlab"):
            parts.append("ventilated slab")
    return list(dict.fromkeys(parts))


_FUEL_FIELD = re.compile(r"(\w+_)?fuel(_use)?_type")

# Object types whose fuel is part of their name, or is EnergyPlus's default when the field is left out.
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


def _fuels(objects: ModelObjects) -> tuple[str, ...]:
    """Return the fuels that the building uses, electricity first: `natural gas`, `district heating water`, etc."""
    fuels = {"electricity"} if any(kind.startswith(_ELECTRIC) for kind in objects) else set()
    for kind, items in objects.items():
        for fields in items.values():
            own = {field: text for field, text in fields.items() if _FUEL_FIELD.fullmatch(field)}
            if kind == "ZoneHVAC:IdealLoadsAirSystem":
                own = _IDEAL_LOADS | own
            elif kind == "Generator:FuelSupply":  # its field `fuel_type` says how the composition is entered
                own = {"": "NaturalGas"}
            elif not own and kind in _FUEL_OF:
                own = {"": _FUEL_OF[kind]}
            fuels |= {_fuel_words(text) for text in own.values()}
    return tuple(sorted(fuels - {"none", "water"}, key=lambda fuel: (fuel != "electricity", fuel)))


def _fuel_words(fuel: str) -> str:
    """Convert `NaturalGas` to `natural gas`."""
    return re.sub(r"(?<=[a-z])(?=[A-Z0-9])", " ", fuel).lower()


def _folded(items: ObjectsOfType) -> dict[str, dict[str, Any]]:
    return {name.casefold(): fields for name, fields in items.items()}


def _text(fields: Mapping[str, Any], field: str) -> str:
    return str(fields.get(field, "")).casefold()


def _number(value: object) -> float:
    """Return a number field's value; 0 if it is left out or `Autocalculate`."""
    return float(value) if isinstance(value, (int, float)) else 0.0
