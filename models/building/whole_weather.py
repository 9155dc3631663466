"""Objects of a model for which EnergyPlus reads the whole weather file before the run period begins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

_METHODS = {"site:watermainstemperature": "correlationfromweatherfile"}
_TYPES = ("sizingperiod:weatherfiledays", "sizingperiod:weatherfileconditiontype")
_ADAPTIVE = ("people", "zonecontrol:thermostat:operativetemperature")


def reads_whole_weather(objects: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the type of an object for which EnergyPlus reads the whole weather file; empty if there is none.

    These are sizing periods of the weather file, mains water temperatures that follow the weather file, and adaptive
    comfort models, which average the outdoor temperature (EnergyPlus's Engineering Reference).
    """
    for kind, members in objects.items():
        folded = kind.casefold()
        if folded in _TYPES and members:
            return kind
        texts = {str(value).casefold() for fields in members.values() for value in _values(fields)}
        if _METHODS.get(folded) in texts or (
            folded in _ADAPTIVE and any(text.startswith("adaptive") for text in texts)
        ):
            return kind
    return ""


def _values(fields: Any) -> Iterable[Any]:
    """Return all values of an object, also those in lists of groups."""
    if isinstance(fields, Mapping):
        for value in fields.values():
            yield from _values(value)
    elif isinstance(fields, list):
        for value in fields:
            yield from _values(value)
    else:
        yield fields
