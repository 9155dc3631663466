"""Find buildings and weather files by short name, by path, or by any part of a name that matches only one.

The files of the EnergyPlus wheel are searched first, then those of each data pack in turn, so a name keeps its meaning
when a pack is added. `sinergym/NAME` searches only that pack.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from zenostat.models import data_packs
from zenostat.models.engine_library import WHEEL, module_folder
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.user_file import absolute

MODEL_SUFFIXES = (".epjson", ".idf", ".osm", ".gbxml", ".xml")
WEATHER_SUFFIXES = (".epw",)


@dataclass(frozen=True, slots=True)
class Entry:
    """A listed file: its short name, its path, and the data pack that it belongs to, if any."""

    name: str
    path: Path
    pack: str = ""

    @property
    def plain(self) -> str:
        """Name without the pack's prefix."""
        return self.name.removeprefix(f"{self.pack}/")


@dataclass(frozen=True, slots=True)
class _Kind:
    """A kind of file: its noun, a pack's folder and file names of it, its suffixes, and the rule for short names."""

    noun: str
    folder: str
    suffixes: tuple[str, ...]
    short_name: Callable[[str], str]
    stems_in: Callable[[data_packs.Pack], tuple[str, ...]]


@cache
def wheel() -> Path:
    """Return the folder of the EnergyPlus wheel; `InvalidConfig` if it is not installed."""
    folder = module_folder(WHEEL)
    if folder is None:
        raise InvalidConfig("EnergyPlus is not installed: pip install pyenergyplus-lbnl")
    return folder


