"""Find references of a model to objects that it does not have, by the object lists of EnergyPlus's input schema."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from zenostat.models import schema
from zenostat.models.building.object_lists import named_in, object_lists, type_lists
from zenostat.topics.errors import did_you_mean

_ESSENTIAL = frozenset(
    (
        "Branches",
        "BranchLists",
        "ConnectorLists",
        "ConstructionNames",
        "ControlTypeNames",
        "DayScheduleNames",
        "MaterialName",
        "OutFaceEnvNames",
        "PlantConnectors",
        "WeekScheduleNames",
        "ZoneEquipmentNames",
    )
)
"""Object lists without which EnergyPlus ends, also where the field may be left out."""

_DEMANDING = (
    "ElectricEquipment:ITE:AirCooled",
    "Refrigeration:CompressorRack",
    "ThermostatSetpoint:",
    "ZoneCrossMixing",
    "ZoneInfiltration:",
    "ZoneMixing",
    "ZoneVentilation:",
)
"""Types with fields that may be left out, and whose wrong schedules or curves end EnergyPlus; most by a crash."""

_VRF_CURVE = "cooling_{}_ratio_modifier_function_of_low_temperature_curve_name"
_CRASHING = frozenset(
    (
        ("AirConditioner:VariableRefrigerantFlow", _VRF_CURVE.format("capacity")),
        ("AirConditioner:VariableRefrigerantFlow", _VRF_CURVE.format("energy_input")),
        ("ZoneHVAC:TerminalUnit:VariableRefrigerantFlow", "supply_air_fan_object_name"),
    )
)
"""Other fields that may be left out, and at whose missing object EnergyPlus crashes."""

_TOLERATED = frozenset((("Sizing:Plant", "plant_or_condenser_loop_name"),))
"""Required fields whose object may be missing."""

_IGNORED = ("Output", "UtilityCost:", "LifeCycleCost:", "ComponentCost:")
"""Types that do not act on the simulation, whose references do not matter."""

_ZONE_OR_SPACE = (frozenset(("SpaceNames", "ZoneNames")), frozenset(("SpaceAndSpaceListNames", "ZoneAndZoneListNames")))
"""Object lists of fields that EnergyPlus reads after it has created spaces of its own."""

_NOUNS = {
    "ScheduleNames": "schedule",
    "MaterialName": "material",
    "UnivariateFunctions": "curve of one variable",
    "BivariateFunctions": "curve of two variables",
    "MultivariateFunctions": "curve",
    "OutFaceEnvNames": "surface, zone or boundary condition",
    "ControlSchemeList": "plant equipment operation scheme",
    "ControlTypeNames": "thermostat setpoint",
    "AllHeatTranSurfNames": "surface",
    "AllShadingAndHTSurfNames": "surface",
    "SurfAndSubSurfNames": "surface",
    "SubSurfNames": "window or door",
    "GlazedExtSubSurfNames": "exterior window",
    "ElecStorageList": "electrical storage",
    "ConverterList": "converter",
    "InverterList": "inverter",
    "ErlProgramNames": "EMS program",
    "CompactHVACThermostats": "HVACTemplate:Thermostat",
    "CompactHVACSystemConstantVolume": "HVACTemplate:System:ConstantVolume",
    "CompactHVACSystemDualDuct": "HVACTemplate:System:DualDuct",
    "CompactHVACSystemUnitary": "unitary HVACTemplate:System",
    "CompactHVACSystemVAV": "HVACTemplate:System of VAV",
    "CompactHVACSystemVRF": "HVACTemplate:System:VRF",
    "HVACTemplateDOASSystems": "HVACTemplate:System:DedicatedOutdoorAir",
}

_ABBREVIATIONS = {
    "AFN": "airflow network",
    "Evap": "evaporative",
    "FC": "fuel cell",
    "Gen": "generator",
    "HX": "heat exchanger",
    "OA": "outdoor air",
    "Sup": "supply",
    "Surf": "surface",
    "Sys": "system",
}


class DanglingReference(NamedTuple):
    """A field whose value names no object.

    Attributes:
        kind, name: the object that has the field.
        field: its path, such as `zones[3].zone_name`.
        value: the name that was not found.
        lists: the object lists of the field, such as `ScheduleNames`.
        known: the names that it could have.
        actual: type of an object of that name that the field cannot refer to; empty if there is none.
    """

    kind: str
    name: str
    field: str
    value: str
    lists: tuple[str, ...]
    known: tuple[str, ...]
    actual: str = ""

    @property
    def is_fatal(self) -> bool:
        """Whether EnergyPlus ends because of it.

        Tried for 348 fields of the bundled models: EnergyPlus 25.2 ends at each wrong name in a required field, and at
        most of those in others, where it decides.
        """
        if self.kind.startswith(_IGNORED) or (self.kind, self.field) in _TOLERATED:
            return False
        if (self.kind, self.field) in _CRASHING:
            return True
        is_demanded = self.kind.startswith(_DEMANDING) and re.search(r"schedule|curve", self.field) is not None
        return is_demanded or not _ESSENTIAL.isdisjoint(self.lists) or schema.is_required(self.kind, self.field)

    def describe(self) -> str:
        """Return the text of an error: object, field, value, and similar names."""
        text = f"{self.kind} {self.name!r}: {self.field} is {self.value!r}"
        noun = " or ".join(dict.fromkeys(_NOUNS.get(each) or _noun(each) for each in self.lists[:3]))
        if self.actual:
            return f"{text}, which is a {self.actual}, no {noun}; {did_you_mean(self.value, self.known)}"
        return f"{text}, but the model has no {noun} of that name; {did_you_mean(self.value, self.known)}"


def _noun(object_list: str) -> str:
    """Return what an object list holds in words: `BranchLists` to `branch list`."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", re.sub(r"^valid|Names?$", "", object_list))
    text = " ".join(_ABBREVIATIONS.get(word) or (word if word.isupper() else word.lower()) for word in words)
    return re.sub(r"es$", "", text) if re.search(r"(ch|ss)es$", text) else text.removesuffix("s")


