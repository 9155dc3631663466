"""Find what a model hardly means: zones without surfaces, setpoints or materials with swapped values, odd timesteps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from zenostat.models.building.findings import FieldFinding, RuleFinding, finding
from zenostat.models.building.locations import zones_of
from zenostat.models.building.schedule_limits import schedule_values, schedules
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.topics.calendar import format_month_day, is_month_day

_SURFACES = ("BuildingSurface", "Wall", "RoofCeiling", "Roof", "Ceiling", "Floor")

_MOST_CONDUCTIVE = 500.0
"""W/(m K); silver has 429, diamond more."""

_LIGHTEST = 1.0
"""kg/m3; air has 1.2."""

_THICKEST = 5.0
"""m; of a layer of soil, perhaps."""

_HOTTEST_HEATING_C = 40.0
"""A heating setpoint that is always above it is none of a room."""


_OTHER_PROGRAMS = (
    "ExternalInterface",
    "ExternalInterface:Actuator",
    "ExternalInterface:FunctionalMockupUnitExport",
    "ExternalInterface:FunctionalMockupUnitImport",
    "ExternalInterface:Variable",
    "PythonPlugin:Instance",
)
"""Object types that run another program within the simulation.

No wheel's EnergyPlus can run Python plug-ins, and an FMU or a co-simulation server would control the simulation's
clock alongside the node.
"""


def plausibility_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    """Yield the findings; EnergyPlus itself ends only at zones without surfaces and at unused equipment lists."""
    yield from _program_findings(objects)
    yield from _run_findings(objects)
    yield from _zone_findings(objects)
    yield from _setpoint_findings(objects)
    yield from _material_findings(objects)
    yield from _sizing_findings(objects)


def _number(fields: Mapping[str, Any], name: str, default: float) -> float:
    """Return a field's number; the default if it has none, also where the schema does not allow its value."""
    value = fields.get(name)
    return value if isinstance(value, (int, float)) else default


def _program_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    for kind in _OTHER_PROGRAMS:
        for name in objects.get(kind, {}):
            text = (
                ": FMUs, co-simulation and Python plug-ins are not supported; remove this object (in a scenario: "
                "`edits`, with null as the object), and control the building over the bus instead"
            )
            yield finding(kind, name, FieldFinding("", text))


def _run_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    if not objects.get("Version"):
        text = "the model has no Version object; it is read as one of the engine's version"
        yield RuleFinding("Version", "", "", text, is_fatal=False)
    for name, fields in objects.get("Version", {}).items():
        if not fields.get("version_identifier"):
            text = ": it lacks 'version_identifier', at which EnergyPlus crashes; '25.2' is an example"
            yield finding("Version", name, FieldFinding("", text))
    for name, fields in objects.get("Timestep", {}).items():
        steps = _number(fields, "number_of_timesteps_per_hour", 6)
        if steps >= 1 and 60 % steps:
            text = f": number_of_timesteps_per_hour is {steps:g}, which does not divide the hour; 4, 6, 10 or 12 do"
            yield finding("Timestep", name, FieldFinding("number_of_timesteps_per_hour", text, is_fatal=False))
    for name, fields in objects.get("RunPeriod", {}).items():
        for end in ("begin", "end"):
            month, day = (_number(fields, f"{end}_{part}", 1) for part in ("month", "day_of_month"))
            # The schema refuses months and days beyond these.
            if 1 <= month <= 12 and 1 <= day <= 31 and not is_month_day(int(month), int(day)):
                text = f": it {end}s on {format_month_day(int(month), int(day))}, which is no day of the year"
                yield finding("RunPeriod", name, FieldFinding(f"{end}_day_of_month", text, is_fatal=False))