def _kebab(camel: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", camel).lower()


def building_name(stem: str) -> str:
    """Shorten `ASHRAE901_OfficeMedium_STD2019_Denver` to `office-medium`; the 2004 models get the prefix `ref-`."""
    stem = re.sub(r"OutPatient(HealthCare)?", "Outpatient", stem)
    if match := re.fullmatch(r"ASHRAE901_(\w+?)_STD2019_\w+", stem):
        return _kebab(match[1])
    if match := re.fullmatch(r"RefBldg([\w-]+?)New2004_\w+", stem):
        return "ref-" + _kebab(match[1]).replace("--", "-")
    return stem


def weather_name(stem: str) -> str:
    """Shorten `USA_CO_Denver-Aurora-Buckley.AFB.724695_TMY3` to `USA_CO_Denver`."""
    place = re.sub(r"\.\d{6}_\w+$", "", stem).split("-")[0]
    return re.sub(r"\.(Intl\.AP|Air\.Terminal|AP)$", "", place)


_BUILDING = _Kind("building", "buildings", MODEL_SUFFIXES, building_name, lambda pack: pack.buildings)
_WEATHER = _Kind("weather", "weather", WEATHER_SUFFIXES, weather_name, lambda pack: pack.weathers)


@cache
def bundled_buildings() -> tuple[Entry, ...]:
    """Return the models of the EnergyPlus wheel, sorted by name."""
    return _entries(wheel() / "data" / "model", _BUILDING, "")


@cache
def bundled_weathers() -> tuple[Entry, ...]:
    """Return the weather files of the EnergyPlus wheel, sorted by name."""
    return _entries(wheel() / "data" / "weather", _WEATHER, "")


def buildings() -> tuple[Entry, ...]:
    """Return the models of the EnergyPlus wheel, then those of the installed data packs."""
    return bundled_buildings() + tuple(entry for entries in _packed(_BUILDING) for entry in entries)


def weathers() -> tuple[Entry, ...]:
    """Return the weather files of the EnergyPlus wheel, then those of the installed data packs."""
    return bundled_weathers() + tuple(entry for entries in _packed(_WEATHER) for entry in entries)


def find_building(text: str) -> Entry:
    """Find the building that `text` names.

    Raises:
        UnknownName: no listed name matches or several do, the path does not exist, or the building is in a data pack
            that has not been added (the text has the command).
    """
    return _find(text, _BUILDING, bundled_buildings())


def find_weather(text: str) -> Entry:
    """Find the weather file that `text` names.

    Raises:
        UnknownName: no listed name matches or several do, the path does not exist, or the file is in a data pack that
            has not been added (the text has the command).
    """
    return _find(text, _WEATHER, bundled_weathers())


def _entries(folder: Path, kind: _Kind, pack: str) -> tuple[Entry, ...]:
    prefix = f"{pack}/" if pack else ""
    files = [file for file in folder.glob("*") if file.suffix.lower() in kind.suffixes]
    return tuple(sorted((Entry(prefix + kind.short_name(f.stem), f, pack) for f in files), key=lambda e: e.name))


@cache
def _entries_of_pack(root: Path, kind: _Kind, pack: data_packs.Pack) -> tuple[Entry, ...]:
    listed = kind.stems_in(pack)
    entries = _entries(root / "data" / kind.folder, kind, pack.name)
    return tuple(entry for entry in entries if entry.path.stem in listed)


def _packed(kind: _Kind) -> list[tuple[Entry, ...]]:
    """Return the entries of each installed pack."""
    return [_entries_of_pack(data_packs.root(pack.name), kind, pack) for pack in data_packs.installed()]


def _find(text: str, kind: _Kind, bundled: Sequence[Entry]) -> Entry:
    pack, _, rest = text.partition("/")
    suffix = Path(text).suffix.lower()
    if pack in data_packs.PACKS and "/" not in rest and suffix not in kind.suffixes:
        groups = [[entry for entry in entries if entry.pack == pack] for entries in _packed(kind)]
        return _find_by_name(rest, text, kind, groups, [data_packs.find_pack(pack)])
    if suffix in (*kind.suffixes, ".imf", ".json") or "/" in text or text.startswith("~"):
        return _find_by_path(text, kind)
    return _find_by_name(text, text, kind, [bundled, *_packed(kind)], list(data_packs.PACKS.values()))


def _find_by_path(text: str, kind: _Kind) -> Entry:
    try:
        path = Path(text).expanduser()
        is_folder = path.is_dir()
    except (OSError, RuntimeError) as error:  # ~name of an unknown user, or a name that is too long
        reason = error.strerror if isinstance(error, OSError) else error
        raise UnknownName(f"no {kind.noun} file at {text[:200]}: {reason}") from None
    if is_folder:
        names = sorted(file.name for file in path.iterdir() if file.suffix.lower() in kind.suffixes)
        has = f"its {kind.noun} files: {', '.join(names[:5])}" if names else f"it has no {kind.noun} file"
        raise UnknownName(f"{absolute(path)} is a folder, and a file is expected; {has}")
    if not path.is_file():
        raise UnknownName(f"no {kind.noun} file at {absolute(path)}")
    if path.suffix.lower() not in kind.suffixes:
        has_macros = "; EnergyPlus's EPMacro makes an IDF of it" if path.suffix.lower() == ".imf" else ""
        suffixes = " or ".join(kind.suffixes)
        raise UnknownName(f"{path.name} is not a {kind.noun} file: its suffix should be {suffixes}{has_macros}")
    return Entry(path.stem, path.resolve())


def _find_by_name(
    text: str, typed: str, kind: _Kind, groups: Sequence[Sequence[Entry]], packs: Sequence[data_packs.Pack]
) -> Entry:
    """Return the entry with that name, else the only one with a name that contains it, in the first group with any."""
    folded = text.casefold()
    not_added = [pack for pack in packs if not data_packs.is_installed(pack.name)]
    for matches in (_equals, _is_substring) if folded else ():
        for group in groups:
            matching = [e for e in group if matches(folded, (e.plain.casefold(), e.path.stem.casefold()))]
            if len(matching) > 1 and matches is _is_substring:
                raise UnknownName(f"{kind.noun} {typed!r} matches several: {', '.join(e.name for e in matching)}")
            if matching:
                return matching[0]
        for pack in not_added:
            if any(matches(folded, (kind.short_name(s).casefold(), s.casefold())) for s in kind.stems_in(pack)):
                command = data_packs.command(pack.name)
                raise UnknownName(f"{kind.noun} {typed!r} is in the data pack {pack.name!r}: {command}")
    names = [e.name for group in groups for e in group]
    names = names or [f"{pack.name}/{kind.short_name(stem)}" for pack in not_added for stem in kind.stems_in(pack)]
    raise UnknownName(f"no {kind.noun} {typed!r}; {did_you_mean(typed, names)}")


def _equals(text: str, names: tuple[str, str]) -> bool:
    return text in names


def _is_substring(text: str, names: tuple[str, str]) -> bool:
    return any(text in name for name in names)
