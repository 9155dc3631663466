"""A model's output objects: which ones an episode needs, and which edits of them have an effect.

Names of output objects begin with `Output`. Most of them write files; a few act on the simulation or its variables.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from zenostat.models import schema
from zenostat.models.engine_library import key_pattern
from zenostat.models.input_format.source_model import ModelObjects, ObjectsOfType
from zenostat.topics.energyplus_names import COMPUTED_ON_REQUEST
from zenostat.topics.errors import InvalidConfig

_ACTING_TYPES = ("OutputControl:ReportingTolerances", "OutputControl:ResilienceSummaries")
"""Output objects on which values of output variables depend: unmet hours, and the heat index."""

_ACTING_DIAGNOSTICS = ("donotmirrordetachedshading", "donotmirrorattachedshading")
"""Keys of `Output:Diagnostics` that change the simulation, case-folded; the others only add messages and variables."""

_SILENT = {
    "OutputControl:Files": {
        "silent": {
            f"output_{name}": "No"
            for name in [
                "csv",
                "mtr",
                "eso",
                "eio",
                "tabular",
                "sqlite",
                "json",
                "audit",
                "space_sizing",
                "zone_sizing",
                "system_sizing",
                "dxf",
                "bnd",
                "rdd",
                "mdd",
                "mtd",
                "shd",
                "dfs",
                "glhe",
                "delightin",
                "delighteldmp",
                "delightdfdmp",
                "edd",
                "dbg",
                "perflog",
                "sln",
                "sci",
                "wrl",
                "screen",
                "extshd",
                "tarcog",
            ]
        }
    }
}
"""Turns off every output file that EnergyPlus can omit, all but `eplusout.err` and `eplusout.end`."""

_SENSORS = "to observe an output variable, name it in `sensors`"
_METERS = "to observe a meter, name it in `meters`"
_HINTS = {"Output:Variable": _SENSORS, "Output:Meter": _METERS, "Output:Meter:Cumulative": _METERS}


def without_files(objects: ModelObjects) -> dict[str, ObjectsOfType]:
    """Return the objects without those that only write files, so that EnergyPlus writes only its errors.

    A request for a variable that an EMS program reads is kept where EnergyPlus computes the variable only on request.
    """
    kept = {kind: items for kind, items in objects.items() if not kind.startswith("Output") or kind in _ACTING_TYPES}
    diagnostics = [
        entry
        for fields in objects.get("Output:Diagnostics", {}).values()
        for entry in fields.get("diagnostics", ())
        if _acts(entry)
    ]
    if diagnostics:
        kept["Output:Diagnostics"] = {"zenostat": {"diagnostics": diagnostics}}
    requests = _requests_of_programs(objects)
    if requests:
        kept["Output:Variable"] = requests
    return kept | _SILENT


def _acts(diagnostic: Mapping[str, Any]) -> bool:
    return str(diagnostic.get("key", "")).casefold() in _ACTING_DIAGNOSTICS


def _requests_of_programs(objects: ModelObjects) -> ObjectsOfType:
    read = {
        str(fields.get("output_variable_or_output_meter_name", "")).casefold()
        for fields in objects.get("EnergyManagementSystem:Sensor", {}).values()
    } & COMPUTED_ON_REQUEST
    return {
        name: fields
        for name, fields in objects.get("Output:Variable", {}).items()
        if str(fields.get("variable_name", "")).casefold() in read
    }


def with_requests(objects: dict[str, ObjectsOfType], requested: Iterable[tuple[str, str]]) -> dict[str, ObjectsOfType]:
    """Return the objects with an `Output:Variable` for each output variable, given by name and key.

    Its frequency is that of the fewest reports; where EnergyPlus writes no output files, nothing is written. All keys
    are requested instead of one with special characters: EnergyPlus takes that one for a regular expression, but does
    not compute the variables on request for an expression that matches.
    """
    requests = {
        f"zenostat {number}": {
            "key_value": key if key == key_pattern(key) else "*",
            "variable_name": name,
            "reporting_frequency": "RunPeriod",
        }
        for number, (name, key) in enumerate(requested, 1)
    }
    return objects | {"Output:Variable": objects.get("Output:Variable", {}) | requests} if requests else objects


def check_edits(edits: Mapping[str, Any]) -> None:
    """Check that edits have an effect on an episode without output files; edits that remove objects may have none.

    Raises:
        InvalidConfig: lists the edits of objects that are left out.
    """
    errors = []
    for kind, by_name in edits.items():
        name = schema.canonical_type(kind) or kind
        if not name.startswith("Output") or name in _ACTING_TYPES or not isinstance(by_name, Mapping):
            continue
        changed = [object_name for object_name, fields in by_name.items() if fields is not None]
        if name == "Output:Diagnostics":
            changed = [object_name for object_name in changed if not _all_act(by_name[object_name])]
        if changed:
            hint = _HINTS.get(name)
            errors.append(
                f"edits: {name} {', '.join(map(repr, changed))} has no effect, because output objects are left out"
                f"{f'; {hint}' if hint else ''}; with `output_dir`, EnergyPlus's output files are kept"
            )
    if errors:
        raise InvalidConfig("\n".join(errors))


def _all_act(fields: object) -> bool:
    diagnostics = fields.get("diagnostics", ()) if isinstance(fields, Mapping) else ()
    return bool(diagnostics) and all(isinstance(entry, Mapping) and _acts(entry) for entry in diagnostics)