def dangling_references(objects: Mapping[str, Mapping[str, Any]]) -> Iterator[DanglingReference]:
    """Yield the references of a model's objects to names that no object of it has.

    Args:
        objects: a whole model as epJSON, which matches the schema.
    """
    names = _names(objects)
    kinds: dict[str, str] = {}
    types = type_lists()
    remainders = {name.casefold(): name for name in _remainders(objects)}
    for kind, items in objects.items():
        for path, lists in object_lists(kind).items():
            known = dict(remainders) if any(each.issubset(lists) for each in _ZONE_OR_SPACE) else {}
            for each in lists:
                known |= names.get(each, {})
                known |= {word.casefold(): word for word in types.get(each, ())}
            for name, fields in items.items():
                for field, value, holder in _values(name, fields, path):
                    if isinstance(value, str) and value and value.casefold() not in known:
                        if _has_named_type(objects, holder, path.rpartition(".")[2]):
                            continue
                        kinds = kinds or {own.casefold(): each for each, named in objects.items() for own in named}
                        actual = kinds.get(value.casefold(), "")
                        yield DanglingReference(kind, name, field, value, tuple(lists), tuple(known.values()), actual)


def _names(objects: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, str]]:
    """Return the names in each object list, by their case-folded form."""
    names: dict[str, dict[str, str]] = defaultdict(dict)
    for kind, by_path in named_in().items():
        for path, lists in by_path.items():
            for name, fields in objects.get(kind, {}).items():
                for _, value, _ in _values(name, fields, path):
                    if isinstance(value, str):
                        for each in lists:
                            names[each][value.casefold()] = value
    return names


def _remainders(objects: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Yield the spaces that EnergyPlus creates for surfaces without a space in zones with spaces."""
    divided = {str(fields.get("zone_name", "")).casefold() for fields in objects.get("Space", {}).values()}
    kinds = [kind for kind in objects if divided and schema.has_field(kind, "space_name")]
    surfaces = [fields for kind in kinds for fields in objects[kind].values() if not fields.get("space_name")]
    for zone in dict.fromkeys(str(fields.get("zone_name", "")) for fields in surfaces):
        if zone.casefold() in divided:
            yield f"{zone}-Remainder"


def _has_named_type(objects: Mapping[str, Mapping[str, Any]], fields: Mapping[str, Any], field: str) -> bool:
    """Whether the field beside a name is a type, and an object of that type has the name.

    The object lists lack some types that the schema allows there, such as `PlantEquipmentOperation:UserDefined`.
    """
    stem, name = field.removesuffix("_name"), str(fields.get(field)).casefold()
    kind = fields.get(f"{stem}_object_type") or fields.get(f"{stem}_type")
    return any(name == own.casefold() for own in objects.get(schema.canonical_type(str(kind)) or "", ()))


def _values(name: str, fields: Mapping[str, Any], path: str) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """Yield the path and the value of a field, with the fields beside it; of one in a list, those of each entry."""
    if path == "name":
        yield "name", name, fields
        return
    first, _, member = path.partition(".")
    value = fields.get(first)
    if not member:
        yield first, value, fields
    elif isinstance(value, list):
        for index, entry in enumerate(value):
            if isinstance(entry, Mapping):
                yield f"{first}[{index}].{member}", entry.get(member), entry
