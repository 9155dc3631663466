"""Location and design days of a weather file: from the DDY beside it, else from its own header.

Both name the annual conditions of ASHRAE's Handbook: heating 99.6 % and cooling 0.4 % dry bulb. A DDY's cooling
day has the clear sky of its place (ASHRAETau); a header does not say it, so that day has ASHRAE's general one.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from models import energyplus
from models.building.model import Objects
from models.cache import cached_bytes, digest
from models.weather.header import DesignConditions, Header
from topics.errors import InvalidConfig, ModelError

_LOCATION, _DAY = "Site:Location", "SizingPeriod:DesignDay"
_WANTED = (re.compile(r"Ann Htg 99\.6% Condns DB$", re.I), re.compile(r"Ann Clg \.4% Condns DB=>MC?WB$", re.I))
_VERSION = re.compile(r"^\s*Version\s*,", re.I | re.M)


@dataclass(frozen=True, slots=True)
class Site:
    """Where a weather file is from and what its place is sized for.

    Attributes:
        location: epJSON objects `Site:Location`; one.
        design_days: epJSON objects `SizingPeriod:DesignDay`: heating and cooling; empty if the file says none.
        source: where both are from, for people.
    """

    location: Objects
    design_days: Objects = field(default_factory=dict)
    source: str = ""


def site(epw: Path, header: Header) -> Site:
    """Location and design days of the weather file `epw`, whose header is `header`.

    A DDY is converted by EnergyPlus, once per content and engine version.

    Raises:
        InvalidConfig: a DDY beside `epw` that EnergyPlus cannot read.
    """
    beside = _ddy(epw)
    lacking = ""
    if beside is not None:
        objects = _read_ddy(beside)
        days = {n: d for wanted in _WANTED for n, d in objects.get(_DAY, {}).items() if wanted.search(n.strip())}
        locations = dict(list(objects.get(_LOCATION, {}).items())[:1])
        if len(days) >= len(_WANTED) and locations:
            return Site(locations, days, f"design days from {beside.name}")
        lacking = f" ({beside.name} lacks a location, a 99.6 % heating or a .4 % cooling day)"
    location = _location(header)
    if header.design is None:
        kept = f"{epw.name} has no design conditions: the model's own design days are kept"
        return Site(location, source=kept + lacking)
    return Site(location, from_header(header, header.design), f"design days from the header of {epw.name}{lacking}")


def apply(objects: Mapping[str, Objects], site: Site) -> dict[str, Objects]:
    """`objects` with the site's location and design days; all else is as it was.

    The design days stay where the site has none, and a model that has none gets none: it has nothing to size
    or sizes by days of the weather file.
    """
    new = {**objects, _LOCATION: site.location}
    if site.design_days and objects.get(_DAY):
        new[_DAY] = site.design_days
    return new


def _ddy(epw: Path) -> Path | None:
    beside = epw.with_suffix(".ddy")
    if beside.is_file():
        return beside
    alike = (p for p in epw.parent.iterdir() if p.stem == epw.stem and p.suffix.lower() == ".ddy" and p.is_file())
    return next(alike, None)


def _read_ddy(path: Path) -> dict[str, Objects]:
    """The objects of a DDY, which is an IDF without a version."""
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


def _location(header: Header) -> Objects:
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
    """Pa at an elevation in m: ASHRAE Handbook of Fundamentals 2009, chapter 1, equation 3."""
    return float(101_325.0 * (1.0 - 2.25577e-5 * elevation_m) ** 5.2559)


def from_header(header: Header, design: DesignConditions) -> Objects:
    """A winter and a summer design day, as a DDY has them.

    Winter: the dry bulb all day, saturated air, no sun. Summer: the dry bulb at the hottest hour with its mean
    wet bulb, the daily range, and ASHRAE's clear sky.
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