def _zone_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    with_surfaces = zones_of(objects, _SURFACES)
    for name in objects.get("Zone", {}):
        if name.casefold() not in with_surfaces:
            yield finding(
                "Zone", name, FieldFinding("", ": no surface belongs to it, such as a BuildingSurface:Detailed")
            )
    if not objects.get("Zone") and not objects.get("PlantLoop"):
        text = "the model has neither a Zone nor a PlantLoop object, so there is nothing to simulate"
        yield RuleFinding("Zone", "", "", text, is_fatal=False)
    zones = {name.casefold() for name in objects.get("Zone", {})}
    controlled = zones_of(objects, ("ZoneControl:Thermostat",))
    for name, fields in objects.get("ZoneHVAC:EquipmentConnections", {}).items():
        zone = str(fields.get("zone_name", ""))
        if zone.casefold() in zones - controlled and fields.get("zone_air_inlet_node_or_nodelist_name"):
            text = f": zone {zone!r} has HVAC equipment, but no ZoneControl:Thermostat controls it"
            yield finding("ZoneHVAC:EquipmentConnections", name, FieldFinding("zone_name", text, is_fatal=False))
    connections = objects.get("ZoneHVAC:EquipmentConnections", {}).values()
    used = {str(fields.get("zone_conditioning_equipment_list_name", "")).casefold() for fields in connections}
    for name in objects.get("ZoneHVAC:EquipmentList", {}):
        if name.casefold() not in used and not objects.get("SpaceHVAC:EquipmentConnections"):
            text = ": no ZoneHVAC:EquipmentConnections names this list; each list needs a zone"
            yield finding("ZoneHVAC:EquipmentList", name, FieldFinding("", text))


def _setpoint_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    by_name = {name.casefold(): (kind, fields) for kind, name, fields in schedules(objects)}

    def values(schedule: object) -> list[float]:
        kind, fields = by_name.get(str(schedule).casefold(), ("", {}))
        return [value for _, value in schedule_values(objects, kind, fields)] if kind else []

    for name, fields in objects.get("ThermostatSetpoint:DualSetpoint", {}).items():
        path = "heating_setpoint_temperature_schedule_name"
        own, other = fields.get(path), fields.get("cooling_setpoint_temperature_schedule_name")
        heating, cooling = values(own), values(other)
        text = ""
        if heating and max(heating) > _HOTTEST_HEATING_C:
            text = f", which is up to {max(heating):g} °C; are its values in °F?"
        elif heating and cooling and min(heating) > max(cooling):
            text = (
                f", whose lowest value, {min(heating):g} °C, is above the highest of the cooling schedule {other!r}, "
                f"{max(cooling):g} °C; are they swapped?"
            )
        elif heating and cooling:
            # When one is at its end, the other is beyond it, whatever the times are.
            for end, of in (("highest", max), ("lowest", min)):
                if of(heating) > of(cooling):
                    text = (
                        f", whose {end} value, {of(heating):g} °C, is above the {end} of the cooling schedule "
                        f"{other!r}, {of(cooling):g} °C; EnergyPlus ends when heating is above cooling"
                    )
                    break
        if text:
            finding_of = FieldFinding(path, f": {path} is {own!r}{text}", is_fatal=False)
            yield finding("ThermostatSetpoint:DualSetpoint", name, finding_of)


def _material_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    for name, fields in objects.get("Material", {}).items():
        conductivity, density = _number(fields, "conductivity", 0.0), _number(fields, "density", _LIGHTEST)
        thickness = _number(fields, "thickness", 0.0)
        if thickness > _THICKEST:
            text = f": thickness is {thickness:g} m; is it in mm?"
            yield finding("Material", name, FieldFinding("thickness", text, is_fatal=False))
        if conductivity > _MOST_CONDUCTIVE:
            text = f": conductivity is {conductivity:g} W/(m K), more than any metal has"
            if density < _MOST_CONDUCTIVE:
                text += f"; density is {density:g} kg/m3: are they swapped?"
            yield finding("Material", name, FieldFinding("conductivity", text, is_fatal=False))
        elif density < _LIGHTEST:
            text = f": density is {density:g} kg/m3, less than that of air"
            yield finding("Material", name, FieldFinding("density", text, is_fatal=False))


_SIZED = {
    "AirLoopHVAC": ("design_supply_air_flow_rate", "Sizing:System", "airloop_name"),
    "PlantLoop": ("maximum_loop_flow_rate", "Sizing:Plant", "plant_or_condenser_loop_name"),
}
"""By type of a loop: its field that may be sized, and the type and field of the object that says how."""


def _sizing_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    for kind, (path, sizing, loop) in _SIZED.items():
        sized = {str(fields.get(loop, "")).casefold() for fields in objects.get(sizing, {}).values()}
        for name, fields in objects.get(kind, {}).items():
            if str(fields.get(path, "")).casefold() == "autosize" and name.casefold() not in sized:
                text = f": {path} is 'Autosize', but no {sizing} is for this loop"
                yield finding(kind, name, FieldFinding(path, text, is_fatal=False))
