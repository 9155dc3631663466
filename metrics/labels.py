"""Names of points, zones and units that a person reads."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from datetime import date

from zenostat.topics.energyplus_names import OCCUPANTS
from zenostat.topics.messages import Actuator, Meter, Sensor

_UPPER = {
    "ahu", "co2", "cop", "crac", "dc", "dhw", "doas", "dx", "ems", "er", "hvac", "ic", "icu", "it", "mri", "or", "pacu",
    "pmv", "ppd", "ptac", "pv", "rl", "soc", "ups", "vav", "vrf",
    "ne", "nw", "se", "sw", "nne", "ene", "ese", "sse", "ssw", "wsw", "wnw", "nnw",
}  # fmt: skip
"""Abbreviations and points of the compass, in capital letters."""

_EXPANDED = {
    "bot": "bottom", "btm": "bottom", "clg": "cooling", "corr": "corridor", "flr": "floor", "htg": "heating",
    "mech": "mechanical", "mid": "middle", "perim": "perimeter", "rm": "room", "sec": "section", "setp": "setpoint",
    "stn": "station", "temp": "temperature", "zn": "zone",
}  # fmt: skip

_UNITS = {
    "": "", "1": "", "count": "", "fraction": "", "on_off": "",
    "degC": "°C", "delta_degC": "K", "degF": "°F", "percent": "%", "deg": "°",
    "W/m2": "W/m²", "W/m2-K": "W/(m² K)", "m2": "m²", "m3": "m³", "m3/s": "m³/s", "J/m2": "J/m²", "ach": "1/h",
    "kgWater/kgDryAir": "kg/kg", "kgWater/s": "kg/s", "lux": "lx",
}  # fmt: skip

_SEPARATORS = re.compile(r"[\s_:.,;/]+")
_BREAKS = re.compile(r"(?<=[a-z0-9])(?=[A-Z][a-z])|(?<=[A-Za-z]{3})(?=\d)")
_CODE = re.compile(r"[a-z]\d*")


MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_WEEKDAYS = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")


def date_label(day: date) -> str:
    """Return a date as text, such as `Mon 3 Jul`, in English whatever the locale is."""
    return f"{_WEEKDAYS[day.weekday()]} {day.day} {MONTHS[day.month - 1]}"


def label(name: str) -> str:
    """Return a point's name as text: `core_bottom_cooling_setpoint` becomes `Core bottom cooling setpoint`."""
    return _sentence(_lower_words(name)) or name


def unused_name(name: str, used: Collection[str]) -> str:
    """Return a name that is not in use: itself, else `name_2`, `name_3` and so on."""
    return next(text for n in range(len(used) + 2) if (text := f"{name}_{n + 1}" if n else name) not in used)


def zone_label(key: str) -> str:
    """Return a zone's name as text: `PERIMETER_BOT_ZN_1` becomes `Perimeter bottom 1`."""
    every = _lower_words(key)
    kept = [word for word in every if word not in ("zone", "thermal")]
    is_name = bool(kept) and kept[0][0].isalpha() and re.search(r"zone", key, re.IGNORECASE) is None
    return _sentence(kept if is_name else every) or key


def zone_labels(keys: Iterable[str]) -> tuple[str, ...]:
    """Return the labels of the zones of one building; those that would be equal keep EnergyPlus's name."""
    zones = list(keys)
    labels = [zone_label(zone) for zone in zones]
    return tuple(text if labels.count(text) == 1 else zone for text, zone in zip(labels, zones, strict=True))


def unit_label(unit: str) -> str:
    """Return a unit as engineers write it: `°C` for `degC`, `%` for `percent`, no text for counts and ratios."""
    return _UNITS.get(unit, unit)


def point_unit(point: Sensor | Meter | Actuator) -> str:
    """Return the unit of a point as engineers write it; `people` for a number of occupants."""
    if isinstance(point, Sensor) and point.variable.casefold() == OCCUPANTS.casefold():
        return "people"
    return unit_label(point.unit)


def words(name: str) -> list[str]:
    """Return the words of a name for comparisons, case-folded, with abbreviations of buildings' parts written out."""
    return [word.casefold() for word in _lower_words(name)]


def _lower_words(name: str) -> list[str]:
    """Return the words of a name as they are read, in lower case; see `words`."""
    parts = (word for part in _SEPARATORS.split(name) for word in _BREAKS.split(part))
    lower = (part.strip("()[]-").lower() for part in parts)
    return [_EXPANDED.get(word, word) for word in lower if word]


def _sentence(parts: list[str]) -> str:
    text = " ".join(part.upper() if part in _UPPER or _CODE.fullmatch(part) else part for part in parts)
    return text[:1].upper() + text[1:]
