"""Find names of meters that are none, in the objects that follow a meter: transformers and load centers.

EnergyPlus crashes at such a name in a transformer, and takes the meter of a load center as 0, without a message.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

from zenostat.models.building.findings import FieldFinding, RuleFinding, finding
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.topics.energyplus_names import END_USES
from zenostat.topics.errors import did_you_mean

_CUSTOM = ("Meter:Custom", "Meter:CustomDecrement")
_TRANSFORMER = "ElectricLoadCenter:Transformer"
_DISTRIBUTION = "ElectricLoadCenter:Distribution"

_KINDS = ("", "Produced", "Purchased", "SurplusSold", "Net")
_LEVELS = ("Facility", "Building", "HVAC", "Plant")
_USES = (*END_USES, "Photovoltaic", "WindTurbine", "PowerConversion", "ElectricStorage")
_SUGGESTED = (
    *(f"Electricity{kind}:{level}" for kind, level in product(_KINDS, _LEVELS)),
    *(f"{use}:Electricity{kind}" for kind, use in product(_KINDS, _USES)),
)
_ELECTRICITY = rf"Electricity({'|'.join(_KINDS)})"
_PLACE = r"(Zone|SpaceType):.+"
_METER = re.compile(
    rf"{_ELECTRICITY}:({'|'.join(_LEVELS)}|{_PLACE})|(.+:)?({'|'.join(_USES)}):{_ELECTRICITY}(:{_PLACE})?",
    re.IGNORECASE,
)
"""EnergyPlus's meters of electricity: by level or place, and by end use, also of a subcategory or at a place."""


def meter_findings(objects: ModelObjects, meters: Sequence[str] | None = None) -> Iterator[RuleFinding]:
    """Yield an error for each meter of a transformer that is none, and a warning for each of a load center.

    Args:
        objects: the model.
        meters: all meters that the model has; without them, each name that a meter of electricity can have is taken.
    """
    custom = [name for kind in _CUSTOM for name in objects.get(kind, {})]
    names = [*custom, *_SUGGESTED] if meters is None else meters
    known = {name.casefold() for name in (custom if meters is None else meters)}
    for kind, name, path, meter in _followed_meters(objects):
        if meter and meter.casefold() not in known and not (meters is None and _METER.fullmatch(meter)):
            text = f": {path} is {meter!r}, but the model has no meter of electricity of that name"
            text = f"{text}; {did_you_mean(meter, names)}"
            yield finding(kind, name, FieldFinding(path, text, is_fatal=kind == _TRANSFORMER))


def _followed_meters(objects: ModelObjects) -> Iterator[tuple[str, str, str, str]]:
    """Yield each field whose meter has an effect: the object's type and name, the field's path, the meter's name."""
    for name, fields in objects.get(_TRANSFORMER, {}).items():
        if fields.get("transformer_usage", "") in ("", "PowerInFromGrid"):
            for index, entry in enumerate(fields.get("meters", ())):
                yield _TRANSFORMER, name, f"meters[{index}].meter_name", str(entry.get("meter_name", ""))
    for name, fields in objects.get(_DISTRIBUTION, {}).items():
        for path in _track_meters(fields):
            yield _DISTRIBUTION, name, path, str(fields.get(path, ""))


def _track_meters(fields: Mapping[str, Any]) -> Iterator[str]:
    """Yield the fields of a load center that name a meter and that its schemes use."""
    if fields.get("generator_operation_scheme_type") == "TrackMeter":
        yield "generator_track_meter_scheme_meter_name"
    if fields.get("storage_operation_scheme") == "TrackMeterDemandStoreExcessOnSite":
        yield "storage_control_track_meter_name"
