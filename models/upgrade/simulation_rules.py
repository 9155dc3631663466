"""Rules for constructions, EMS programs and diagnostics that a table of renames cannot express."""

from __future__ import annotations

import re

from zenostat.models.upgrade.step import UpgradingModel

_SPECIFIC_HEAT = re.compile(r"@CpAirFnWTdb(\s+\S+)\s+[^\s,]+", re.IGNORECASE)
_SOURCE_FIELDS = (
    ("source_present_after_layer_number", "thermal_source_present_after_layer_number"),
    ("temperature_calculation_requested_after_layer_number",) * 2,
    ("dimensions_for_the_ctf_calculation",) * 2,
    ("tube_spacing",) * 2,
    ("two_dimensional_temperature_calculation_position",) * 2,
)


def run_period_names(model: UpgradingModel) -> None:
    """Name a run period without a name (9.1 to 9.2; Input Changes); those of an IDF are named when it is read."""
    kind = "RunPeriod"
    for name, fields in model.items(kind):
        if not name.strip():
            own = model.find(kind) or kind
            del model.objects[own][name]
            model.add(own, f"{kind} 1", fields, source=(kind, name))


def specific_heat_function(model: UpgradingModel) -> None:
    """Remove the dry bulb from the specific heat of air in EMS programs (9.2 to 9.3; Input Changes)."""
    for kind in ("EnergyManagementSystem:Program", "EnergyManagementSystem:Subroutine"):
        for name, fields in model.items(kind):
            for line in fields.get("lines", ()):
                text = str(line.get("program_line", ""))
                new = _SPECIFIC_HEAT.sub(r"@CpAirFnW\1", text)
                if new != text:
                    line["program_line"] = new
                    model.note(kind, name, f"{text!r} is now {new!r}")


def one_diagnostics_object(model: UpgradingModel) -> None:
    """Merge several diagnostics objects into one (9.3 to 9.4; Input Changes)."""
    kind = "Output:Diagnostics"
    first, *others = model.items(kind) or [("", {})]
    for name, fields in others:
        first[1].setdefault("diagnostics", []).extend(fields.get("diagnostics", ()))
        model.remove(kind, name, f"merged into {first[0]!r}, because a model has only one")


def debugging_words(model: UpgradingModel) -> None:
    """Replace numbers by `Yes` and `No`: 1 was yes (9.3 to 9.4; transition rules V9_4_0)."""
    kind = "Output:DebuggingData"
    for name, fields in model.items(kind):
        for key, value in fields.items():
            if not isinstance(value, str):
                fields[key] = "Yes" if int(value) == 1 else "No"
                model.note(kind, name, f"{key} {value} is now {fields[key]!r}")


def internal_heat_sources(model: UpgradingModel) -> None:
    """Split a construction with an internal source into a construction and its source (9.4 to 9.5; schemas)."""
    kind = "Construction:InternalSource"
    for name, fields in model.items(kind):
        source = {new: fields.pop(old) for old, new in _SOURCE_FIELDS if old in fields}
        if any(name.casefold() == own.casefold() for own, _ in model.items("Construction")):
            model.refuse(kind, name, "there is a Construction of the same name, which it now needs")
            continue
        model.objects.setdefault("Construction", {})[name] = fields
        model.origins["Construction", name] = model.origin(kind, name)
        model.add("ConstructionProperty:InternalHeatSource", f"{name} Heat Source",
                  {"construction_name": name, **source}, source=(kind, name))  # fmt: skip
        model.remove(kind, name, "is now a Construction with a ConstructionProperty:InternalHeatSource")
