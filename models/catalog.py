"""Buildings and weather files by short name, by path, or by any part of a name that fits only one."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from topics.errors import InvalidConfig, UnknownName, near

MODEL_SUFFIXES = (".epjson", ".idf")
WEATHER_SUFFIXES = (".epw",)


@dataclass(frozen=True, slots=True)
class Entry:
    """A file that can be named: its short name and where it is."""

    name: str
    path: Path


@cache
def wheel() -> Path:
    """The folder of the EnergyPlus wheel; `InvalidConfig` if it is not installed."""
    found = importlib.util.find_spec("pyenergyplus")
    if found is None or not found.submodule_search_locations:
        raise InvalidConfig("EnergyPlus is not installed: pip install pyenergyplus-lbnl")
    return Path(found.submodule_search_locations[0])


def _kebab(camel: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", camel).lower()


def building_name(stem: str) -> str:
    """`ASHRAE901_OfficeMedium_STD2019_Denver` is `office-medium`; the 2004 models begin with `ref-`."""
    stem = re.sub(r"OutPatient(HealthCare)?", "Outpatient", stem)
    if match := re.fullmatch(r"ASHRAE901_(\w+?)_STD2019_\w+", stem):
        return _kebab(match[1])
    if match := re.fullmatch(r"RefBldg([\w-]+?)New2004_\w+", stem):
        return "ref-" + _kebab(match[1]).replace("--", "-")
    return stem


def weather_name(stem: str) -> str:
    """`USA_CO_Denver-Aurora-Buckley.AFB.724695_TMY3` is `USA_CO_Denver`."""
    place = re.sub(r"\.\d{6}_\w+$", "", stem).split("-")[0]
    return re.sub(r"\.(Intl\.AP|Air\.Terminal|AP)$", "", place)


@cache
def buildings() -> tuple[Entry, ...]:
    """The models of the EnergyPlus wheel, by name."""
    files = (wheel() / "data" / "model").glob("*.idf")
    return tuple(sorted((Entry(building_name(f.stem), f) for f in files), key=lambda e: e.name))


@cache
def weathers() -> tuple[Entry, ...]:
    """The weather files of the EnergyPlus wheel, by name."""
    files = (wheel() / "data" / "weather").glob("*.epw")
    return tuple(sorted((Entry(weather_name(f.stem), f) for f in files), key=lambda e: e.name))


def find_building(text: str) -> Entry:
    """The building that `text` names.

    Raises:
        UnknownName: no or several listed names fit, or the path does not exist.
    """
    return _find(text, "building", buildings(), MODEL_SUFFIXES)


def find_weather(text: str) -> Entry:
    """The weather file that `text` names.

    Raises:
        UnknownName: no or several listed names fit, or the path does not exist.
    """
    return _find(text, "weather", weathers(), WEATHER_SUFFIXES)


def _find(text: str, what: str, entries: tuple[Entry, ...], suffixes: tuple[str, ...]) -> Entry:
    try:
        path = Path(text).expanduser()
    except RuntimeError as error:  # ~name of nobody
        raise UnknownName(f"no {what} file at {text}: {error}") from None
    if path.suffix.lower() in suffixes or "/" in text:
        if not path.is_file():
            raise UnknownName(f"no {what} file at {path.absolute()}")
        if path.suffix.lower() not in suffixes:
            raise UnknownName(f"{path.name} is no {what}: it should end in {' or '.join(suffixes)}")
        return Entry(path.stem, path.resolve())
    folded = text.casefold()
    for entry in entries:
        if folded in (entry.name.casefold(), entry.path.stem.casefold()):
            return entry
    fits = [e for e in entries if folded in e.name.casefold() or folded in e.path.stem.casefold()]
    if len(fits) == 1 and folded:
        return fits[0]
    if len(fits) > 1 and folded:
        raise UnknownName(f"{what} {text!r} fits several: {', '.join(e.name for e in fits)}")
    raise UnknownName(f"no {what} {text!r}; {near(text, (e.name for e in entries))}")
