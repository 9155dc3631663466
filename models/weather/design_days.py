"""Location and design days of a weather file: from the DDY file next to it, else from its own header.

Both have the annual conditions of ASHRAE's Handbook: heating 99.6 % and cooling 0.4 % dry bulb. A DDY's cooling day
has the local clear sky (ASHRAETau); a header has no data for it, so that day has ASHRAE's general clear sky.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zenostat.models import energyplus, schema
from zenostat.models.building.run_needs import lacks_design_days
from zenostat.models.input_format.source_model import ModelObjects, ObjectsOfType
from zenostat.models.weather.header import DesignConditions, Header
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.errors import InvalidConfig, ModelError

_LOCATION, _DAY = "Site:Location", "SizingPeriod:DesignDay"
_NAMES = (re.compile(r"Ann Htg 99\.6% Condns DB$", re.I), re.compile(r"Ann Clg \.4% Condns DB=>MC?WB$", re.I))
_VERSION = re.compile(r"^\s*Version\s*,", re.I | re.M)


@dataclass(frozen=True, slots=True)
class Site:
    """Location and design days that belong to a weather file.

    Attributes:
        location: epJSON objects `Site:Location`; one.
        design_days: epJSON objects `SizingPeriod:DesignDay`: heating and cooling; empty if the file has none.
        source: description of their origin, for users.
    """

    location: ObjectsOfType
    design_days: ObjectsOfType = field(default_factory=dict)
    source: str = ""


def site(epw: Path, header: Header) -> Site:
    """Return location and design days of the weather file `epw` with the header `header`.

    A DDY is converted by EnergyPlus, once per content and engine version.

    Raises:
        InvalidConfig: EnergyPlus cannot read the DDY next to `epw`.
    """
    ddy = ddy_of(epw)
    note = ""
    if ddy is not None:
        objects = _read_ddy(ddy)
        days = {n: d for pattern in _NAMES for n, d in objects.get(_DAY, {}).items() if pattern.search(n.strip())}
        locations = dict(list(objects.get(_LOCATION, {}).items())[:1])
        if len(days) >= len(_NAMES) and locations:
            return Site(locations, days, f"design days from {ddy.name}")
        note = f" ({ddy.name} lacks a location, a 99.6 % heating or a .4 % cooling day)"
    location = _location(header)
    if header.design is None:
        kept = f"{epw.name} has no design conditions: the model's own design days are kept"
        return Site(location, source=kept + note)
    return Site(location, from_header(header, header.design), f"design days from the header of {epw.name}{note}")


def apply(objects: ModelObjects, site: Site) -> dict[str, ObjectsOfType]:
    """Return `objects` with the site's location and design days; everything else is unchanged.

    The model keeps its design days if the site has none. A model without design days gets none if it has nothing to
    size, or uses days of the weather file for sizing.
    """
    new = {**objects, _LOCATION: site.location}
    if site.design_days and (objects.get(_DAY) or lacks_design_days(objects)):
        new[_DAY] = site.design_days
    return new


def check_edits(edits: Mapping[str, Any], sites: Sequence[Site | None]) -> None:
    """Check that a scenario's edits have an effect on a model that gets location and design days of its weather files.

    Args:
        edits: of the scenario.
        sites: of its weather files; None where the model keeps its own.

    Raises:
        InvalidConfig: lists the edits of objects that are replaced.
    """
    replaced = [_LOCATION] if sites and None not in sites else []
    if replaced and all(site is not None and site.design_days for site in sites):
        replaced.append(_DAY)
    kinds = {schema.canonical_type(kind) or kind: by_name for kind, by_name in edits.items()}
    errors = [
        f"edits: {kind} {', '.join(map(repr, changed))} has no effect, because location and design days are those of "
        "the weather file; `sizing: model` keeps those of the model"
        for kind in replaced
        if (changed := [name for name, fields in dict(kinds.get(kind) or {}).items() if fields is not None])
    ]
    if errors:
        raise InvalidConfig("\n".join(errors))


def ddy_of(epw: Path) -> Path | None:
    """Return the DDY file next to a weather file; None if there is none."""
    ddy = epw.with_suffix(".ddy")
    if ddy.is_file():
        return ddy
    in_any_case = (p for p in epw.parent.iterdir() if p.stem == epw.stem and p.suffix.lower() == ".ddy" and p.is_file())
    return next(in_any_case, None)


def _read_ddy(path: Path) -> dict[str, ObjectsOfType]:
    """Return the objects of a DDY file, which is an IDF without a version."""
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    if not _VERSION.search(text):
        text = f"Version,{'.'.join(energyplus.version().split('.')[:2])};\n{text}"

    def convert(target: Path) -> None:
        source = target.with_name("ddy.idf")
        source.write_text(text, encoding="utf-8")
        energyplus.call("convert", source, target, file=path)

    try:
        return dict(json.loads(cached_bytes(f"design-days/{digest(raw, energyplus.version())}.epJSON", convert)))
    except (ModelError, ValueError) as error:
        raise InvalidConfig(f"{path} cannot be read as design days: {error}") from None


def _location(header: Header) -> ObjectsOfType:
    place = {
        "latitude": header.latitude_deg,
        "longitude": header.longitude_deg,
        "time_zone": header.time_zone_h,
        "elevation": header.elevation_m,
    }
    return {_name(header): place}


def _name(header: Header) -> str:
    return header.place.replace(",", "") or "weather file"


def standard_pressure(elevation_m: float) -> float:
    """Return the pressure in Pa at an elevation in m: ASHRAE Handbook of Fundamentals 2009, chapter 1, equation 3."""
    return float(101_325.0 * (1.0 - 2.25577e-5 * elevation_m) ** 5.2559)


def from_header(header: Header, design: DesignConditions) -> ObjectsOfType:
    """Return a winter and a summer design day, as in a DDY file.

    Winter: the dry bulb all day, saturated air, no sun. Summer: the dry bulb at the hottest hour with its mean wet
    bulb, the daily range, and ASHRAE's clear sky.
    """
    pressure = round(standard_pressure(header.elevation_m))
    winter = _day(
        design.heating_month,
        "WinterDesignDay",
        maximum_dry_bulb_temperature=design.heating_dry_bulb_c,
        daily_dry_bulb_temperature_range=0.0,
        wetbulb_or_dewpoint_at_maximum_dry_bulb=design.heating_dry_bulb_c,
        barometric_pressure=pressure,
        wind_speed=design.heating_wind_m_s,
        wind_direction=design.heating_wind_deg,
        sky_clearness=0.0,
    )
    summer = _day(
        design.cooling_month,
        "SummerDesignDay",
        maximum_dry_bulb_temperature=design.cooling_dry_bulb_c,
        daily_dry_bulb_temperature_range=design.cooling_range_k,
        wetbulb_or_dewpoint_at_maximum_dry_bulb=design.cooling_wet_bulb_c,
        barometric_pressure=pressure,
        wind_speed=design.cooling_wind_m_s,
        wind_direction=design.cooling_wind_deg,
        sky_clearness=1.0,
    )
    name = _name(header)
    return {f"{name} Ann Htg 99.6% Condns DB": winter, f"{name} Ann Clg .4% Condns DB=>MWB": summer}


def _day(month: int, day_type: str, **conditions: float) -> dict[str, Any]:
    return {
        "month": month,
        "day_of_month": 21,
        "day_type": day_type,
        "dry_bulb_temperature_range_modifier_type": "DefaultMultipliers",
        "humidity_condition_type": "WetBulb",
        "rain_indicator": "No",
        "snow_indicator": "No",
        "daylight_saving_time_indicator": "No",
        "solar_model_indicator": "ASHRAEClearSky",
        **conditions,
    }
