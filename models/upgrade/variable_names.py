"""Output variables and meters that a version renamed, in the objects that name them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from zenostat.models.upgrade.step import Renames, UpgradingModel

_FIELDS = {
    "DemandManagerAssignmentList": "meter_name",
    "ElectricLoadCenter:Distribution": "(generator|storage_control)_track_meter(_scheme_meter)?_name",
    "ElectricLoadCenter:Transformer": "meter_name",
    "EnergyManagementSystem:Sensor": "output_variable_or_output_meter_name",
    "ExternalInterface:FunctionalMockupUnitExport:From:Variable": "output_variable_name",
    "ExternalInterface:FunctionalMockupUnitImport:From:Variable": "output_variable_name",
    "Meter:Custom": "output_variable_or_meter_name",
    "Meter:CustomDecrement": "source_meter_name|output_variable_or_meter_name",
    "Output:Meter": "key_name",
    "Output:Meter:Cumulative": "key_name",
    "Output:Meter:Cumulative:MeterFileOnly": "key_name",
    "Output:Meter:MeterFileOnly": "key_name",
    "Output:Table:Annual": "variable_or_meter_or_ems_variable_or_field_name",
    "Output:Table:Monthly": "variable_or_meter_name",
    "Output:Table:TimeBins": "variable_name|key_value",
    "Output:Variable": "variable_name",
    "UtilityCost:Tariff": "output_meter_name",
}
"""Fields, in a list's entries too, that name an output variable or a meter."""


def rename_variables(model: UpgradingModel, renames: Renames) -> None:
    """Rename output variables and meters; custom meters of the model keep their names.

    Args:
        model: is changed.
        renames: patterns of whole names in any case, and their replacements; the first that matches is used.
    """
    own = {name.casefold() for kind in ("Meter:Custom", "Meter:CustomDecrement") for name, _ in model.items(kind)}
    patterns = [(re.compile(pattern, re.IGNORECASE), template) for pattern, template in renames]

    def renamed(text: str) -> str:
        matches = ((pattern.fullmatch(text), template) for pattern, template in patterns)
        return next((match.expand(template) for match, template in matches if match), text)

    for kind, pattern in _FIELDS.items():
        for name, fields in model.items(kind):
            for entry, key, old in _names(fields, re.compile(pattern)):
                new = old if old.casefold() in own else renamed(old)
                if new.casefold() != old.casefold():
                    entry[key] = new
                    model.note(kind, name, f"{old!r} is now {new!r}")


def _names(fields: dict[str, Any], pattern: re.Pattern[str]) -> Iterator[tuple[dict[str, Any], str, str]]:
    """Yield the fields that match, in a list's entries too: the mapping, the key and the text."""
    for key, value in list(fields.items()):
        if isinstance(value, list):
            for entry in value:
                if isinstance(entry, dict):
                    yield from _names(entry, pattern)
        elif isinstance(value, str) and pattern.fullmatch(key):
            yield fields, key, value
